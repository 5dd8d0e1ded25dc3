"""Every component: exact derivatives everywhere, conservation of mass, elementwise evaluation."""

import dataclasses
import inspect
import typing

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import jaxlines as jl
from jaxlines.physics.component import AbstractComponent, Situation
from jaxlines.physics.controllers import AbstractController
from jaxlines.physics.fields import driven_of, ports_of
from jaxlines.physics.resistances import orifice_flow, regularised_root

PARTS = {
    "pressure source": jl.PressureSource("a", 2e7),
    "tank": jl.Tank("a"),
    "flow source": jl.FlowSource("a", 1e-4),
    "line": jl.Line("a", [jl.Pipe(12.8, 0.04285, 0.06032), jl.Vessel(3e-3, 4e9), jl.Vessel(1e-3, 1e9)], 20.0),
    "leak": jl.LaminarLeak("a", "b", 5e-12),
    "orifice": jl.Orifice("a", "b", 5e-6),
    "inertia of fluid": jl.FluidInertia("a", "b", 1e7, 1e6, 1e10),
    "servovalve": jl.Servovalve("s", "t", "a", "b", 0.3, 1e-3),
    "motor": jl.Motor("a", "b", "c", "shaft", 1e-4, 5e-12, 2e-12, 2.0, 0.03, 5.0),
    "inertia": jl.Inertia("shaft", 40.0),
    "load": jl.LoadTorque("shaft", 100.0),
    "brake": jl.Brake("shaft", "a", 500.0),
    "supercharge": jl.Supercharge("s", "l"),
    "hose that creeps": jl.Line("a", [jl.ViscoelasticHose(2.0, 0.02, 3e8, 8e8, 0.05), jl.Vessel(1e-4)]),
    "segments, pi": jl.Line("a", jl.Pipe(8.0, 0.02, 0.03), to="b", segments=3, elevation=2.0, loss_coefficient=3.0),
    "segments, T": jl.Line(
        "a",
        jl.ViscoelasticHose(2.0, 0.02, 3e8, 8e8, 0.05, roughness=1e-5),
        to="b",
        segments=2,
        model="T",
        friction=jl.ChurchillFriction(),
        weights=jl.TrikhaWeights(),
    ),
    "accumulator": jl.Accumulator("a", 1e-3, 5e6),
    "pump": jl.Pump("a", "b", 1e-4, 100.0, jl.WilsonLosses(5e-8, 1e5, 0.02)),
    "compensated pump": jl.PressureCompensatedPump(
        "a", "b", 1e-5, 150.0, 2e6, 7e6, losses=jl.WilsonLosses(5e-8, 0.0, 0.0)
    ),
    "minor loss": jl.MinorLoss("a", "b", 1.5, 1e-4),
    "annular leak": jl.AnnularLeak("a", "b", 0.02, 1e-5, 0.03, 0.4),
    "curve valve": jl.CurveValve("a", "b", 0.3, [0.0, 0.2, 0.5, 1.0], [1e-7, 1e-6, 4e-6, 9e-6]),
    "table valve": jl.TableValve(
        "a", "b", 0.3, [0.0, 0.5, 1.0], [4.7e6, 1.1e7], [[1e-6, 2e-6], [5e-5, 1e-4], [1e-4, 3e-4]]
    ),
    "valve 2/2": jl.Valve22("a", "b", 0.7, 1e-5),
    "valve 4/3": jl.ProportionalValve43(
        "s", "t", "a", "b", 0.3, 1e-3, deadband=0.05, lap_supply_a=0.1, null_leakage=2e-12
    ),
    "check valve": jl.CheckValve("a", "b", 1e-3, 3e6, 8e6),
    "relief valve": jl.ReliefValve("a", "b", 1e-3, 3e6, 8e6),
    "counterbalance valve": jl.CounterbalanceValve("a", "b", "p", 1e-3, 3e6, 8e6, pilot_ratio=1.0),
    "reducing valve": jl.ReducingValve("a", "b", "d", 1e-3, 6.1e6, 4e6),
    "motor with Wilson's losses": jl.Motor("a", "b", "c", "shaft", 1e-4, losses=jl.WilsonLosses(1e-8, 1e5, 0.03)),
    "bent-axis motor": jl.BentAxisMotor(
        "a", "b", "c", "shaft", 5e-4, 0.06, 0.6, 7, 0.2, 5e-12, 2e-12, 2.0, 0.03, 5.0, losses=jl.WilsonLosses(1e-8, 1e5)
    ),
    "double-rod cylinder": jl.DoubleRodCylinder(
        "a", "b", "rod", 1e-3, 0.5, 3e-4, 2e-4, 1e-12, 20.0, 100.0, 200.0, 90.0
    ),
    "single-rod cylinder": jl.SingleRodCylinder(
        "a", "b", "rod", 2e-3, 1e-3, 0.1, 3e-4, 2e-4, 1e-12, None, 100.0, 200.0, 90.0
    ),
    "rotary actuator": jl.RotaryActuator("a", "b", "shaft", 1e-4, 1.2, 2e-4, 2e-4, 1e-11, 0.5, 10.0, 20.0, 9.0),
    "mass": jl.Mass("m", 20.0),
    "force": jl.Force("m", 100.0),
    "spring": jl.Spring("m", 1e5, 10.0, "n"),
    "torsion spring": jl.RotarySpring("m", 1e5, 10.0),
    "damper": jl.Damper("m", 1e3, "n"),
    "rotary damper": jl.RotaryDamper("m", 1e3),
    "sliding friction": jl.SlidingFriction("m", 100.0, 30.0, 5.0, 0.03, 0.02, "n"),
    "rotary friction": jl.RotaryFriction("m", 100.0, 30.0, 5.0),
    "position": jl.Position("m", "n"),
    "angle": jl.Angle("m"),
    "end stop": jl.EndStop("m", -1.5e-3, 2.5e-3, 1e7, 1e4, 1e-3),
    "one stop": jl.EndStop("m", upper=2e-3, to="n"),
    "rotary end stop": jl.RotaryEndStop("m", -0.1, 0.2, to="n"),
    "backlash": jl.Backlash("m", 1.1e-3, 1e7, 1e3, 2e-4, "n"),
    "rotary backlash": jl.RotaryBacklash("m", 9e-4, 1e6, 1e3, 2e-4),
    "gear": jl.Gear("a", "b", 20.0, 1e6, 1e3, 5e-4, 1e-4, 0.95),
    "gear without play": jl.Gear("a", "b", -20.0, 1e6, 1e3),
    "open tank": jl.OpenTank("a", 2.0, 3.0),
    "surge shaft": jl.SurgeShaft("a", 2.0, 0.05, transition=1e3, bottom=3.0),
    "nitrogen accumulator": jl.NitrogenAccumulator("a", 1e-3, 5e6, 1e-9, 5.0),
}
OILS = {
    "with air": jl.Oil(1.4e9, 850.0, 30e-6, 0.01, 1.2, 6.0),
    "without air": jl.Oil(1.4e9, 850.0, 30e-6, 0.0, 1.2, 0.0),
    "article": jl.Oil(1.4e9, 850.0, 30e-6, 0.01, 1.2, 6.0, mass="article"),
    "kinetic air": jl.Oil(1.4e9, 850.0, 30e-6, 0.01, air=jl.KineticAir(jl.PolynomialSolubility(), 0.1, 5.0)),
}
ACTUATORS = (jl.DoubleRodCylinder, jl.SingleRodCylinder, jl.RotaryActuator)
STORING = (jl.Line, jl.Accumulator, jl.NitrogenAccumulator, jl.FlowSource, jl.LaminarLeak, *ACTUATORS)
PASSING = ["leak", "orifice", "inertia of fluid", "servovalve", "motor", "supercharge", "pump", "compensated pump"]
PASSING += ["minor loss", "annular leak", "curve valve", "table valve", "valve 2/2", "valve 4/3", "check valve"]
PASSING += ["relief valve", "motor with Wilson's losses", "bent-axis motor"]
"""Parts that give at one port what they take at others, with a flow at every hydraulic port."""

