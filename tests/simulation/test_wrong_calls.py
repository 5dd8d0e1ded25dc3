"""Wrong calls are refused with the rule, the value and the likely slip; failed trajectories say what failed."""

import diffrax
import jax
import numpy as np
import pytest

import jaxlines as jl

OIL = jl.Oil(1.379e9, 850.0)
TIMES = np.linspace(0.0, 0.1, 5)


def parts(**changes) -> dict:
    return {
        "pump": jl.FlowSource("A", "flow"),
        "leak": jl.LaminarLeak("A", "T", 1e-11),
        "tank": jl.Tank("T"),
        "line": jl.Line("A", [jl.Vessel(1e-3), jl.Vessel(2e-3)]),
    } | changes


@pytest.fixture(scope="module")
def circuit() -> jl.Circuit:
    return jl.Circuit(OIL, parts())


def test_missing_and_unknown_inputs(circuit):
    with pytest.raises(ValueError, match=r"needs an input 'flow' \(it drives pump.flow\); given: none"):
        jl.simulate(circuit, TIMES)
    with pytest.raises(ValueError, match=r"has no input 'spool'; it has \['flow'\]"):
        jl.simulate(circuit, TIMES, {"flow": 0.0, "spool": 0.1})


@pytest.mark.parametrize("value", [np.full(5, 2e3), 2e3, -2e3, jl.Step(0.0, 2e3, 0.05)])
def test_inputs_out_of_range(circuit, value):
    with pytest.raises(
        ValueError, match=r"input 'flow' \(pump.flow\) must be -1000..1000 m.3/s, got -?2000 m.3/s: .*L/min"
    ):
        jl.simulate(circuit, TIMES, {"flow": value})


def test_inputs_of_wrong_shape_or_not_finite(circuit):
    with pytest.raises(ValueError, match=r"needs two or more times and as many values, got shapes \(5,\) and \(4,\)"):
        jl.simulate(circuit, TIMES, {"flow": np.zeros(4)})
    with pytest.raises(ValueError, match="must be finite; sample 2 is nan"):
        jl.simulate(circuit, TIMES, {"flow": np.array([0, 0, np.nan, 0, 0])})
    with pytest.raises(ValueError, match="times of a sampled signal must increase; they do not at sample 2"):
        jl.Sampled([0.0, 1.0, 1.0], [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"method must be .*, got 'spline'"):
        jl.Sampled([0.0, 1.0], [1.0, 2.0], method="spline")


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0], r"two or more times \[s\], got shape \(1,\)"),
        (np.zeros((2, 3)), r"got shape \(2, 3\); batch with jax.vmap"),
        ([0.0, 0.2, 0.1], "finite and strictly increasing"),
        ([0.0, np.nan], "finite and strictly increasing"),
    ],
)
def test_wrong_times(circuit, times, message):
    with pytest.raises(ValueError, match=message):
        jl.simulate(circuit, times, {"flow": 0.0})


def test_wrong_options(circuit):
    with pytest.raises(ValueError, match='gradient must be "forward" or "reverse", got \'both\''):
        jl.simulate(circuit, TIMES, {"flow": 0.0}, gradient="both")
    with pytest.raises(ValueError, match='precision must be "float64" or "float32", got \'float16\''):
        jl.simulate(circuit, TIMES, {"flow": 0.0}, precision="float16")
    with pytest.raises(TypeError, match=r"solver must be a diffrax solver .* got 'Tsit5'"):
        jl.simulate(circuit, TIMES, {"flow": 0.0}, solver="Tsit5")  # pyright: ignore[reportArgumentType]
    with pytest.raises(KeyError, match=r"B\.pressure.*A\.pressure"):
        jl.simulate(circuit, TIMES, {"flow": 0.0}, initial={"B.pressure": 1e6})
    with pytest.raises(KeyError, match=r"no output is called 'A\.presure'; did you mean A\.pressure"):
        jl.simulate(circuit, TIMES, {"flow": 0.0}, outputs=["A.presure"])


def test_paths(circuit):
    assert circuit["line.parts.1.volume"] == 2e-3
    assert circuit["leak.conductance"] == 1e-11
    with pytest.raises(KeyError, match=r"no number is called 'leak\.conductanse'; did you mean leak\.conductance"):
        circuit["leak.conductanse"]
    with pytest.raises(
        KeyError, match=r"'line\.volume' could mean several: line\.parts\.0\.volume, line\.parts\.1\.volume"
    ):
        circuit.replace({"line.volume": 1e-3})
    with pytest.raises(ValueError, match=r"air_fraction must be .* got 2"):
        circuit.replace({"fluid.air_fraction": 2.0})
    assert circuit.replace({"fluid.air_fraction": 0.02})["fluid.air_fraction"] == 0.02
    assert circuit["fluid.air_fraction"] == 0.0


