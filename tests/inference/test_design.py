"""Designed tests of circuits whose best test is known in closed form, and wrong calls."""

import dataclasses

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.inference.design import design
from jaxlines.inference.design_before import known_before
from jaxlines.inference.design_criteria import Goal
from jaxlines.inference.design_inputs import Knots, Multisine, Scaled
from jaxlines.inference.design_model import make_model
from jaxlines.inference.design_search import OutputLimit, Search
from jaxlines.inference.design_target import Prediction, as_target
from jaxlines.simulation.integration import make_method
from tests.inference.cases import control_line

MODULUS, VOLUME, CONDUCTANCE = 1.4e9, 0.03, 2e-11
RATE = MODULUS * CONDUCTANCE / VOLUME  # of the decay [1/s]
NOISE = {"A.pressure": 1e4}
LEAK = jl.Free("leak.conductance", (0.0, 1e-9), start=CONDUCTANCE)
PRESSURE = jl.Free("initial.A.pressure", (0.0, 9e8), start=5e6)
BULK = jl.Free("fluid.bulk_modulus", (1e8, 9e9), start=MODULUS)


def article_line(conductance: float = CONDUCTANCE) -> jl.Circuit:
    """p' = (K/V)(Q - G (p - p_tank)), as in the article: linear in p."""
    return jl.Circuit(
        jl.Oil(bulk_modulus=MODULUS, density=850.0, air_fraction=0.0, mass="article"),
        {
            "line": jl.Line("A", jl.Vessel(volume=VOLUME)),
            "valve": jl.FlowSource("A", "flow"),
            "leak": jl.LaminarLeak("A", "T", conductance=conductance),
            "tank": jl.Tank("T"),
        },
    )


TIMES = np.arange(0.0, 4.0001, 0.05) / RATE


DECAY = {"times": TIMES, "sensors": ["A.pressure"], "noise": NOISE, "inputs": {"flow": 0.0}}


def test_one_reading_of_a_decay_is_taken_at_its_time_constant():
    """Rate of exp(-rate t): t = 1/rate (Atkinson, Donev and Tobias, 2007, sec. 17.2); the start is all but known."""
    start = jl.Free("initial.A.pressure", (0.0, 9e8), start=5e6, prior=jl.Normal(5e6, 1.0))
    found = design(article_line(), [LEAK, start], **DECAY, num_samples=1, target="leak.conductance")
    assert found.times * RATE == pytest.approx([1.0])
    # variance of the rate: (sigma e / (p t))^2, of the conductance: rate V / K
    over = 5e6 - 101325.0
    expected = 1e4 * np.e / (over / RATE) * VOLUME / MODULUS
    assert found.sd[0] == pytest.approx(expected, rel=1e-5)
    assert found.target_sd == pytest.approx(expected, rel=1e-5)


def test_two_readings_of_a_decay_are_taken_at_the_start_and_the_time_constant():
    """Amplitude and rate, D-optimal: t = 0 and 1/rate (Box and Lucas, Biometrika 46, 1959)."""
    found = design(article_line(), [LEAK, PRESSURE], **DECAY, num_samples=2)
    assert found.criterion == "D"
    assert found.times * RATE == pytest.approx([0.0, 1.0])
    assert found.selections["samples"].method == "exhaustive"


@pytest.mark.slow
def test_frequency_content_by_a_rayleigh_quotient():
    """Modulus from a volume without leakage fed by sines of limited energy: the largest eigenvalue of a matrix.

    p - p0 = (K/V) sum b_k (1 - cos w_k t)/w_k over whole periods, so that sum (p - p0)^2 is a quadratic form of b.
    """
    frequencies, stop, energy = np.array([0.1, 0.2]), 10.0, 1e-9
    sines = Multisine("flow", frequencies, stop, -1e-3, 1e-3, energy=energy, per_period=30)
    times = np.linspace(0.0, stop, 201)[1:]
    found = design(
        article_line(0.0), [BULK], times=times, sensors=["A.pressure"], noise=NOISE, excite=sines,
        initial={"A.pressure": 5e6}, starts=2,
    )  # fmt: skip
    waves = (1.0 - np.cos(2 * np.pi * np.outer(times, frequencies))) / (2 * np.pi * frequencies)
    values, vectors = np.linalg.eigh(waves.T @ waves)
    amplitudes = np.sqrt(2.0 * energy / stop) * np.abs(vectors[:, -1])
    profile = found.profiles["flow"]
    assert profile.amplitudes == pytest.approx(amplitudes, rel=2e-2)
    expected = 1e4 / np.sqrt(values[-1] * 2.0 * energy / stop) * VOLUME
    assert found.sd[0] == pytest.approx(expected, rel=1e-2)
    assert "energy of flow" in found.active
    assert found.improvement > 1.5


