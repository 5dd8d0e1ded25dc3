"""Designed tests of circuits whose best test is known in closed form, and wrong calls."""

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.inference.design import design
from jaxlines.inference.design_inputs import Knots, Multisine, Scaled
from jaxlines.inference.design_target import Prediction
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
PLAN = {"times": SAMPLES, "sensors": ["A.pressure"], "noise": {"A.pressure": 4e4}, "tolerance": 1e-8}


@pytest.fixture(scope="module")
def designed():
    """A profile for the air fraction within limits of level, rate and pressure."""
    return design(
        control_line(), FREE, **PLAN, excite=knots(rate=2e-5, first=0.0), target=AIR,
        limits={"A.pressure": (1.2e5, 8e6)}, known=[jl.Known("line.parts.0.volume", 3e-5)], starts=2, max_iterations=25,
    )  # fmt: skip


def test_designed_profile_keeps_its_limits(designed):
    profile = designed.profiles["flow"]
    assert np.all(profile.values <= 6e-5 * (1 + 1e-6)) and np.all(profile.values >= -6e-5 * (1 + 1e-6))
    assert np.abs(np.diff(profile.values) / np.diff(profile.times)).max() <= 2e-5 * (1 + 1e-6)
    assert profile.values[0] == 0.0
    fine = np.linspace(0.0, 20.0, 41)
    shown = jl.simulate(control_line(), fine, designed.inputs, initial={"A.pressure": 3e5}, tolerance=1e-9)
    pressure = np.asarray(shown["A.pressure"])
    np.testing.assert_allclose(pressure, designed.outputs["A.pressure"], rtol=1e-5)
    assert pressure.min() >= 1.2e5 * (1 - 1e-4) and pressure.max() <= 8e6 * (1 + 1e-4)
    assert any("A.pressure at its highest, 8e+06" in text for text in designed.active)
    assert designed.improvement > 1.3


def test_predicted_standard_deviations_against_differences_of_simulations(designed):
    """Slopes of the readings by differences, the covariance by the book: (J'J)^-1 plus what the held volume adds."""
    paths = [*designed.names, "line.parts.0.volume"]
    values = np.array([*designed.values, 0.03])
    sigma, moves = 4e4, np.array([1e6, 1e-5, 1e-14, 1e2, 1e-5])

    def shown(inputs, numbers):
        in_circuit = dict(zip(paths, numbers, strict=True))
        start = {"A.pressure": in_circuit.pop("initial.A.pressure")}
        circuit = control_line().replace(in_circuit)
        return jl.simulate(circuit, SAMPLES, inputs, initial=start, outputs=["A.pressure"], tolerance=1e-10)

    for inputs, expected in ((designed.base_inputs, designed.sd_base), (designed.inputs, designed.sd)):
        ends = [[shown(inputs, values + sign * row)["A.pressure"] for sign in (1, -1)] for row in np.diag(moves)]
        slopes = np.array([(np.asarray(up) - np.asarray(down)) / 2 for up, down in ends]).T / moves / sigma
        rows = np.concatenate([slopes[:, :4], [[0.0, 0.0, 0.0, 1.0 / 5e4]]])
        scale = values[:4]
        inverse = np.linalg.inv((rows * scale).T @ (rows * scale)) * np.outer(scale, scale)
        moved = inverse @ slopes[:, :4].T @ slopes[:, 4] * 3e-5
        np.testing.assert_allclose(np.sqrt(np.diag(inverse + np.outer(moved, moved))), expected, rtol=2e-3)


def test_result_reads_well(designed):
    text = str(designed)
    assert text.startswith("fluid.air_fraction: criterion c, standard deviation")
    assert "times smaller than by the starting test" in text
    assert "measure A.pressure at 41 of 41 instants" in text
    row = designed.table()[1]
    assert row["name"] == AIR and row["unit"] == "1" and np.isinf(row["sd_before"])
    assert row["ratio"] == pytest.approx(designed.improvement, rel=0.02)
    assert designed.table()[3]["sd_before"] == pytest.approx(5e4)
    assert designed.starts[0].kept


def test_gradient_is_exact(designed):
    """Slopes of the criterion and of the distances to limits, against central differences."""
    from jaxlines.inference.design import _limits
    from jaxlines.inference.design_criteria import Goal
    from jaxlines.inference.design_model import make_model
    from jaxlines.inference.design_search import Search
    from jaxlines.inference.design_target import as_target, known_before
    from jaxlines.simulation.integration import make_method

    model = make_model(
        control_line(),
        FREE,
        **{**PLAN, "tolerance": 1e-10},
        excitations=(knots(),),
        method=make_method(None, "forward", 100_000),
        known=[jl.Known("line.parts.0.volume", 3e-5)],
        limited=["A.pressure"],
        precision="float64",
    )
    values = designed.values
    goal = Goal((as_target(AIR, None, designed.names).criterion(model, values, known_before(model, values, None)),))
    search = Search(model, values[None], goal, np.ones((41, 1), bool), _limits({"A.pressure": (1.2e5, 8e6)}))
    point, step = designed.profiles["flow"].base_values + 3e-6, 1e-9
    trial = search.trial(point)
    for k in (1, 4):
        ends = [search.trial(point + sign * step * np.eye(6)[k]) for sign in (1, -1)]
        slope = (ends[0].goal - ends[1].goal) / (2 * step)
        assert trial.slopes[0, k] == pytest.approx(slope, rel=2e-4)
        room = (ends[0].room - ends[1].room) / (2 * step)
        np.testing.assert_allclose(trial.room_slopes[:, k], room, rtol=1e-3, atol=1e-3 * np.abs(room).max())


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
    """Modulus and volume of an oil without air, known only as their ratio."""
    free = [BULK, jl.Free("line.parts.0.volume", (0.001, 0.1), start=VOLUME)]
    message = "the test does not tell fluid.bulk_modulus from A.pressure: only together are told fluid.bulk_modulus"
    with pytest.raises(ValueError, match=message):
        design(
            article_line(), free, **{**DECAY, "inputs": {"flow": 1e-5}}, initial={"A.pressure": 1e6},
            target="fluid.bulk_modulus", num_samples=3,
        )  # fmt: skip
