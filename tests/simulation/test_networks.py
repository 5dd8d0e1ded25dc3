"""Networks: programs that do not grow with them, wide junctions, signals and sources packed by kind."""

import jax
import numpy as np
import pytest
from scipy.linalg import expm

import jaxlines as jl
from jaxlines.simulation.assembly import compile_circuit, number_locations, set_numbers
from jaxlines.simulation.integration import integrate, make_method

OIL = jl.Oil(1.4e9, 850.0, 30e-6, mass="article")
TIMES = np.linspace(0.0, 0.5, 11)


def manifold(branches: int, sources: int = 0) -> jl.Circuit:
    """Vessels around one junction, some of them leaking to a source of their own pressure."""
    random = np.random.default_rng(1)
    parts: dict = {"hub": jl.Line("H", jl.Vessel(1e-3))}
    for i in range(branches):
        parts[f"vessel{i}"] = jl.Line(f"v{i}", jl.Vessel(random.uniform(1e-4, 1e-3)))
        parts[f"leak{i}"] = jl.LaminarLeak("H", f"v{i}", random.uniform(1e-12, 1e-11))
    for i in range(sources):
        parts[f"out{i}"] = jl.LaminarLeak(f"v{i}", f"s{i}", 1e-12)
        parts[f"source{i}"] = jl.PressureSource(f"s{i}", random.uniform(1e6, 9e6))
    return jl.Circuit(OIL, parts)


def exact(circuit: jl.Circuit, start: dict, times):
    """Pressures by the matrix exponential, from the circuit's numbers alone."""
    parts = circuit.components
    stores = {part.node: 1.4e9 / float(part.volume()) for part in parts.values() if isinstance(part, jl.Line)}
    held = {part.node: float(part.pressure) for part in parts.values() if isinstance(part, jl.PressureSource)}
    names, n = list(stores), len(stores)
    matrix = np.zeros((n + 1, n + 1))
    for part in parts.values():
        if isinstance(part, jl.LaminarLeak):
            for here, there in ((part.a, part.b), (part.b, part.a)):
                if here in stores:
                    row, rate = names.index(here), stores[here] * float(part.conductance)
                    matrix[row, row] -= rate
                    matrix[row, names.index(there) if there in stores else n] += rate * held.get(there, 1.0)
    state = np.append([start.get(name, 101325.0) for name in names], 1.0)
    return names, np.stack([(expm(matrix * t) @ state)[:n] for t in times])


@pytest.mark.parametrize(("branches", "sources"), [(5, 2), (120, 40)])
def test_a_wide_junction_against_the_matrix_exponential(branches, sources):
    circuit = manifold(branches, sources)
    sim = jl.simulate(circuit, TIMES, initial={"H.pressure": 2e7}, tolerance=1e-9)
    names, pressures = exact(circuit, {"H": 2e7}, TIMES)
    for i, name in enumerate(names):
        np.testing.assert_allclose(sim[f"{name}.pressure"], pressures[:, i], rtol=1e-7)


def test_wide_junctions_do_not_pad_narrow_ones():
    """A square table of all nodes would have 250 000 positions."""
    plan, _ = compile_circuit(manifold(500))
    positions = sum(len(table) * len(table[0]) for table in plan.flow.tables)
    assert positions < 2 * 1000 and len(plan.flow.tables) == 2


def driven(count: int, signal) -> jl.Circuit:
    """Vessels filled by flow sources, each with a signal of its own."""
    parts: dict = {f"vessel{i}": jl.Line(f"v{i}", jl.Vessel(1e-3)) for i in range(count)}
    parts |= {f"pump{i}": jl.FlowSource(f"v{i}", signal(i)) for i in range(count)}
    return jl.Circuit(OIL, parts)