def test_a_node_without_capacity_is_named():
    hole: dict = {"leak": jl.LaminarLeak("A", "B", 1e-11), "line": jl.Line("A", jl.Vessel(1e-3))}
    with pytest.raises(ValueError, match=r"hydraulic node 'B' has no capacity, .* is undetermined: attach a Line"):
        jl.Circuit(OIL, hole)
    with pytest.raises(ValueError, match=r"rotational node 'shaft' has no capacity, .* attach an Inertia"):
        jl.Circuit(OIL, {"load": jl.LoadTorque("shaft", 1.0)})
    with pytest.raises(ValueError, match=r"hydraulic node 'B' has no capacity, .* is undetermined: attach a Line"):
        jl.Circuit(OIL, {**hole, "second": jl.LaminarLeak("B", "A", 1e-11)})


@pytest.mark.parametrize(
    ("components", "error", "message"),
    [
        (
            parts(shaft=jl.Inertia("A", 1.0)),
            ValueError,
            r"node 'A' is hydraulic, but shaft\.shaft needs a rotational node",
        ),
        (parts(other=jl.Tank("T")), ValueError, "pressure of node 'T' is set by both 'tank' and 'other'"),
        (parts(A=jl.Tank("B")), ValueError, "'A' is both a node and a component"),
        ({"a.b": jl.Tank("T")}, ValueError, "'a.b' is no name for a component"),
        ({"fluid": jl.Tank("T")}, ValueError, "'fluid' is no name for a component"),
        ({"tank": 3.0}, TypeError, "'tank' must be a component or a sensor, got float"),
    ],
)
def test_wrong_circuits(components, error, message):
    with pytest.raises(error, match=message):
        jl.Circuit(OIL, components)


def test_a_circuit_begins_with_its_fluid():
    with pytest.raises(TypeError, match="the first argument of a Circuit is its fluid, got dict"):
        jl.Circuit({}, OIL)  # pyright: ignore[reportArgumentType]


def test_a_sensor_of_nothing_is_refused():
    with pytest.raises(
        ValueError, match=r"sensor 'gauge' reads 'B\.pressure', which the circuit does not have; .*A\.pressure"
    ):
        jl.simulate(jl.Circuit(OIL, parts(gauge=jl.PressureSensor("B"))), TIMES, {"flow": 0.0})
    with pytest.raises(ValueError, match='reference must be "absolute" or "gauge", got \'barg\''):
        jl.PressureSensor("A", reference="barg")


def test_traced_code_needs_float64(circuit):
    def end(volume):
        changed = circuit.replace({"line.parts.0.volume": volume})
        return jl.simulate(changed, TIMES, {"flow": 1e-5})["A.pressure"][-1]

    with (
        jax.enable_x64(False),
        pytest.raises(RuntimeError, match=r"wrap the outer call in `with jax\.enable_x64\(True\)"),
    ):
        jax.grad(end)(1e-3)


def test_the_step_limit_is_reported(circuit):
    sim = jl.simulate(circuit, TIMES, {"flow": 1e-4}, max_steps=3, throw=False)
    assert sim.status == "max_steps"
    with pytest.raises(RuntimeError, match=r"simulation failed \(max_steps\): .* 3 steps were made.* A\.pressure"):
        sim.raise_if_failed()


def test_tension_is_reported(circuit):
    with pytest.raises(RuntimeError, match=r"simulation failed \(tension\): .* give the fluid an air_fraction"):
        jl.simulate(circuit, TIMES, {"flow": -1e-5})
    airy = circuit.replace({"fluid.air_fraction": 0.01})
    sim = jl.simulate(airy, TIMES, {"flow": -1e-5})
    assert sim.status == "ok" and 0 < sim.lowest_pressure < 1.01e5


def test_a_splitting_solver_is_refused(circuit):
    with pytest.raises(TypeError, match=r"KenCarp5 splits the equations in two"):
        jl.simulate(circuit, TIMES, {"flow": 0.0}, solver=diffrax.KenCarp5())
