"""Closed loops: continuous and sampled controllers against closed forms, derivatives, order of evaluation, refusals."""

import dataclasses
import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import cont2discrete

import jaxlines as jl
from jaxlines.inference.programs import Place, sensitivity
from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.controllers import PIController, PIDController, SampledController, smooth_limits
from jaxlines.physics.fields import ROTATIONAL, port
from jaxlines.physics.sensors import SpeedSensor
from jaxlines.simulation.assembly import compile_circuit, number_locations
from jaxlines.simulation.integration import make_method

OIL = jl.Oil(1.4e9, 850.0, 30e-6)
INERTIA, FRICTION, TORQUE, PERIOD = 2.0, 1.5, -0.3, 0.05


class Angle(AbstractComponent):
    """The angle of a shaft."""

    shaft: str = port(ROTATIONAL)
    states = (State("angle", "rad", 1.0),)

    def evaluate(self, at):
        return Contribution(rate={"angle": at.potential["shaft"]})


def shaft(controller, **others) -> jl.Circuit:
    """A shaft with linear friction (a motor with shorted ports), driven by a torque that is the controller's output."""
    return jl.Circuit(
        OIL,
        {
            "tank": jl.Tank("T"),
            "motor": jl.Motor("T", "T", "T", "s", 0.0, viscous_friction=FRICTION),
            "shaft": jl.Inertia("s", INERTIA),
            "drive": jl.LoadTorque("s", "loop"),
            "load": jl.LoadTorque("s", TORQUE),
            "loop": controller,
            **others,
        },
    )


def run(circuit, times, **options):
    inputs = {"demand": 1.0} if "demand" in circuit.external_inputs() else {}
    return jl.simulate(circuit, times, inputs, **{"tolerance": 1e-9, **options})


def linear(matrix, constant, start, times):
    """Solution of x' = A x + b at times, by the matrix exponential."""
    n = len(constant)
    whole = np.block([[np.asarray(matrix), np.reshape(constant, (n, 1))], [np.zeros((1, n + 1))]])
    return np.stack([(expm(whole * t) @ np.append(start, 1.0))[:n] for t in times])


def test_continuous_pi_loop():
    kp, ki, times = 8.0, 30.0, np.linspace(0.0, 1.5, 31)
    sim = run(shaft(PIController("s.speed", "demand", kp, ki)), times)
    matrix = [[-(FRICTION + kp) / INERTIA, 1.0 / INERTIA], [-ki, 0.0]]
    exact = linear(matrix, [(kp + TORQUE) / INERTIA, ki], [0.0, 0.0], times)
    np.testing.assert_allclose(sim["s.speed"], exact[:, 0], atol=1e-7)
    np.testing.assert_allclose(sim["loop.integral"], exact[:, 1], atol=1e-6)
    np.testing.assert_allclose(sim["loop.output"], kp * (1.0 - exact[:, 0]) + exact[:, 1], atol=1e-6)


def test_continuous_pid_loop():
    kp, ki, kd, filtered, times = 8.0, 30.0, 0.4, 0.02, np.linspace(0.0, 1.5, 31)
    sim = run(shaft(PIDController("s.speed", "demand", kp, ki, kd, filtered)), times, initial={"s.speed": 0.5})
    fast = kd / filtered
    matrix = [
        [-(FRICTION + kp + fast) / INERTIA, 1.0 / INERTIA, fast / INERTIA],
        [-ki, 0.0, 0.0],
        [1.0 / filtered, 0.0, -1.0 / filtered],
    ]
    exact = linear(matrix, [(kp + TORQUE) / INERTIA, ki, 0.0], [0.5, 0.0, 0.5], times)
    np.testing.assert_allclose(sim["s.speed"], exact[:, 0], atol=1e-7)
    np.testing.assert_allclose(sim["loop.filtered"], exact[:, 2], atol=1e-6)


def sampled_loop(kp, ki, kd, filtered, count, start=0.0):
    """Speeds and outputs at the instants: the shaft held exactly (SciPy), the controller as its docstring says."""
    plant = [np.array([[x]]) for x in (-FRICTION / INERTIA, 1 / INERTIA, 1.0, 0.0)]
    a, b = (float(np.squeeze(x)) for x in cont2discrete(plant, PERIOD, "zoh")[:2])  # pyright: ignore
    w, last, integral, derivative, speeds, outputs = start, start, 0.0, 0.0, [], []
    for _ in range(count):
        e = 1.0 - w
        derivative = (filtered * derivative - kd * (w - last)) / (filtered + PERIOD)
        u = kp * e + integral + derivative
        integral, last = integral + ki * PERIOD * e, w
        speeds.append(w)
        outputs.append(u)
        w = a * w + b * (u + TORQUE)
    return np.array(speeds), np.array(outputs)


