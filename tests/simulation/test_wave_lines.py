"""Lines in segments: totals, steady flow, waves, conservation, gradients, the choice of the number of segments."""

from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import jaxlines as jl
from jaxlines.physics.component import Situation
from jaxlines.physics.containers import volume_at
from jaxlines.physics.fields import GRAVITY
from jaxlines.physics.ladder import cut
from jaxlines.physics.validity import ladder_delay_error

REFERENCE = Path(__file__).parents[2] / "../shared/reference"
LINEAR = jl.Oil(1e9, 870.0, 0.03 / 870.0, mass="article")


def rigid_pipe(length, diameter, roughness=0.0) -> jl.Pipe:
    return jl.Pipe(length, diameter, 20 * diameter, youngs_modulus=1e13, roughness=roughness)


def fed_line(line: jl.Line, flow, end, fluid=LINEAR) -> jl.Circuit:
    """A flow source, a line from "in" to "out", and what is at its end."""
    return jl.Circuit(fluid, {"source": jl.FlowSource("in", flow), "line": line, **end})


@pytest.mark.parametrize("segments", [1, 2, 3, 7, 40])
@pytest.mark.parametrize("model", ["pi", "T"])
def test_parts_add_up_to_the_line(segments, model):
    pieces = cut(segments, model)
    assert np.sum(pieces.columns) == pytest.approx(1.0, rel=1e-14)
    assert np.sum(pieces.volumes) == pytest.approx(1.0, rel=1e-14)
    assert pieces.positions()[-1] == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize("segments", [1, 2, 9])
@pytest.mark.parametrize("model", ["pi", "T"])
def test_total_drop_inertance_and_capacity(segments, model):
    """At uniform flow the drop is Hagen and Poiseuille's and the head's; at rest a pressure difference accelerates
    the whole column: sum of dp = R Q + rho g dz, dQ/dt = dp A/(rho L); capacities add up to the line's."""
    pipe = rigid_pipe(10.0, 0.01)
    line = jl.Line("in", pipe, to="out", segments=segments, model=model, elevation=3.0)
    states = {s.name: np.zeros(s.shape) for s in line.states_in(LINEAR)}
    flow, rest = 1e-4, 870.0 * GRAVITY * 3.0
    drop = 128 * 0.03 * 10.0 * flow / (np.pi * 0.01**4)
    positions = cut(segments, model).positions()
    with jax.enable_x64(True):
        ends = {"node": np.asarray(2e6), "to": np.asarray(2e6 - drop - rest)}
        steady = states | {"volume_flow": np.full(states["volume_flow"].shape, flow)}
        if "pressure" in states:
            steady["pressure"] = 2e6 - (drop + rest) * positions[1:-1]
        done = line.evaluate(Situation(LINEAR, ends, steady, {}))
        scale = 1e6 * np.pi / 4 * 0.01**2 / (870 * 10.0)
        np.testing.assert_allclose(done.rate["volume_flow"], 0.0, atol=1e-10 * scale)
        assert float(done.flow["node"]) == pytest.approx(-870 * flow, rel=1e-12)
        assert float(done.flow["to"]) == pytest.approx(870 * flow, rel=1e-12)
        pushed = states | ({"pressure": 1e6 * (1 - positions[1:-1])} if "pressure" in states else {})
        done = jl.Line("in", pipe, to="out", segments=segments, model=model).evaluate(
            Situation(LINEAR, {"node": np.asarray(1e6), "to": np.asarray(0.0)}, pushed, {})
        )
        np.testing.assert_allclose(done.rate["volume_flow"], scale, rtol=1e-12)
        total = 870 * float(pipe.reference_volume()) / 1e9
        if model == "pi":
            assert float(done.capacity["node"] + done.capacity["to"]) == pytest.approx(total / segments, rel=1e-6)
        else:
            assert not done.capacity


def steady_drop(friction, flow, length, diameter, density, viscosity, roughness=0.0) -> float:
    """Pressure drop of a line at constant flow, from a simulation that has come to rest."""
    fluid = jl.Oil(2.2e9, density, viscosity / density, mass="article")
    line = jl.Line("in", rigid_pipe(length, diameter, roughness), to="out", segments=4, friction=friction)
    circuit = fed_line(line, flow, {"tank": jl.PressureSource("out", 1e5)}, fluid)
    start = {"in.pressure": 1e5, "line.volume_flow": flow}
    sim = jl.simulate(circuit, [0.0, 200 * length / 1400], initial=start, max_steps=1_000_000)
    return float(sim["in.pressure"][-1] - 1e5)


