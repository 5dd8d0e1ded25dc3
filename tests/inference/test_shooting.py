"""Multiple shooting: the optimum of a single trajectory where that can be found, and the truth where it cannot."""

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxlines as jl
from jaxlines.inference.search import search
from jaxlines.inference.shooting_search import At, join
from jaxlines.inference.shooting_windows import cut_recordings
from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, port, quantity

PERIOD = 2e-3 * np.pi  # of 1/sqrt(inertance * volume / modulus)
TRUTH = {"pipe.inertance": 1e6, "pipe.resistance": 1e7, "initial.A.pressure": 3e6}  # damping ratio 0.005
NOISE = 2e4


def resonator() -> jl.Circuit:
    """A volume of 1 litre at the end of a pipe from a constant pressure: a lightly damped oscillator."""
    oil = jl.Oil(bulk_modulus=1e9, density=850.0, air_fraction=0.0, mass="article")
    parts = {
        "supply": jl.PressureSource("S", 5e6),
        "pipe": jl.FluidInertia("S", "A", TRUTH["pipe.inertance"], TRUTH["pipe.resistance"]),
        "volume": jl.Line("A", jl.Vessel(volume=1e-3)),
    }
    return jl.Circuit(oil, parts)


def ringing(periods: float, seed: int = 0) -> jl.Recording:
    """The closed form of the free oscillation from 3 MPa, with noise."""
    times = np.arange(0.0, periods * PERIOD, PERIOD / 20)
    decay, omega = TRUTH["pipe.resistance"] / TRUTH["pipe.inertance"] / 2, 1e3
    damped = np.sqrt(omega**2 - decay**2)
    wave = np.exp(-decay * times) * (np.cos(damped * times) + decay / damped * np.sin(damped * times))
    pressure = 5e6 - 2e6 * wave + NOISE * np.random.default_rng(seed).standard_normal(times.size)
    return jl.Recording(times, {"A.pressure": pressure})


def free(inertance: float) -> list[jl.Free]:
    """The damping is known within a factor of three, so that no search can damp its way out of a wrong frequency."""
    return [
        jl.Free("pipe.inertance", (1e5, 1e7), start=inertance, transform="log"),
        jl.Free("pipe.resistance", (3e6, 3e7), start=2e7, transform="log"),
        jl.Free("initial.A.pressure", (1e6, 6e6), start=2e6),
    ]


def fitted(inertance: float, recording=None, **options) -> jl.Fit:
    known = [jl.Known("fluid.bulk_modulus", 1e6)]
    noise = {"A.pressure": NOISE}
    return jl.fit(resonator(), recording or ringing(30), free=free(inertance), known=known, noise=noise, **options)


def numbers(fit: jl.Fit) -> np.ndarray:
    """Estimates and their standard deviations, shape (2, free)."""
    return np.array([[estimate.value, estimate.sd] for estimate in fit.parameters.values()], dtype=float).T


@pytest.fixture(scope="module")
def near():
    """A fit with one trajectory that starts near enough, 5 % from the inertance."""
    return fitted(1.05e6)


@pytest.mark.parametrize("start", [pytest.param(2e6, marks=pytest.mark.slow), 3e5])
def test_windows_reach_the_truth_where_a_single_trajectory_slips(near, start):
    """Start at 0.7 and 1.8 times the frequency, 30 periods: one trajectory settles for another minimum."""
    slipped, found = fitted(start), fitted(start, windows=40)
    assert slipped.channels["A.pressure"].rmse > 20 * NOISE
    assert near.status == "converged" and found.status == "converged", found.message
    values, sd = numbers(found)
    assert np.all(np.abs(values - list(TRUTH.values())) < 4 * sd)
    np.testing.assert_allclose(numbers(found), numbers(near), rtol=1e-4)  # the same `Fit`, intervals too
    channel = found.channels["A.pressure"]
    assert channel.white and channel.rmse == pytest.approx(NOISE, rel=0.1)
    assert found.starts[0].num_evaluations == found.num_evaluations > near.num_evaluations


def test_the_end_of_the_windows_is_that_of_the_single_trajectory(near):
    """Cost, outputs and slopes by free and known parameters, chained through 40 windows."""
    problem = near.problem
    cut = cut_recordings(problem, 40)
    end = join(cut, At(problem.start, cut.guess(problem.start)))
    assert end.gap < 1e-8 and end.offset < 1e-3
    found = search(problem, end.x, lambda count, cost: None)
    np.testing.assert_allclose(end.x, found.coordinates, rtol=1e-7)
    assert end.cost == pytest.approx(found.cost, rel=1e-6)
    for own, whole in zip(cut.stitched(end.x, end.states), problem.sensitivities(found.values), strict=True):
        np.testing.assert_allclose(own[0], whole[0], rtol=1e-3, atol=1e-4 * np.abs(whole[0]).max())
    jacobian = problem.jacobian(found.coordinates)
    np.testing.assert_allclose(end.covariance, np.linalg.inv(jacobian.T @ jacobian), rtol=1e-3)