@pytest.mark.parametrize("solver", [None, jl.implicit()], ids=["explicit", "implicit"])
def test_sampled_loop(solver):
    """Saved at its instants (20 Hz, the last one at the end of the simulation) and once between each two."""
    gains = (8.0, 30.0, 0.4, 0.02)
    controller = SampledController("s.speed", PERIOD, "demand", *gains)
    times = np.arange(0, 61) * PERIOD / 2
    sim = run(shaft(controller), times, initial={"s.speed": 0.5}, solver=solver)
    speeds, outputs = sampled_loop(*gains, 31, start=0.5)
    np.testing.assert_allclose(sim["s.speed"][::2], speeds, atol=1e-7)
    np.testing.assert_allclose(sim["loop.output"][::2], outputs, atol=1e-6)
    np.testing.assert_allclose(sim["loop.output"][1::2], sim["loop.output"][:-1:2], rtol=1e-14)  # held
    assert sim.num_steps < 160


def test_sampled_loop_that_does_not_start_at_zero():
    times = 1000.0 + np.arange(31) * PERIOD
    sim = run(shaft(SampledController("s.speed", PERIOD, "demand", 8.0, 30.0)), times)
    np.testing.assert_allclose(sim["s.speed"], sampled_loop(8.0, 30.0, 0.0, 0.01, 31)[0], atol=1e-7)


@pytest.mark.parametrize("method", ["linear", "hold"])
@pytest.mark.parametrize("shift", [0.0, 1e-17, -1e-17])
def test_a_recorded_reference_with_samples_at_the_instants(method, shift):
    """Knots and jumps of inputs fall on instants, up to rounding; each instant counts once."""
    times = np.arange(31) * PERIOD
    demand = jl.Sampled(times * (1.0 + 10 * shift) + shift, np.ones(31), method)
    circuit = shaft(SampledController("s.speed", PERIOD, "demand", 8.0, 30.0))
    sim = jl.simulate(circuit, np.arange(31) * 0.05 + shift, {"demand": demand}, tolerance=1e-9)
    np.testing.assert_allclose(sim["s.speed"], sampled_loop(8.0, 30.0, 0.0, 0.01, 31)[0], atol=1e-7)
    assert sim.num_steps < 200


def test_unstable_where_the_sampled_loop_is():
    """Proportional, z = a - k b: the loop rings up from k = (1 + a)/b on, far below any limit of the continuous one."""
    a = np.exp(-FRICTION / INERTIA * PERIOD)
    limit = (1.0 + a) / ((1.0 - a) / FRICTION)
    times = np.arange(0, 201) * PERIOD
    for share, grows in ((0.97, False), (1.03, True)):
        speed = run(shaft(SampledController("s.speed", PERIOD, "demand", share * limit)), times)["s.speed"]
        swing = np.abs(np.diff(speed))
        assert (swing[-1] > swing[0]) == grows
        ratio = a - share * limit * (1.0 - a) / FRICTION
        assert np.diff(speed)[-1] / np.diff(speed)[-2] == pytest.approx(ratio, rel=1e-4)


def test_two_sampled_controllers_with_periods_of_their_own():
    """Each acts at its instants and holds in between; both are of one kind."""
    circuit = shaft(
        SampledController("s.speed", 0.05, "demand", 2.0),
        slow=SampledController("s.speed", 0.07, 0.5, 3.0),
        second=jl.LoadTorque("s", "slow"),
    )
    times = np.arange(0, 101) * 0.01
    sim = run(circuit, times)
    w = sim["s.speed"]
    for name, every, reference, gain in (("loop", 5, 1.0, 2.0), ("slow", 7, 0.5, 3.0)):
        held = np.repeat(gain * (reference - w[::every]), every)[: times.size]
        np.testing.assert_allclose(sim[f"{name}.output"], held, atol=1e-7)


def test_cascade_and_limits():
    """A position loop gives the reference of the rate loop, both are of one kind; the output saturates and recovers."""
    outer = PIController("turned.angle", "demand", 4.0, 0.0, -0.5, 0.5, rounding=1e-3)
    inner = PIController("s.speed", "outer", 20.0, 40.0, -3.0, 3.0, rounding=1e-3)
    sim = run(shaft(inner, outer=outer, turned=Angle("s")), np.linspace(0.0, 8.0, 161))
    assert sim["loop.output"].max() == pytest.approx(3.0, abs=1e-3)
    assert sim["outer.output"].max() == pytest.approx(0.5, abs=1e-3)
    assert sim["s.speed"].max() < 0.53  # the rate is limited, and the integral did not wind up
    assert sim["turned.angle"][-1] == pytest.approx(1.0, abs=1e-3)