# Pressures at up to four hydraulic ports [Pa], speed [rad/s], states as shares of their typical size.
POINTS = {
    "generic": ((9e6, 5e6, 4e6, 1e6), 3.0, 0.4),
    "reversed": ((1e6, 6e6, 3e6, 8e6), -2.0, -0.7),
    "equal pressures at rest": ((5e6,) * 4, 0.0, 0.0),
    "almost equal": ((5e6, 5e6 + 300.0, 5e6 - 200.0, 5e6), 0.01, 1e-3),
    "saturated": ((2e7, 1e5, 1.9e7, 2e5), 30.0, 1.3),
    "near vacuum": ((2e4, 3e4, 1e4, 5e3), -0.05, -0.02),
}


def situation(part, oil, point) -> Situation:
    """What a component sees at a point; states and speed in their places."""
    pressures, speed, share = POINTS[point]
    hydraulic = [name for name, domain in ports_of(part).items() if domain == "hydraulic"]
    potential = {name: jnp.asarray(p) for name, p in zip(hydraulic, pressures, strict=False)}
    potential |= {name: jnp.asarray(speed) for name in ports_of(part) if name not in hydraulic}
    state = {s.name: jnp.full(s.shape, share * s.scale) for s in part.states_in(oil)}
    inner = state.get("pressure")  # of a segmented line: between those at its ends
    if inner is not None:
        along = jnp.linspace(0.0, 1.0, inner.size + 2)[1:-1]
        state["pressure"] = pressures[0] + along * (pressures[1] - pressures[0])
    return Situation(oil, potential, state, {name: getattr(part, name) for name in driven_of(part)})