def knots(**more) -> Knots:
    times = np.linspace(0.0, 20.0, 6)
    return Knots("flow", times, -6e-5, 6e-5, start=np.array([0.0, 2e-5, 4e-5, 2e-5, 0.0, 0.0]), **more)


FREE = [
    jl.Free("fluid.bulk_modulus", (0.5e9, 4e9), start=1.4e9, transform="log"),
    jl.Free("fluid.air_fraction", (1e-5, 0.1), start=7e-3, transform="log"),
    jl.Free("leak.conductance", (0.0, 2e-11), start=1e-12),
    jl.Free("initial.A.pressure", (1.1e5, 8e5), start=3e5, prior=jl.Normal(3e5, 5e4)),
]
SAMPLES = np.linspace(0.0, 20.0, 41)
AIR = "fluid.air_fraction"
KNOWN = [jl.Known("line.parts.0.volume", 3e-5)]
PLAN = {"times": SAMPLES, "sensors": ["A.pressure"], "noise": {"A.pressure": 4e4}, "tolerance": 1e-8}


@pytest.fixture(scope="module")
def designed():
    """A profile for the air fraction within limits of level, rate and pressure."""
    return design(
        control_line(), FREE, **PLAN, excite=knots(rate=2e-5, first=0.0), target=AIR,
        limits={"A.pressure": (1.2e5, 8e6)}, known=KNOWN, starts=1, max_iterations=20,
    )  # fmt: skip


def test_designed_profile_keeps_its_limits(designed):
    profile = designed.profiles["flow"]
    assert np.all(profile.values <= 6e-5 * (1 + 1e-6)) and np.all(profile.values >= -6e-5 * (1 + 1e-6))
    assert np.abs(np.diff(profile.values) / np.diff(profile.times)).max() <= 2e-5 * (1 + 1e-6)
    assert profile.values[0] == 0.0
    pressure = designed.outputs["A.pressure"]
    assert pressure.min() >= 1.2e5 * (1 - 1e-4) and pressure.max() <= 8e6 * (1 + 1e-4)
    assert any("A.pressure at its highest, 8e+06" in text for text in designed.active)
    assert designed.improvement > 1.3


def model_of(tolerance: float):
    """The test of `designed`, compiled."""
    plan = {**PLAN, "tolerance": tolerance}
    method = make_method(None, "forward", 100_000)
    return make_model(
        control_line(), FREE, **plan, excitations=(knots(),), method=method, known=KNOWN, precision="float64"
    )


def test_predicted_standard_deviations_against_differences_of_simulations(designed):
    """Slopes of the readings by differences, the covariance by the book: (J'J)^-1 plus what the held volume adds."""
    model = model_of(1e-10)
    values, moves = np.array([*designed.values, 0.03]), np.array([1e6, 1e-5, 1e-14, 1e2, 1e-5])

    def shown(coefficients, numbers):
        moved = dataclasses.replace(model, known_values=numbers[4:])
        return moved.derive(numbers[:4], coefficients).outputs[:, 0]

    profile = designed.profiles["flow"]
    for test, expected in ((profile.base_values, designed.sd_base), (profile.values, designed.sd)):
        ends = [shown(test, values + row) - shown(test, values - row) for row in np.diag(moves)]
        slopes = np.array(ends).T / (2.0 * moves) / 4e4
        rows = np.concatenate([slopes[:, :4], [[0.0, 0.0, 0.0, 1.0 / 5e4]]])
        scale = values[:4]
        inverse = np.linalg.inv((rows * scale).T @ (rows * scale)) * np.outer(scale, scale)
        moved = inverse @ slopes[:, :4].T @ slopes[:, 4] * 3e-5
        np.testing.assert_allclose(np.sqrt(np.diag(inverse + np.outer(moved, moved))), expected, rtol=2e-3)


def test_result_reads_well(designed):
    text = str(designed)
    assert text.startswith("fluid.air_fraction (criterion c): standard deviation ")
    assert " by the starting test, which does not keep the limits: " in text and "times smaller\n" in text
    assert "measure A.pressure at 41 of 41 instants" in text
    row = designed.table()[1]
    assert row["name"] == AIR and row["unit"] == "1" and np.isinf(row["sd_before"])
    assert row["ratio"] == pytest.approx(designed.improvement, rel=1e-6)
    assert designed.table()[3]["sd_before"] == pytest.approx(5e4)
    assert designed.starts[0].kept