@pytest.mark.parametrize(("drop", "mass_flow"), [(1e5, 2.4452608), (98020.0, 2.4198643), (5e4, 1.6996304)])
@pytest.mark.parametrize("friction", [jl.HaalandFriction(), jl.ChurchillFriction()])
def test_turbulent_pipe_of_modelica(drop, mass_flow, friction):
    """Modelica Standard Library, Modelica.Fluid StaticPipe: water, 10 m of 25.4 mm, roughness 25 um."""
    ours = steady_drop(friction, mass_flow / 995.586, 10.0, 0.0254, 995.586, 1e-3, roughness=2.5e-5)
    assert ours == pytest.approx(drop, rel=0.015)  # Haaland and Churchill are within 2 % of Colebrook


@pytest.mark.parametrize(("drop", "mass_flow"), [(0.8118, 1.9924570), (16.072, 39.446623), (32.472, 79.698279)])
def test_laminar_pipe_of_modelica(drop, mass_flow):
    """Modelica Standard Library, dp_laminar: 1 m of 100 mm, mu 1e-3 Pa s; linear at any Reynolds number."""
    velocity = mass_flow / 1000.0 / (np.pi / 4 * 0.1**2)
    assert jl.LaminarFriction().gradient(velocity, 0.1, 1000.0, 1e-6) == pytest.approx(drop, rel=2e-6)


def hopsan_line(segments, flow, viscosity, conductance, base, friction) -> jl.Circuit:
    """Hopsan's line case: 10 m of 10 mm, flow step at 0.01 s, laminar orifice at the end."""
    fluid = jl.Oil(1e9, 870.0, viscosity / 870.0, mass="article")
    line = jl.Line("in", rigid_pipe(10.0, 0.01), to="out", segments=segments, friction=friction)
    end = {"end": jl.LaminarLeak("out", "T", conductance), "tank": jl.PressureSource("T", base)}
    return fed_line(line, jl.Step(0.0, flow, 0.01), end, fluid)


@pytest.mark.parametrize(("segments", "limit"), [(20, 0.025), (80, 0.016)])
def test_laminar_line_of_hopsan(segments, limit):
    file = REFERENCE / "hopsan/hop1_laminar_line_step.csv"
    if not file.exists():
        pytest.skip(f"the reference data {file.name} is not beside the project")
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    circuit = hopsan_line(segments, 1e-4, 0.03, 1e-10, 1e5, jl.LaminarFriction())
    sim = jl.simulate(circuit, table[:, 0], initial={"in.pressure": 1e5, "out.pressure": 1e5})
    error = sim["out.pressure"] - table[:, 3]
    assert np.sqrt(np.mean(error**2)) < limit * np.ptp(table[:, 3])


def test_steady_lines_of_hopsan():
    """Printed steady pressures: laminar p_in 1222231 (by hand), turbulent Blasius drop 2.05432 MPa at Re 13846."""
    circuit = hopsan_line(4, 1e-4, 0.03, 1e-10, 1e5, jl.LaminarFriction())
    sim = jl.simulate(circuit, [0.0, 3.0], initial={"in.pressure": 1e5, "out.pressure": 1e5}, tolerance=1e-9)
    assert sim["in.pressure"][-1] == pytest.approx(1222231, abs=2)
    assert sim["out.pressure"][-1] == pytest.approx(1.1e6, abs=2)
    circuit = hopsan_line(4, 1e-3, 0.008, 1e-9, 2e7, jl.HaalandFriction())
    sim = jl.simulate(circuit, [0.0, 3.0], initial={"in.pressure": 2e7, "out.pressure": 2e7})
    assert sim["in.pressure"][-1] - sim["out.pressure"][-1] == pytest.approx(
        2.05432e6, rel=0.03
    )  # Haaland is 2.9 % below Blasius


