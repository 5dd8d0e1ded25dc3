"""Steady states against closed forms and long simulations; their derivatives; what is free; what will not balance."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import jaxlines as jl
from jaxlines.catalogue.dsn70m_drive import START, axis_drive
from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.controllers import PIController, SampledController
from jaxlines.physics.fields import ROTATIONAL, port
from jaxlines.simulation.steady import steady_state

ARTICLE = jl.Oil(1.379e9, 850.0, 27.7e-6, mass="article")
AIRY = jl.Oil(1.4e9, 850.0, 30e-6, 0.01)


def divider(fluid=ARTICLE, first=2e-6, second=3e-6, supply: float | str = 20e6) -> jl.Circuit:
    """Two orifices in series, of which the pressure between is known."""
    return jl.Circuit(
        fluid,
        {
            "supply": jl.PressureSource("P", supply),
            "in": jl.Orifice("P", "A", first, transition=1e-3),
            "line": jl.Line("A", jl.Vessel(1e-3)),
            "out": jl.Orifice("A", "T", second, transition=1e-3),
            "tank": jl.Tank("T", 1e5),
        },
    )


def between(first, second, supply):
    """A_1^2 (p_s - p) = A_2^2 (p - p_t)."""
    return (first**2 * supply + second**2 * 1e5) / (first**2 + second**2)


@settings(max_examples=25, deadline=None)
@given(*[st.floats(-6.5, -3.5)] * 2, st.floats(2e5, 5e7))
def test_two_orifices_in_series(first, second, supply):
    areas = 10.0**first, 10.0**second
    steady = steady_state(divider(ARTICLE, *areas, supply))
    assert steady["A.pressure"] == pytest.approx(between(*areas, supply), rel=1e-9, abs=2e-2)
    assert steady.free == () and not steady.drifting


def test_mass_flows_balance_with_air():
    steady = steady_state(divider(AIRY, supply=2e6))
    assert steady.residual < 1e-8
    flows = [steady["in.b.flow"], steady["out.a.flow"]]
    assert flows[1] > 1e-5 and flows[0] == pytest.approx(-flows[1], rel=1e-9)


def test_derivatives_are_those_of_the_closed_form():
    circuit = divider(supply="supply")

    def found(x):
        return steady_state(circuit.replace({"in.area": x[0]}), {"supply": x[1]}).initial["A.pressure"]

    with jax.enable_x64(True):
        x = jnp.asarray([2e-6, 20e6])
        size = np.asarray([2e-6, 20e6])
        exact = lambda x: between(x[0], 3e-6, x[1])  # noqa: E731
        value, slope = jax.jit(jax.value_and_grad(found))(x)  # in reverse, through the input and a number
        assert float(value) == pytest.approx(float(exact(x)), rel=1e-9)
        np.testing.assert_allclose(size * slope, size * jax.grad(exact)(x), rtol=1e-7)
        scale = np.outer(size, size)
        second = np.asarray(jax.jit(jax.jacfwd(jax.grad(found)))(x) * scale)
        np.testing.assert_allclose(second, jax.hessian(exact)(x) * scale, rtol=1e-6, atol=1.0)


def test_many_at_once():
    circuit, areas = divider(), np.array([1e-6, 2e-6, 5e-6])
    with jax.enable_x64(True):
        lanes = jax.vmap(lambda a: steady_state(circuit.replace({"in.area": a})).initial["A.pressure"])(areas)
    np.testing.assert_allclose(lanes, between(areas, 3e-6, 20e6), rtol=1e-9)


def test_an_input_is_taken_at_a_time():
    circuit = divider(supply="supply")
    signal = jl.Sampled([0.0, 1.0], [10e6, 20e6])
    assert steady_state(circuit, {"supply": signal}, time=0.5)["A.pressure"] == pytest.approx(between(2, 3, 15e6))


@pytest.fixture(scope="module")
def drive():
    return axis_drive("azimuth")


def test_the_drive_runs_as_it_does_after_a_long_time(drive):
    steady = steady_state(drive, {"spool": -0.2})
    sim = jl.simulate(drive, [0.0, 25.0], {"spool": -0.2}, initial=START, tolerance=1e-9)
    still = jl.simulate(drive, [0.0, 1.0], {"spool": -0.2}, initial=steady.initial, tolerance=1e-9)
    for name in ("A.pressure", "B.pressure", "shaft.speed"):
        assert steady.initial[name] == pytest.approx(sim[name][-1], rel=1e-6)
        np.testing.assert_allclose(still[name], steady.initial[name], rtol=1e-8)
    assert steady.initial["shaft.speed"] < -1.0


def test_one_program_serves_all_values(drive):
    from jaxlines.simulation import steady as module

    steady_state(drive, {"spool": 0.1})
    programs = getattr(module.solve_balance, "_cache_size")  # noqa: B009
    before = programs()
    steady_state(drive.replace({"motor.displacement": 1.2e-4}), {"spool": 0.4})
    assert programs() == before


def closed(fluid, start):
    """Two volumes of 1 and 2 litres that an orifice connects, and nothing else."""
    parts = {"a": jl.Line("A", jl.Vessel(1e-3)), "b": jl.Line("B", jl.Vessel(2e-3))}
    circuit = jl.Circuit(fluid, {**parts, "orifice": jl.Orifice("A", "B", 1e-6)})
    return steady_state(circuit, initial={"A.pressure": start, "B.pressure": 1e6}), circuit


def test_a_closed_circuit_keeps_its_content():
    steady, _ = closed(ARTICLE, 10e6)
    assert steady.free == ("A.pressure", "B.pressure")
    assert steady["A.pressure"] == pytest.approx(4e6, rel=1e-9)  # (10 + 2 * 1)/3 MPa
    assert steady["B.pressure"] == pytest.approx(4e6, rel=1e-9)
    assert "A.pressure is not determined by the balance" in steady.sentences()[0]
    with jax.enable_x64(True):
        slope = jax.grad(lambda start: closed(ARTICLE, start)[0].initial["B.pressure"])(10e6)
    assert float(slope) == pytest.approx(1 / 3, rel=1e-9)


class Angle(AbstractComponent):
    """The angle of a shaft."""

    shaft: str = port(ROTATIONAL)
    states: ClassVar[tuple[State, ...]] = (State("angle", "rad", 1.0),)

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution(rate={"angle": at.potential["shaft"]})


def test_an_angle_runs_on():
    """A torque against a brake: T_b tanh(w/w_0) = T."""
    parts = {"inertia": jl.Inertia("shaft", 2.0), "load": jl.LoadTorque("shaft", 5.0), "encoder": Angle("shaft")}
    brake = jl.Brake("shaft", "T", 8.0, release_pressure=5e6, slip_speed=2.0)
    circuit = jl.Circuit(ARTICLE, {**parts, "brake": brake, "tank": jl.Tank("T")})
    steady = steady_state(circuit, initial={"encoder.angle": 0.7})
    speed = 2.0 * np.arctanh(5.0 / 8.0)
    assert steady.free == ("encoder.angle",)
    assert steady["encoder.angle"] == pytest.approx(0.7, abs=1e-12)
    assert steady["shaft.speed"] == pytest.approx(speed, rel=1e-9)
    assert steady.drifting == {"encoder.angle": pytest.approx(speed, rel=1e-9)}
    assert "encoder.angle runs on at 1.466 rad/s" in steady.sentences()[1]


def speed_loop(controller, damping=4.0, drag=3.0):
    """A shaft with damping and a constant drag, whose torque is a controller's output."""
    parts = {
        "inertia": jl.Inertia("shaft", 2.0),
        "damper": jl.RotaryDamper("shaft", damping),
        "drag": jl.LoadTorque("shaft", -drag),
        "drive": jl.LoadTorque("shaft", "loop"),
        "loop": controller,
    }
    return jl.Circuit(ARTICLE, parts)