def results(part, at: Situation):
    """All flows, capacities and rates in one vector."""
    done = part.evaluate(at)
    return jnp.concatenate([jnp.ravel(v) for room in done for v in room.values()]) if any(done) else jnp.zeros(0)


def sizes(part, at: Situation):
    """By how much each number of component and situation is varied: its size, where that is zero a typical one."""
    own = jax.tree.map(lambda x: np.where(np.asarray(x) == 0.0, 1e-3, np.abs(x)), (part, at))
    part, at = own
    potential = {p: 1e4 if domain == "hydraulic" else 1e-2 for p, domain in ports_of(part).items()}
    state = {s.name: jnp.full(s.shape, 1e-3 * s.scale) for s in part.states_in(at.fluid)}
    # Not more: exp(coefficient * p) and traces of air near vacuum are far from linear.
    thickening, air = np.asarray(1e-9), np.minimum(at.fluid.air_fraction, 1e-4)
    fluid = dataclasses.replace(at.fluid, viscosity_pressure_coefficient=thickening, air_fraction=air)
    at = Situation(fluid, potential, state, at.given)
    return jax.tree.map(lambda size: np.where(np.isinf(size), 1.0, np.asarray(size, float)), (part, at))


@pytest.fixture(scope="module", autouse=True)
def float64():
    with jax.enable_x64(True):
        yield


def differences(function, x, steps):
    """Jacobian by central differences of fourth order, a column for each number."""
    shifts = np.diag(steps)
    values = {k: np.stack([function(x + k * shift) for shift in shifts]) for k in (-2, -1, 1, 2)}
    return ((8 * (values[1] - values[-1]) - (values[2] - values[-2])) / (12 * steps[:, None])).T


def oils_for(part) -> list[str]:
    """All oils for what stores fluid; for others those with the same program, which differ in air only."""
    return list(OILS) if isinstance(part, STORING) else ["with air", "without air"]


def value_and_jacobian(restore):
    """Both in one program, because compiling takes most of the time here."""

    def twice(x):
        found = results(*restore(x))
        return found, found

    return jax.jit(jax.jacfwd(twice, has_aux=True))