def test_lossless_line_of_hopsan():
    """Hopsan's shipped line test: delay 0.1 s, impedance 1e9 Pa s/m^3, flow 1e-5 then 1.1e-5 m^3/s from 0.1 s, an end
    at 1e6 Pa behind 1e-4 m^3/(s Pa). The ladder rings at every front; between them its mean is the step's level."""
    file = REFERENCE / "hopsan/HydraulicLineTest.hvd"
    if not file.exists():
        pytest.skip(f"the reference data {file.name} is not beside the project")
    table, base = np.loadtxt(file, delimiter=","), 1e7  # all pressures raised, far from vacuum
    fluid = jl.Oil(1e9, 1000.0, 1e-8, mass="article")
    line = jl.Line("in", rigid_pipe(100.0, np.sqrt(4e-3 / np.pi)), to="out", segments=80)
    end = {"end": jl.LaminarLeak("out", "T", 1e-4), "tank": jl.PressureSource("T", 1e6 + base)}
    circuit = fed_line(line, jl.Step(1e-5, 1.1e-5, 0.1), end, fluid)
    times = np.linspace(0.0, 0.4, 4001)
    start = {"in.pressure": base, "out.pressure": base}
    sim = jl.simulate(circuit, times, initial=start, solver=jl.implicit(), outputs=["in.pressure"], tolerance=1e-6)
    for low, high in ((0.02, 0.09), (0.12, 0.19), (0.22, 0.29), (0.32, 0.39)):
        ours = np.mean(sim["in.pressure"][(times > low) & (times < high)]) - base
        theirs = np.mean(table[(table[:, 0] > low) & (table[:, 0] < high), 1])
        assert ours == pytest.approx(theirs, abs=0.01 * 2e6)


@pytest.mark.parametrize("segments", [1, 2, 4, 8])
def test_frequency_of_a_closed_line(segments):
    """First mode of a lossless line, open at one end: omega L/c = 2 n sin(pi/(4 n)), computed 1.414214, ..."""
    expected = {1: 1.414214, 2: 1.530734, 4: 1.560723, 8: 1.568274}[segments]
    fluid = jl.Oil(1e9, 1000.0, 1e-8, mass="article")  # c = 1000 m/s
    line = jl.Line("in", rigid_pipe(10.0, 0.05), to="out", segments=segments)
    circuit = jl.Circuit(fluid, {"supply": jl.PressureSource("in", 1.1e6), "line": line})
    times = np.linspace(0.0, 0.4, 4001)
    sim = jl.simulate(circuit, times, initial={"out.pressure": 1e6, **_first_mode(segments)}, tolerance=1e-9)
    swing = sim["out.pressure"] - 1.1e6
    crossings = np.flatnonzero(np.diff(np.sign(swing)))
    at = times[crossings] - swing[crossings] * np.diff(times)[0] / (swing[crossings + 1] - swing[crossings])
    half = (at[-1] - at[0]) / (len(at) - 1)
    speed = float(line.wave_speed(fluid, 1.1e6))
    assert np.pi / half * 10.0 / speed == pytest.approx(expected, rel=2e-6)


def _first_mode(segments) -> dict:
    """Inner pressures in the shape of the first mode, with amplitude -1e5 Pa at the closed end."""
    if segments == 1:
        return {}
    return {"line.pressure": 1.1e6 - 1e5 * np.sin(np.pi / 2 * np.arange(1, segments) / segments)}


AIR = jl.Oil(1.4e9, 870.0, 30e-6, air_fraction=0.01, polytropic_index=1.2)


def stored_mass(sim, name: str, node: str, to: str):
    """Mass in a segmented line of the pi model, from what was saved [kg]."""
    line, fluid = sim.circuit.components[name], sim.circuit.fluid
    inner = [sim[f"{name}.pressure.{i}"] for i in range(line.segments - 1)]
    pressures = np.stack([sim[f"{node}.pressure"], *inner, sim[f"{to}.pressure"]])
    mass = fluid.density_at(pressures) * volume_at(line.parts[0], fluid, pressures)
    return np.tensordot(cut(line.segments, "pi").volumes, mass, 1)


@pytest.mark.slow
def test_mass_is_conserved_through_cavitation_and_back():
    """A closed line whose inlet is drawn down to 2 kPa, where air fills most of it, and brought back."""
    oil = jl.Oil(1.4e9, 870.0, 30e-6, air_fraction=0.003, polytropic_index=1.2)
    line = jl.Line("in", jl.Pipe(5.0, 0.02, 0.03), to="out", segments=6, friction=jl.ChurchillFriction())
    pull = jl.Sampled([0.0, 0.2, 1.0, 1.3, 6.0], [5e5, 2e2, 2e2, 5e5, 5e5], "cubic")
    parts = {"line": line, "pump": jl.PressureSource("P", pull), "valve": jl.Orifice("P", "in", 1e-4)}
    times = np.linspace(0.0, 6.0, 60001)
    start = {"in.pressure": 5e5, "out.pressure": 5e5}
    outputs = ["in.pressure", "out.pressure", *(f"line.pressure.{i}" for i in range(5)), "valve.b.flow"]
    sim = jl.simulate(jl.Circuit(oil, parts), times, initial=start, tolerance=1e-7, outputs=outputs, max_steps=10**6)
    assert 0 < sim.lowest_pressure < 2e3
    mass = stored_mass(sim, "line", "in", "out")
    fed = -oil.density_at(sim["in.pressure"]) * sim["valve.b.flow"]
    total = np.concatenate([[0.0], np.cumsum(0.5 * (fed[1:] + fed[:-1]) * np.diff(times))])
    assert np.min(mass) < 0.95 * mass[0]
    np.testing.assert_allclose(mass - mass[0], total, atol=2e-5 * np.ptp(mass))
    assert mass[-1] == pytest.approx(mass[0], rel=2e-6)