def test_several_recordings_are_cut_each():
    both = [ringing(30, seed=1), ringing(26, seed=2)]
    whole, found = fitted(1.05e6, both), fitted(3e5, both, windows=40)
    np.testing.assert_allclose(numbers(found), numbers(whole), rtol=1e-4)


def test_an_interrupted_search_in_windows_goes_on(tmp_path):
    """Ctrl-C in the midst of the windows; the next call ends at the numbers of an uninterrupted one."""
    path, told = tmp_path / "fit.json", []

    def stop(text, fraction):
        told.append(text)
        if "evaluation 9," in text:
            raise KeyboardInterrupt

    whole = fitted(3e5, windows=40)
    with pytest.raises(KeyboardInterrupt):
        fitted(3e5, windows=40, checkpoint=path, progress=stop)
    assert any(text.startswith("start 1 of 1, evaluation 8, cost") for text in told)
    resumed = []
    again = fitted(3e5, windows=40, checkpoint=path, progress=lambda text, fraction: resumed.append(text))
    assert np.array_equal(numbers(again), numbers(whole))
    assert not any("evaluation 3," in text for text in resumed)
    with pytest.raises(ValueError, match="belongs to another fit"):
        fitted(3e5, windows=41, checkpoint=path)


def test_wrong_calls_are_refused():
    with pytest.raises(
        ValueError, match=r"windows must be a whole number 1..300 for the 601 samples of recording .*, got 301"
    ):
        fitted(1e6, windows=301)
    with pytest.raises(ValueError, match=r"windows must be a whole number 1..300 .*, got 0"):
        fitted(1e6, windows=0)
    with pytest.raises(ValueError, match=r"windows must be a whole number 1..300 .*, got 2.5"):
        fitted(1e6, windows=cast(Any, 2.5))
    late = resonator().components | {"sensor": jl.PressureSensor("A", delay=1e-3)}
    recording = jl.Recording(ringing(2).times, {"sensor": ringing(2).channels["A.pressure"]})
    with pytest.raises(ValueError, match="and sensor remembers more"):
        jl.fit(jl.Circuit(resonator().fluid, late), recording, free=free(1e6), windows=3, check=False)
    data, one = np.zeros((2, 1)), np.ones(1)
    with pytest.raises(ValueError, match="bounds need one increasing pair"):
        jl.FunctionWindows(lambda s, x, d: (s, s), data, ("a",), one, lower=one, upper=one)
    with pytest.raises(ValueError, match="units must be one positive size for each state"):
        jl.FunctionWindows(lambda s, x, d: (s, s), data, ("a",), 0 * one)
    with pytest.raises(ValueError, match="data need a leading axis of windows, the same in each"):
        jl.FunctionWindows(lambda s, x, d: (s, s), (data, np.zeros(3)), ("a",), one)
    cut = jl.FunctionWindows(lambda s, x, d: (s, x / s), data, ("a",), one)
    with pytest.raises(ValueError, match=r"need the shapes \(1,\) and \(2, 1\), got \(1,\) and \(3, 1\)"):
        jl.solve_windows(cut, [1.0], np.ones((3, 1)))
    assert jl.solve_windows(cut, [1.0], np.zeros((2, 1))).status == "failed"  # 1/0


LORENZ, STEPS = np.array([10.0, 28.0, 8.0 / 3.0]), 4