@pytest.mark.parametrize("name", PARTS)
def test_jacobian_in_all_numbers_and_potentials(name):
    part, programs = PARTS[name], {}
    for oil in oils_for(part):
        points = {point: situation(part, OILS[oil], point) for point in POINTS}
        flat = {point: np.asarray(ravel_pytree((part, at))[0]) for point, at in points.items()}
        _, restore = ravel_pytree((part, points["generic"]))
        structure = jax.tree.structure((part, points["generic"]))
        program = programs.setdefault(structure, value_and_jacobian(restore))

        def function(x, program=program):
            return np.asarray(program(x)[1])

        largest = np.max([np.abs(function(x)) for x in flat.values()], axis=0)
        for point, x in flat.items():
            scale = np.asarray(ravel_pytree(sizes(part, points[point]))[0])
            exact = np.asarray(program(x)[0])
            assert np.all(np.isfinite(exact)) and np.all(np.isfinite(function(x))), (oil, point)
            if exact.size:
                error = np.abs(exact - differences(function, x, 1e-3 * scale)) * scale
                allowed = 1e-6 * np.max(np.abs(exact) * scale, axis=1) + 1e-12 * largest  # the rest is rounding
                allowed = np.broadcast_to(allowed[:, None], error.shape)
                assert np.all(error <= allowed), f"{oil}, {point}: {np.argwhere(error > allowed).tolist()}"


@pytest.mark.parametrize("name", PARTS)
def test_vmap_equals_loop_on_one_program(name):
    part = PARTS[name]
    seen = [situation(part, OILS["with air"], point) for point in POINTS]
    batch = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(v) for v in x], axis=-1), *seen)
    alone = jax.jit(lambda part, at: (results(part, at), part.evaluate(at).flow))
    one_by_one, flows = zip(*(alone(part, at) for at in seen), strict=True)
    alone(jax.tree.map(lambda number: 1.01 * number, part), seen[0])
    assert alone._cache_size() == 1  # other numbers compile nothing  # pyright: ignore[reportAttributeAccessIssue]
    rounding = 1e-15 * np.max(np.abs(np.stack(one_by_one)), initial=1e-3)
    together = jax.jit(lambda at: (jax.vmap(results, (None, -1))(part, at), part.evaluate(at).flow))(batch)
    np.testing.assert_allclose(together[0], np.stack(one_by_one), rtol=1e-12, atol=rounding)
    for port, flow in together[1].items():  # as arrays, without vmap
        np.testing.assert_allclose(flow, [single[port] for single in flows], rtol=1e-12, atol=rounding)


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("name", PASSING)
def test_mass_is_passed_on(name, point):
    part = PARTS[name]
    flow = part.evaluate(situation(part, OILS["with air"], point)).flow
    masses = [float(flow[port]) for port, domain in ports_of(part).items() if domain == "hydraulic"]
    assert len(masses) >= 2
    assert abs(sum(masses)) <= 1e-14 * max(map(abs, masses), default=0.0) + 1e-18
    if point == "generic":
        assert max(map(abs, masses)) > 1e-9


def test_every_component_is_tested_and_holds_arrays():
    names = [getattr(jl, name) for name in dir(jl)]
    parts = {c for c in names if inspect.isclass(c) and issubclass(c, AbstractComponent)}
    public = {c for c in parts if not issubclass(c, AbstractController)}  # tested in closed loops
    assert public == {type(part) for part in PARTS.values()}
    for leaf in jax.tree.leaves((PARTS, OILS)):
        assert isinstance(leaf, np.ndarray) and leaf.dtype == np.float64


def test_regularised_root():
    values = {0.001: 0.009975155, 0.01: 0.084089642, 0.1: 0.315442101, 1.0: 0.999975002}
    for x, root in values.items():
        assert float(regularised_root(x, 0.01)) == pytest.approx(root, abs=6e-10)
        assert float(regularised_root(-x, 0.01)) == pytest.approx(-root, abs=6e-10)
    assert float(jax.grad(regularised_root)(0.0, 0.01)) == pytest.approx(10.0, rel=1e-12)
    # C_d 0.7, A 1 cm^2, rho 850, transition 0.3178266 Pa
    assert float(orifice_flow(1e-4, 0.7, 850.0, 1e6, 0.0, 0.3178266)) == pytest.approx(3.39549875e-3, rel=1e-8)
    assert float(orifice_flow(1e-4, 0.7, 850.0, 1e3, 0.0, 0.3178266)) == pytest.approx(1.07375096e-4, rel=1e-7)