@pytest.mark.parametrize("weights", [None, jl.VitkovskyWeights(6)])
def test_a_line_creates_no_energy(weights):
    """Over a closed cycle from rest to rest the work done at both ends is positive."""

    @settings(max_examples=4, deadline=None)
    @given(
        amplitude=st.floats(1e-6, 2e-4),
        frequency=st.floats(20.0, 60.0),
        conductance=st.floats(1e-13, 1e-10),
        friction=st.sampled_from([jl.LaminarFriction(), jl.HaalandFriction(), jl.ChurchillFriction()]),
    )
    def check(amplitude, frequency, conductance, friction):
        line = jl.Line("in", jl.Pipe(5.0, 0.012, 0.02), to="out", segments=5, friction=friction, weights=weights)
        signal = jl.Sine(amplitude=amplitude, frequency=frequency)
        end = {"end": jl.LaminarLeak("out", "T", conductance), "tank": jl.PressureSource("T", 5e6)}
        circuit = fed_line(line, signal, end, jl.Oil(1.4e9, 870.0, 30e-6, mass="article"))
        times = np.linspace(0.0, 6.0 / frequency, 2001)
        outputs = ["in.pressure", "out.pressure", "end.a.flow", "line.node.flow", "line.to.flow"]
        sim = jl.simulate(circuit, times, initial={"in.pressure": 5e6, "out.pressure": 5e6}, outputs=outputs)
        power = (sim["in.pressure"] - 5e6) * amplitude * np.sin(2 * np.pi * frequency * times)
        power = power - (sim["out.pressure"] - 5e6) * sim["end.a.flow"]
        work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(times))])
        assert np.min(work) >= -1e-3 * np.max(np.abs(work))  # never more comes out than went in

    check()


def segments_of(circuit: jl.Circuit) -> int | str:
    line = circuit.components["line"]
    assert isinstance(line, jl.Line)
    return line.segments


def test_segments_are_chosen_from_frequency_and_wave_speed():
    """N = 20 f L/c: with c = 1072 m/s and 10 m, 400 Hz need 75 segments; by default at least 8, at most 200."""
    line = jl.Line("in", rigid_pipe(10.0, 0.01), to="out")
    circuit = fed_line(line, jl.Sine(amplitude=1e-5, frequency=50.0), {"tank": jl.Tank("out", 5e6)})
    times = np.linspace(0.0, 1.0, 1001)
    speed = np.sqrt(1e9 / 870)
    chosen = jl.choose_segments(circuit, times, highest_frequency=400.0)
    assert segments_of(chosen) == int(np.ceil(20 * 400 * 10 / speed))
    assert segments_of(jl.choose_segments(circuit, times)) == 10  # 50 Hz: 9.3 and the window's edge
    quiet = jl.choose_segments(circuit.replace({"source.flow.frequency": 1.0}), times)
    assert segments_of(quiet) == 8
    with pytest.warns(UserWarning, match=r"line: \d+ segments would be needed for 5e\+03 Hz .* 200 are used"):
        most = jl.choose_segments(circuit, times, highest_frequency=5e3)
    assert segments_of(most) == 200
    sim = jl.simulate(circuit, times, initial={"in.pressure": 5e6})
    report = sim.validity(highest_frequency=50.0)
    assert report.waves[0].segments == 10 and report.waves[0].delay_error < 0.0041
    assert "10 segments" in report.sentences()[0] and "per wavelength" in report.sentences()[0]


def test_delay_error_of_a_ladder():
    """1 - sin(pi/N)/(pi/N): 1.6 % at 10 segments a wavelength, 0.41 % at 20, 0.10 % at 40."""
    np.testing.assert_allclose(ladder_delay_error(np.array([10, 20, 40])), [0.0164, 0.00411, 0.00103], rtol=6e-3)