def attractor(span: float, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of the Lorenz system with unit noise, by an integrator of SciPy."""
    times = np.linspace(0.0, span, samples, endpoint=False)

    def rate(t, y):
        s, r, b = LORENZ
        return [s * (y[1] - y[0]), y[0] * (r - y[2]) - y[1], y[0] * y[1] - b * y[2]]

    exact = solve_ivp(rate, (0.0, span), [-8.0, 8.0, 27.0], t_eval=times, rtol=1e-10, atol=1e-10).y.T
    return times, exact + np.random.default_rng(0).standard_normal(exact.shape)


def lorenz(y, x):
    """Lorenz, "Deterministic nonperiodic flow", 1963."""
    return jnp.stack([x[0] * (y[1] - y[0]), y[0] * (x[1] - y[2]) - y[1], y[0] * y[1] - x[2] * y[2]])


def trajectory(state, x, samples: int, step: float):
    """States at the samples and after the last, by the classical Runge-Kutta scheme."""

    def one(y, _):
        k1 = lorenz(y, x)
        k2 = lorenz(y + 0.5 * step * k1, x)
        k3 = lorenz(y + 0.5 * step * k2, x)
        return y + step / 6.0 * (k1 + 2.0 * (k2 + k3) + lorenz(y + step * k3, x)), None

    def sample(y, _):
        return jax.lax.scan(one, y, None, length=STEPS)[0], y

    return jax.lax.scan(sample, state, None, length=samples)


def test_windows_identify_a_chaotic_model_that_a_single_trajectory_does_not():
    """Nine Lyapunov times of the Lorenz system, started with parameters a factor of two away."""
    samples, windows, span = 500, 50, 10.0
    _, measured = attractor(span, samples)
    step = span / samples / STEPS

    def window(state, x, data):
        end, path = trajectory(state, x, samples // windows, step)
        return jnp.ravel(path - data), end

    data, names = measured.reshape(windows, -1, 3), ("sigma", "rho", "beta")
    cut = jl.FunctionWindows(window, data, names, units=np.full(3, 10.0))
    found = jl.solve_windows(cut, [5.0, 14.0, 5.0], data[:, 0])
    assert found.status == "converged" and found.gap < 1e-8, found.message
    sd = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.x - LORENZ) < 4 * sd) and np.all(sd < 0.01 * LORENZ)
    assert 2 * found.cost / (3 * samples) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(0.5 * np.sum(found.residuals**2), found.cost)

    def whole(z):
        return jnp.ravel(trajectory(z[3:], z[:3], samples, step)[1] - measured)

    one = jl.FunctionProblem(whole, (*names, "x", "y", "z"))
    assert jl.solve(one, [5.0, 14.0, 5.0, *measured[0]]).cost > 10 * found.cost
    end = jl.solve(one, [*found.x, *found.states[0]])  # the same optimum, and the same covariance there
    assert end.cost == pytest.approx(found.cost, rel=1e-6)
    triangle = np.linalg.qr(end.jacobian, mode="r")
    inverse = np.linalg.inv(triangle)
    np.testing.assert_allclose(found.covariance, (inverse @ inverse.T)[:3, :3], rtol=1e-2)

    held = jl.FunctionWindows(
        window, data, names, np.full(3, 10.0), lower=np.full(3, 1.0), upper=np.array([9.0, 50.0, 9.0])
    )
    bound = jl.solve_windows(held, [5.0, 14.0, 5.0], data[:, 0])
    assert bound.status == "at_bound" and "sigma at 9" in bound.message
    assert bound.covariance[0, 0] == 0.0 < bound.covariance[1, 1]


class Lorenz(AbstractComponent):
    """The Lorenz system as a component that leaves its node alone."""

    a: str = port()
    sigma: Number = quantity("1")
    rho: Number = quantity("1")
    beta: Number = quantity("1")

    states = (State("x", "1", 10.0), State("y", "1", 10.0), State("z", "1", 10.0))

    def evaluate(self, at: Situation) -> Contribution:
        x, y, z = (at.state[name] for name in "xyz")
        rate = {"x": self.sigma * (y - x), "y": x * (self.rho - z) - y, "z": x * y - self.beta * z}
        return Contribution(rate=rate)


@pytest.mark.slow
def test_a_chaotic_circuit_is_fitted_where_no_trajectory_follows():
    """27 Lyapunov times: errors grow 5e11-fold, more than any tolerance allows."""
    times, measured = attractor(30.0, 900)
    recording = jl.Recording(times, {f"chaos.{name}": measured[:, i] for i, name in enumerate("xyz")})
    circuit = jl.Circuit(resonator().fluid, {"chaos": Lorenz("T", 8.0, 20.0, 4.0), "tank": jl.Tank("T")})
    numbers_free = {"sigma": (2.0, 30.0), "rho": (5.0, 60.0), "beta": (0.5, 9.0)}
    unknown = [jl.Free(f"chaos.{name}", bounds) for name, bounds in numbers_free.items()]
    unknown += [jl.Free(f"initial.chaos.{n}", (-60.0, 60.0), start=measured[0, i]) for i, n in enumerate("xyz")]
    noise = {channel: 1.0 for channel in recording.channels}
    fit = jl.fit(circuit, recording, free=unknown, noise=noise, windows=100)
    assert fit.status == "converged" and "a single trajectory cannot follow" in fit.message, fit.message
    values, sd = numbers(fit)
    assert np.all(np.abs(values[:3] - LORENZ) < 4 * sd[:3]) and np.all(sd[:3] < 5e-3 * LORENZ)
    assert all(channel.white and channel.rmse == pytest.approx(1.0, abs=0.1) for channel in fit.channels.values())
    problem = fit.problem
    assert problem is not None
    cut = cut_recordings(problem, 100)
    end = join(cut, At(problem.start, cut.guess(problem.start)))
    np.testing.assert_allclose(sd, np.sqrt(np.diag(end.covariance)), rtol=1e-3)  # chained slopes, and sparse equations
    assert any("what is simulated with the fitted numbers is no guide" in warning for warning in fit.warnings)