@pytest.mark.parametrize(
    ("signal", "volume"),
    [
        (
            lambda i: jl.Sine(0.0, 1e-5 * (i + 1), 1.0 + i),
            lambda i, t: 1e-5 / (2 * np.pi) * (1 - np.cos(2 * np.pi * (1 + i) * t)),
        ),
        (lambda i: jl.Step(0.0, 1e-5, 0.03 * i + 0.01), lambda i, t: 1e-5 * np.maximum(t - 0.03 * i - 0.01, 0.0)),
        (
            lambda i: jl.Sampled([0.0, 0.1 + 0.01 * i, 1.0], [1e-5, -2e-5, 0.0], "hold"),
            lambda i, t: 1e-5 * np.minimum(t, 0.1 + 0.01 * i) - 2e-5 * np.maximum(t - 0.1 - 0.01 * i, 0.0),
        ),
    ],
    ids=["sine", "step", "held samples"],
)
def test_signals_of_one_kind_are_evaluated_together(signal, volume):
    sim = jl.simulate(driven(7, signal), TIMES, initial={f"v{i}.pressure": 2e7 for i in range(7)}, tolerance=1e-9)
    for i in range(7):
        rise = 1.4e9 / 1e-3 * volume(i, TIMES)
        np.testing.assert_allclose(sim[f"v{i}.pressure"] - 2e7, rise, atol=1e-6 * np.max(np.abs(rise)))


def test_numbers_of_packed_signals_keep_their_names():
    circuit = driven(3, lambda i: jl.Sine(0.0, 1e-5, 1.0 + i))
    plan, values = compile_circuit(circuit)
    known = number_locations(plan, values)
    assert set(circuit.paths()) == {path for path in known if not path.startswith("initial.")}
    with jax.enable_x64(True):
        changed = set_numbers(values, [known["pump1.flow.amplitude"]], np.array([3e-5]))
        method = make_method(None, "forward", 1000)
        found = integrate(plan, ("v0.pressure", "v1.pressure"), method, changed, TIMES, np.asarray(1e-9)).outputs
    expected = jl.simulate(circuit.replace({"pump1.flow.amplitude": 3e-5}), TIMES, tolerance=1e-9)
    np.testing.assert_allclose(found[:, 1], expected["v1.pressure"], rtol=1e-12)
    np.testing.assert_allclose(found[:, 0], expected["v0.pressure"], rtol=1e-12)


def operations(circuit: jl.Circuit) -> int:
    """Operations of the program that simulates a circuit, the inner ones of its loops included."""
    with jax.enable_x64(True):
        plan, values = compile_circuit(circuit)
        run = jax.jit(integrate, static_argnums=(0, 1, 2))
        wanted = tuple(f"{node}.pressure" for node, _ in plan.free_nodes)
        program = run.lower(plan, wanted, make_method(None, "forward", 1000), values, TIMES, np.asarray(1e-6))
    return program.as_text().count(" = ")


def test_programs_do_not_grow_with_the_network():
    """Junctions, sources with pressures of their own, signals of their own."""
    assert operations(manifold(200, 150)) <= operations(manifold(50, 30)) + 20
    many, few = (operations(driven(n, lambda i: jl.Sine(0.0, 1e-5, 1.0 + i))) for n in (200, 10))
    assert many == few


def test_one_traced_number_among_many_members():
    """Numbers of the host stay one array when JAX traces a single one of them."""
    circuit = manifold(60)

    def end(conductance):
        changed = circuit.replace({"leak7.conductance": conductance})
        options = {"initial": {"H.pressure": 2e7}, "outputs": ["v7.pressure"], "gradient": "forward", "tolerance": 1e-9}
        return jl.simulate(changed, TIMES, **options)["v7.pressure"][-1]

    at = float(circuit["leak7.conductance"])
    with jax.enable_x64(True):
        slope = float(jax.jacfwd(end)(at))
        assert len(str(jax.make_jaxpr(end)(at)).splitlines()) < 3000
    step = 1e-3 * at
    ends = [exact(circuit.replace({"leak7.conductance": at + s}), {"H": 2e7}, TIMES[-1:]) for s in (step, -step)]
    column = ends[0][0].index("v7")
    assert slope == pytest.approx((ends[0][1][0, column] - ends[1][1][0, column]) / (2 * step), rel=1e-4)