def test_rated_flow_of_the_servovalve():
    """At full stroke and rated pressure drop, half of it over each land, the rated flow passes."""
    valve = jl.Servovalve("s", "t", "a", "b", 0.0, rated_flow=1e-3, underlap=1e-6)
    oil = jl.Oil(1.4e9, 850.0, mass="article")
    potential = {"supply": 8e6, "a": 4.5e6, "b": 4.5e6, "tank": 1e6}
    for spool, sign in ((1.0, 1.0), (-1.0, -1.0)):
        flow = valve.evaluate(Situation(oil, potential, {"spool": spool, "spool_rate": 0.0}, {"command": 0.0})).flow
        assert float(flow["a"]) / 850 == pytest.approx(sign * 1e-3, rel=1e-5)
        assert float(flow["b"]) / 850 == pytest.approx(-sign * 1e-3, rel=1e-5)
        assert float(flow["supply"]) / 850 == pytest.approx(-1e-3, rel=1e-5)


def test_supercharge_opens_one_way():
    check = jl.Supercharge("s", "l", conductance=1e-9, cracking_pressure=3e4)
    oil = jl.Oil(1.4e9, 850.0, mass="article")

    def flow(line):
        return float(check.evaluate(Situation(oil, {"supply": 1e6, "line": line}, {}, {})).flow["line"]) / 850

    assert flow(0.5e6) == pytest.approx(1e-9 * (5e5 - 3e4), rel=1e-9)
    assert 0 <= flow(1.2e6) < 1e-20


def test_brake_holds_until_released():
    brake = jl.Brake("shaft", "a", holding_torque=500.0)

    def torque(p, speed):
        return float(brake.evaluate(Situation(OILS["article"], {"shaft": speed, "a": p}, {}, {})).flow["shaft"])

    assert torque(1e5, 1.0) == pytest.approx(-500.0, rel=1e-6)
    assert torque(1e5, -1.0) == pytest.approx(500.0, rel=1e-6)
    assert torque(2e6, 1.0) == pytest.approx(-250.0)
    assert abs(torque(5e6, 1.0)) < 1e-9


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: jl.LaminarLeak("a", "b", 5.0), "conductance must be .* got 5 .*was it given in L/"),
        (lambda: jl.Orifice("a", "b", 500.0), "area must be .* got 500 m.2: was it given in mm.2"),
        (lambda: jl.Servovalve("s", "t", "a", "b", 50.0, 1e-3), "command must be .* got 50: was it given in percent"),
        (lambda: jl.Servovalve("s", "t", "a", "b", 0.5, 40.0), "rated_flow must be .* got 40 m.*was it given in L/min"),
        (lambda: jl.Motor("a", "b", "c", "d", 28.0), "displacement must be .* got 28 .*was it given in cm.3/rev"),
        (lambda: jl.PressureSource("a", -1e5), "pressure must be .* got -100000 Pa: pressures are absolute"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


PIPE, WORD, NUMBER = jl.Pipe(1.0, 0.01, 0.02), typing.cast(typing.Any, "churchill"), typing.cast(typing.Any, 0.01)
WRONG_LAWS = {
    "friction must be .* got 'churchill'": lambda: jl.Line("a", PIPE, to="b", friction=WORD),
    r"weights must be .* KagawaWeights\(...\)": lambda: jl.Line("a", PIPE, to="b", weights=WORD),
    r"liquid must be an object such as Murnaghan\(...\) or Tait": lambda: jl.Oil(1e9, 850.0, liquid=WORD),
    r"air must be .* FreeAir\(...\) .* got 0.01": lambda: jl.Oil(1e9, 850.0, air=NUMBER),
    "solubility must be .* LinearSolubility": lambda: jl.KineticAir(WORD),
    "losses must be .* got 0.01": lambda: jl.Motor("a", "b", "c", "s", 1e-4, losses=NUMBER),
}


@pytest.mark.parametrize("message", WRONG_LAWS)
def test_a_law_is_an_object(message):
    with pytest.raises(TypeError, match=message):
        WRONG_LAWS[message]()


def test_a_port_is_a_name():
    with pytest.raises(TypeError, match=r"Tank\.node must be the name of a node, got"):
        jl.Tank(101325.0)  # pyright: ignore[reportArgumentType]