def test_gradient_is_exact(designed):
    """Slopes of the criterion and of the distances to limits, against central differences."""
    model, values = model_of(1e-10), designed.values
    goal = Goal((as_target(AIR, None, designed.names).criterion(model, values, known_before(model, values, None)),))
    limits = (OutputLimit("A.pressure", 1.2e5, 8e6),)
    search = Search(model, values[None], goal, np.ones((41, 1), bool), limits)
    point, step = designed.profiles["flow"].base_values + 3e-6, 1e-9
    trial = search.trial(point)
    for k in (1, 4):
        ends = [search.trial(point + sign * step * np.eye(6)[k]) for sign in (1, -1)]
        slope = (ends[0].goal - ends[1].goal) / (2 * step)
        assert trial.slopes[0, k] == pytest.approx(slope, rel=2e-4)
        room = (ends[0].room - ends[1].room) / (2 * step)
        np.testing.assert_allclose(trial.room_slopes[:, k], room, rtol=1e-3, atol=1e-3 * np.abs(room).max())


@pytest.mark.parametrize("how", ["average", "worst"])
def test_robust_design_is_better_over_the_samples(how):
    """Over what is thought possible the criterion falls; the samples are of the prior."""
    priors = [*FREE[:1], dataclasses.replace(FREE[1], prior=jl.LogNormal(7e-3, 0.3)), *FREE[2:]]
    priors[0] = dataclasses.replace(FREE[0], prior=jl.LogNormal(1.4e9, 0.1))
    priors[2] = dataclasses.replace(FREE[2], prior=jl.Normal(1e-12, 2e-13))
    found = design(
        control_line(), priors, **PLAN, excite=knots(rate=2e-5, first=0.0), target=AIR, known=KNOWN,
        limits={"A.pressure": (1.1e5, 12e6)}, robust=how, scenarios=3, starts=1, max_iterations=5, seed=1,
    )  # fmt: skip
    assert found.scenarios.shape == (4, 4)
    assert np.std(np.log(found.scenarios[1:, 1])) == pytest.approx(0.3, rel=0.5)
    assert found.robust == how and found.improvement > 1.05


def test_prediction_is_made_sure_of():
    """Pressure long after, of a decay with one unknown: read at the time constant, and the slope of exp(-rate t)."""
    start = jl.Free("initial.A.pressure", (0.0, 9e8), start=5e6, prior=jl.Normal(5e6, 1.0))
    final = Prediction("A.pressure", TIMES, {"flow": 0.0}, of="final")
    found = design(article_line(), [LEAK, start], **DECAY, num_samples=1, target=final)
    assert found.target == "final of A.pressure" and found.criterion == "c"
    assert found.times * RATE == pytest.approx([1.0])
    slope = (5e6 - 101325.0) * 4.0 / RATE * np.exp(-4.0) * MODULUS / VOLUME  # by the conductance
    assert found.target_sd == pytest.approx(slope * found.sd[0], rel=1e-3)


@pytest.fixture(scope="module")
def earlier():
    """A fit of a decay: leak and start free, the vessel's volume known to 1 %."""
    pressure = 101325.0 + (5e6 - 101325.0) * np.exp(-RATE * TIMES)
    noisy = pressure + 1e4 * np.random.default_rng(2).standard_normal(TIMES.size)
    recording = jl.Recording(TIMES, {"A.pressure": noisy, "flow": np.zeros(TIMES.size)})
    known = [jl.Known("line.parts.0.volume", 0.01 * VOLUME)]
    return jl.fit(article_line(), recording, free=[LEAK, PRESSURE], known=known, noise=NOISE)