PATHS = ("loop.gain", "loop.integral_gain", "loop.derivative_gain", "shaft.moment_of_inertia", "motor.viscous_friction")
NUMBERS = np.array([8.0, 30.0, 0.4, INERTIA, FRICTION])
TIMES = np.linspace(0.0, 1.0, 13)  # most of them between instants


def speeds(numbers, circuit, gradient):
    changed = circuit.replace(dict(zip(PATHS, numbers, strict=True)))
    sim = run(changed, TIMES, gradient=gradient, outputs=["s.speed", "loop.output"], tolerance=1e-10)
    return jnp.stack([sim["s.speed"], sim["loop.output"]])


LOOPS = {
    "sampled": SampledController("s.speed", PERIOD, "demand", 8.0, 30.0, 0.4, 0.02, -6.0, 6.0, 0.5),
    "continuous": PIDController("s.speed", "demand", 8.0, 30.0, 0.4, 0.02, -6.0, 6.0, 0.5),
}


@pytest.mark.parametrize("kind", LOOPS)
def test_forward_and_reverse_against_differences(kind):
    circuit = shaft(LOOPS[kind])
    with jax.enable_x64(True):
        forward = np.asarray(jax.jacfwd(lambda x: speeds(x, circuit, "forward"))(jnp.asarray(NUMBERS)))
        reverse = np.asarray(jax.grad(lambda x: jnp.sum(speeds(x, circuit, "reverse")[:, ::3]))(jnp.asarray(NUMBERS)))
        columns = []
        for step in np.diag(1e-4 * NUMBERS):
            ends = [speeds(NUMBERS + sign * step, circuit, "forward") for sign in (1.0, -1.0)]
            columns.append((ends[0] - ends[1]) / (2.0 * np.max(step)))
    differences = np.stack(columns, axis=-1)
    scale = np.max(np.abs(differences * NUMBERS))
    np.testing.assert_allclose(forward * NUMBERS, differences * NUMBERS, atol=2e-6 * scale)
    np.testing.assert_allclose(reverse, np.sum(forward[:, ::3], axis=(0, 1)), rtol=1e-6, atol=1e-8)
    assert scale > 1.0


def test_sensitivities_integrated_with_the_states():
    """As a fit takes them, through the sampling instants, against the derivative of the solver."""
    circuit = shaft(LOOPS["sampled"])
    with jax.enable_x64(True):
        plan, values = compile_circuit(circuit, None, {"demand": jl.Constant(1.0)})
        known, method = number_locations(plan, values), make_method(None, "forward", 10_000)
        places, groups = tuple(Place(*known[path]) for path in PATHS), tuple((i,) for i in range(len(PATHS)))
        numbers = jnp.asarray(NUMBERS), jnp.asarray(NUMBERS)
        found = sensitivity(
            plan, ("s.speed", "loop.output"), method, places, groups, *numbers, values, TIMES, np.asarray(1e-9)
        )
        exact = np.asarray(jax.jacfwd(lambda x: speeds(x, circuit, "forward"))(jnp.asarray(NUMBERS)))
    np.testing.assert_allclose(found[1], np.swapaxes(exact, 0, 1), atol=1e-6 * np.max(np.abs(exact)))


def test_other_gains_and_periods_compile_nothing(caplog):
    circuit = shaft(LOOPS["sampled"])
    run(circuit, TIMES)
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        run(circuit.replace({"loop.gain": 5.0, "loop.period": 0.08, "shaft.moment_of_inertia": 3.0}), TIMES)
    assert [r.message for r in caplog.records if "Compiling" in r.message] == []


def test_the_period_cannot_be_differentiated():
    circuit = shaft(LOOPS["sampled"])

    def end(period):
        changed = circuit.replace({"loop.period": period})
        return run(changed, TIMES, gradient="forward")["s.speed"][-1]

    with jax.enable_x64(True), pytest.raises(NotImplementedError, match="time of a jump"):
        jax.jacfwd(end)(jnp.asarray(PERIOD))


def test_vmap_over_gains_and_periods_equals_loop():
    circuit = shaft(LOOPS["sampled"])
    gains, periods = np.array([4.0, 8.0, 12.0]), np.array([0.03, 0.05, 0.11])

    def end(gain, period):
        return run(circuit.replace({"loop.gain": gain, "loop.period": period}), TIMES)["s.speed"]

    with jax.enable_x64(True):
        together = np.asarray(jax.vmap(end)(gains, periods))
    np.testing.assert_allclose(together, [end(*row) for row in zip(gains, periods, strict=True)], rtol=1e-9)