def test_traced_numbers_need_a_number_of_segments():
    line = jl.Line("in", rigid_pipe(10.0, 0.01), to="out")
    circuit = fed_line(line, 1e-5, {"tank": jl.Tank("out")})

    def last(modulus):
        sim = jl.simulate(circuit.replace({"fluid.bulk_modulus": modulus}), [0.0, 0.1])
        return sim["in.pressure"][-1]

    with jax.enable_x64(True), pytest.raises(ValueError, match=r"of 'line' cannot be chosen .*choose_segments"):
        jax.grad(last)(1e9)


def test_gradient_through_waves_and_turbulence():
    """Exact derivatives by modulus, bore and roughness against central differences, turbulent flow with reversal."""
    line = jl.Line(
        "in", jl.Pipe(8.0, 0.01, 0.014, roughness=1e-5), to="out", segments=6, friction=jl.ChurchillFriction(),
        weights=jl.TrikhaWeights(), loss_coefficient=2.0,
    )  # fmt: skip
    circuit = fed_line(line, jl.Sine(amplitude=6e-4, frequency=20.0), {"tank": jl.Tank("out", 5e6)}, AIR)
    paths = ("fluid.bulk_modulus", "line.inner_diameter", "line.roughness", "fluid.kinematic_viscosity")
    start = {"in.pressure": 5e6}
    times = np.linspace(0.0, 0.1, 21)

    def ends(numbers):
        changed = circuit.replace(dict(zip(paths, numbers, strict=True)))
        sim = jl.simulate(
            changed, times, initial=start, outputs=["in.pressure"], tolerance=1e-11, gradient="forward", max_step=1e-3
        )
        return sim["in.pressure"]

    numbers = np.array([1.4e9, 0.01, 1e-5, 30e-6])
    with jax.enable_x64(True):
        exact = np.asarray(jax.jacfwd(ends)(numbers))
        assert np.all(np.isfinite(exact))
        for i, number in enumerate(numbers):
            step = np.zeros(4)
            step[i] = 1e-4 * number
            slope = (np.asarray(ends(numbers + step)) - np.asarray(ends(numbers - step))) / (2e-4 * number)
            np.testing.assert_allclose(exact[:, i], slope, atol=2e-5 * np.max(np.abs(slope)))


def test_one_program_for_all_numbers_and_float32():
    line = jl.Line("in", rigid_pipe(10.0, 0.01), to="out", segments=5)
    circuit = fed_line(line, 1e-4, {"tank": jl.Tank("out", 5e6)})
    times = np.linspace(0.0, 0.5, 11)
    start = {"in.pressure": 5e6}
    first = jl.simulate(circuit, times, initial=start)
    from jaxlines.simulation import simulate as module

    compiled = module._run._cache_size()  # pyright: ignore[reportAttributeAccessIssue]
    other = jl.simulate(
        circuit.replace({"line.inner_diameter": 0.011, "line.elevation": 2.0}), times, initial={"in.pressure": 5.1e6}
    )
    assert module._run._cache_size() == compiled  # pyright: ignore[reportAttributeAccessIssue]
    assert other["in.pressure"][-1] != first["in.pressure"][-1]
    single = jl.simulate(circuit, times, initial=start, precision="float32", tolerance=1e-4)
    np.testing.assert_allclose(single["in.pressure"], first["in.pressure"], rtol=2e-2)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jl.Line("a", rigid_pipe(1, 0.01), to="b", segments=0), "segments must be .* 1 to 10000, got 0"),
        (lambda: jl.Line("a", rigid_pipe(1, 0.01), segments=4), "need the node at the line's other end"),
        (lambda: jl.Line("a", rigid_pipe(1, 0.01), to="b", model="L"), 'model must be "pi" or "T", got \'L\''),
        (lambda: jl.Line("a", [jl.Vessel(1e-3)], to="b"), "one conduit .* got Vessel: join several Lines"),
        (lambda: jl.Line("a", rigid_pipe(1, 0.01), to="b", elevation=-3e5), "elevation must be .* given in mm"),
    ],
)
def test_wrong_lines_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_line_between_two_nodes_without_segments_names_the_cure():
    line = jl.Line("in", rigid_pipe(10.0, 0.01), to="out", segments=5)
    circuit = fed_line(line, 1e-4, {"tank": jl.Tank("out")})
    with pytest.raises(ValueError, match=r"'line.pressure' must be one number or have shape \(4,\), got \(3,\)"):
        jl.simulate(circuit, [0.0, 0.1], initial={"line.pressure": [1e5, 1e5, 1e5]})