def test_the_same_test_again_halves_the_variance_but_not_what_both_rest_on(earlier):
    """The volume is the same in both tests, and moves the leak by 1 %; each has a start of its own."""
    found = design(
        article_line(), [LEAK, PRESSURE], **DECAY, num_samples=TIMES.size, target=LEAK.label, earlier=earlier,
        known=earlier.problem.known,
    )  # fmt: skip
    estimate = earlier.parameters[LEAK.label]
    by_volume = 0.01 * estimate.value
    by_noise = np.sqrt(estimate.sd**2 - by_volume**2)
    assert by_noise > 0.05 * by_volume
    assert found.values[0] == estimate.value
    assert found.sd_before[0] == pytest.approx(estimate.sd, rel=1e-3) and np.isinf(found.sd_before[1])
    assert found.sd[0] == pytest.approx(np.hypot(by_noise / np.sqrt(2.0), by_volume), rel=1e-3)
    alone = design(article_line(), [LEAK, PRESSURE], **DECAY, num_samples=TIMES.size, target=LEAK.label)
    rest = design(article_line(), [LEAK, PRESSURE], **DECAY, num_samples=TIMES.size, target=LEAK.label, earlier=earlier)
    # Another vessel now: the first test counts as its noise says, and its share of the volume's error stays.
    share = (alone.sd[0] / by_noise) ** 2 / (1.0 + (alone.sd[0] / by_noise) ** 2)
    noise = (alone.sd[0] ** -2 + by_noise**-2) ** -0.5
    assert rest.sd[0] == pytest.approx(np.hypot(noise, share * by_volume), rel=2e-3)


def test_an_earlier_fit_of_other_parameters_is_refused(earlier):
    with pytest.raises(ValueError, match="the same free parameters and transforms: leak"):
        design(article_line(), [LEAK], **DECAY, num_samples=1, earlier=earlier, initial={"A.pressure": 5e6})


MISTAKES = [
    ({}, "there is nothing to design: give excite"),
    ({"excite": Knots("flwo", [0, 20], -1, 1)}, "no input 'flwo' to be designed; it has flow"),
    ({"excite": knots(), "criterion": "G"}, "criterion must be one of D, A, E, c, got 'G'"),
    ({"excite": knots(), "target": "fluid.air"}, "'fluid.air' is not free"),
    ({"excite": knots(), "criterion": "c"}, "criterion c is for one number, got 4 parameters"),
    ({"excite": knots(), "noise": {}}, "noise of A.pressure is missing: before a test it cannot be estimated"),
    ({"excite": knots(), "limits": {"A.pressure": (8e6, 1e6)}}, "must be increasing, got 8e.06 .. 1e.06"),
    ({"excite": knots(), "robust": "median"}, "robust must be one of nominal, average, worst"),
    ({"excite": knots(), "inputs": {"flow": 0.0}}, "input 'flow' is given twice"),
    ({"excite": knots(), "initial": {"A.pressure": "measured"}}, "must be a number in SI before the test"),
    ({"excite": knots(rate=1e-6, first=-6e-5, last=6e-5)}, "the limits of flow leave no room"),
    ({"num_samples": 3}, "needs an input 'flow'"),
]


@pytest.mark.parametrize(("more", "message"), MISTAKES, ids=[text[:30] for _, text in MISTAKES])
def test_mistakes(more, message):
    with pytest.raises((ValueError, KeyError), match=message):
        design(control_line(), FREE, **{**PLAN, **more})


def test_limits_of_an_input_without_room():
    with pytest.raises(ValueError, match="flow: low and high must be finite and increasing"):
        Knots("flow", [0, 1], 1e-5, 1e-5)
    with pytest.raises(ValueError, match="times of the knots must be two or more and increase"):
        Knots("flow", [1, 0], 0, 1e-5)
    with pytest.raises(ValueError, match="frequencies must be positive"):
        Multisine("flow", [0.0], 1.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="smallest must be less than largest"):
        Scaled("flow", [0, 1], [0, 1], 0.0, 1.0, 2.0, 1.0)
    with pytest.raises(ValueError, match="one of peak, trough, final"):
        Prediction("A.pressure", [0, 1], {}, of="top")


def test_what_no_test_can_tell():
    """A leak to a tank of the same pressure, with nothing flowing."""
    start = jl.Free("initial.A.pressure", (0.0, 9e8), start=101325.0)
    with pytest.raises(
        ValueError, match=r"the test does not tell leak.conductance from A.pressure: only together are "
    ):
        design(article_line(), [LEAK, start], **DECAY, num_samples=3, target="leak.conductance")


@pytest.mark.slow
def test_what_no_excitation_can_tell():
    """Modulus and volume of an oil without air, known only as their ratio."""
    free = [BULK, jl.Free("line.parts.0.volume", (0.001, 0.1), start=VOLUME)]
    excite = Knots("flow", [0.0, 10.0, 20.0], 0.0, 1e-5)
    with pytest.raises(ValueError, match=r"no excitation within the limits tells fluid.bulk_modulus from A.pressure"):
        design(article_line(), free, **PLAN, excite=excite, target="fluid.bulk_modulus", initial={"A.pressure": 1e6})