@pytest.mark.parametrize("law", [*LOOPS.values(), PIController("s.speed", 1.0, 2.0, 3.0, -1.0, 1.0)])
@pytest.mark.parametrize("measured", [0.2, 1e6])
def test_derivatives_of_the_laws(law, measured):
    """Output, rates and samples, also far in saturation and with limits that do not exist."""
    numbers = [law.gain, law.low, law.high, law.rounding, law.integral_gain]

    def results(numbers, state, y):
        moved = dataclasses.replace(
            law, gain=numbers[0], low=numbers[1], high=numbers[2], rounding=numbers[3], integral_gain=numbers[4]
        )
        at = Situation(OIL, {}, state, {"measured": y, "reference": 1.0})
        new = moved.sampled(at) if isinstance(moved, SampledController) else moved.evaluate(at).rate
        return jnp.stack([moved.output(at), *(new[name] for name in sorted(new))])

    with jax.enable_x64(True):
        state = {s.name: jnp.asarray(0.3) for s in law.states}
        for high in (law.high, np.inf):
            numbers[2] = np.asarray(high)
            exact = jax.jit(jax.jacfwd(results, argnums=(0, 2)))(
                [jnp.asarray(x) for x in numbers], state, jnp.asarray(measured)
            )
            assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(exact))
            step = 1e-6 * max(abs(measured), 1.0)
            ends = [results(numbers, state, measured + sign * step) for sign in (1.0, -1.0)]
            np.testing.assert_allclose(exact[1], (ends[0] - ends[1]) / (2 * step), rtol=1e-4, atol=1e-4)


def test_smooth_limits():
    """ln 2 of the rounding at the corner, exact inside and outside, odd."""
    assert smooth_limits(2.0, -1.0, 2.0, 0.1) == pytest.approx(2.0 - 0.1 * np.log(2.0), abs=1e-12)
    for value, limited in ((0.3, 0.3), (9.0, 2.0), (-9.0, -1.0)):
        assert smooth_limits(value, -1.0, 2.0, 0.01) == pytest.approx(limited, abs=1e-12)
    assert smooth_limits(7.0, -np.inf, np.inf, 0.01) == 7.0


def test_reading_through_a_sensor():
    """Gain, offset and lag of the sensor are in the loop."""
    kp, lag, times = 8.0, 0.1, np.linspace(0.0, 1.5, 31)
    sensor = SpeedSensor("s", 1.1, 0.2, lag=lag)
    sim = run(shaft(PIController("gauge", "demand", kp), gauge=sensor), times, initial={"s.speed": 0.5})
    matrix = [[-FRICTION / INERTIA, -kp / INERTIA], [1.1 / lag, -1.0 / lag]]
    exact = linear(matrix, [(kp + TORQUE) / INERTIA, 0.2 / lag], [0.5, 0.75], times)
    np.testing.assert_allclose(sim["s.speed"], exact[:, 0], atol=1e-7)
    np.testing.assert_allclose(sim["gauge"], exact[:, 1], atol=1e-7)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"loop": PIController("s.speed", "a"), "a": PIController("s.speed", "loop")},
            "algebraic loop, loop -> a -> loop",
        ),
        ({"loop": PIController("s.speed", "loop")}, "algebraic loop, loop -> loop"),
        ({"loop": PIController("s.sped", "demand")}, r"loop.measured reads 's.sped', which the circuit does not have"),
        ({"loop": PIController("drive.shaft.torque", "demand")}, "which depends on inputs at the same instant"),
        (
            {"loop": PIController("P.pressure", "demand"), "source": jl.PressureSource("P", "loop")},
            "reads 'P.pressure', which the controller 'loop' sets",
        ),
        (
            {"loop": PIController("late", "demand"), "late": SpeedSensor("s", delay=0.1)},
            "reads 'late', which has a delay",
        ),
    ],
)
def test_wrong_loops_are_refused(parts, message):
    with pytest.raises(ValueError, match=message):
        run(shaft(parts.pop("loop"), **parts), TIMES)


def test_a_sampled_controller_breaks_an_algebraic_loop():
    parts = {"a": SampledController("s.speed", PERIOD, "loop", 0.5)}
    sim = run(shaft(PIController("s.speed", "a"), **parts), np.arange(21) * PERIOD)
    w = sim["s.speed"]
    before = np.concatenate([[0.0], sim["a.output"][:-1]])
    np.testing.assert_allclose(
        sim["a.output"], 0.5 * (before - w - w), atol=1e-6
    )  # r is what the other gave just before