@pytest.mark.parametrize(
    "controller",
    [PIController("shaft.speed", 1.5, 10.0, 30.0), SampledController("shaft.speed", 0.02, 1.5, 10.0, 30.0)],
    ids=["continuous", "sampled"],
)
def test_an_integrating_controller_leaves_no_deviation(controller):
    steady = steady_state(speed_loop(controller))
    assert steady.initial["shaft.speed"] == pytest.approx(1.5, rel=1e-9)
    assert steady.initial["loop.integral"] == pytest.approx(4.0 * 1.5 + 3.0, rel=1e-9)


class Distant(AbstractComponent):
    """x' = -x/(1 + x^2): Newton's method runs away from the rest at 0 wherever |x| > 1."""

    node: str = port()
    states: ClassVar[tuple[State, ...]] = (State("x", "1", 1.0),)

    def evaluate(self, at: Situation) -> Contribution:
        x = at.state["x"]
        return Contribution(rate={"x": -x / (1.0 + x * x)})

    def start(self, at: Situation) -> dict:
        return {"x": 30.0 + 0.0 * at.potential["node"]}


def test_the_transient_leads_where_newton_does_not():
    circuit = divider()
    circuit = jl.Circuit(circuit.fluid, {**circuit.components, "distant": Distant("A")})
    steady = steady_state(circuit)
    assert abs(steady["distant.x"]) < 1e-8
    assert steady["A.pressure"] == pytest.approx(between(2, 3, 20e6), rel=1e-9)


def test_laminar_flow_through_a_line_in_segments():
    pipe = jl.Pipe(10.0, 0.01, 0.014)
    line = jl.Line("A", pipe, to="B", segments=4)
    ends = {"pump": jl.FlowSource("A", 1e-4), "tank": jl.Tank("B", 1e6)}
    circuit = jl.Circuit(ARTICLE, {**ends, "line": line, "inlet": jl.Line("A", jl.Vessel(1e-4))})
    steady = steady_state(circuit)
    drop = 128 * 27.7e-6 * 850 * 10.0 * 1e-4 / (np.pi * 0.01**4)
    assert steady["A.pressure"] == pytest.approx(1e6 + drop, rel=1e-9)
    assert steady.initial["line.volume_flow"].shape == line.ladder().cut.columns.shape
    sim = jl.simulate(circuit, [0.0, 0.1], initial=steady.initial, tolerance=1e-10)
    np.testing.assert_allclose(sim["A.pressure"], drop + 1e6, rtol=1e-8)


def test_slow_states():
    oil = jl.Oil(1.4e9, 850.0, 30e-6, 0.01, air=jl.KineticAir(jl.PolynomialSolubility(), 0.1, 5.0))
    hose = {"line": jl.Line("A", jl.ViscoelasticHose(2.0, 0.02, 3e8, 8e8, 0.05))}
    steady = steady_state(jl.Circuit(oil, {**divider().components, **hose}))
    strain = (steady.initial["A.pressure"] - 101325.0) * (1 / 3e8 - 1 / 8e8)
    assert steady.initial["line.parts.0.delayed_strain"] == pytest.approx(strain, rel=1e-8)
    air = oil.undissolved_air(steady.initial["A.pressure"])
    assert steady.initial["line.undissolved_air"] == pytest.approx(air, rel=1e-6, abs=1e-9)


def test_single_precision():
    single = steady_state(divider(), precision="float32").initial["A.pressure"]
    assert single.dtype == np.float32
    assert single == pytest.approx(between(2, 3, 20e6), rel=1e-3)


def test_what_will_not_balance_is_named():
    fed: dict = {"pump": jl.FlowSource("A", 1e-5), "line": jl.Line("A", jl.Vessel(1e-3))}
    with pytest.raises(RuntimeError, match=r"node 'A' will not balance: 1e-05 m\^3/s more flow in than out.*nothing"):
        steady_state(jl.Circuit(ARTICLE, fed))
    tank = {"tank": jl.Tank("T"), "leak": jl.LaminarLeak("T", "A", 1e-12)}
    with pytest.raises(RuntimeError, match=r"node 'A' will not balance: -.*more is asked of it than can flow"):
        steady_state(jl.Circuit(ARTICLE, {**fed, **tank, "pump": jl.FlowSource("A", -1e-3)}))
    shaft = {"inertia": jl.Inertia("shaft", 2.0), "load": jl.LoadTorque("shaft", 5.0)}
    with pytest.raises(RuntimeError, match=r"node 'shaft' will not balance: 5 N\*m more torque in than out"):
        steady_state(jl.Circuit(ARTICLE, shaft))


def test_traced_failure_is_not_a_number():
    circuit = jl.Circuit(ARTICLE, {"pump": jl.FlowSource("A", 1e-5), "line": jl.Line("A", jl.Vessel(1e-3))})
    with jax.enable_x64(True):
        end = jax.jit(lambda q: steady_state(circuit.replace({"pump.flow": q})).initial["A.pressure"])
        assert np.isnan(end(1e-5))


def test_wrong_calls(drive):
    with pytest.raises(ValueError, match="needs an input 'spool'"):
        steady_state(drive)
    with pytest.raises(KeyError, match=r"no state is called 'C\.pressure'"):
        steady_state(drive, {"spool": 0.0}, initial={"C.pressure": 1e6})
