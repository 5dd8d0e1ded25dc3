"""Design a test: the excitation, sensors and instants after which a fit knows best what is asked."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from jaxlines.inference.design_before import Before, known_before
from jaxlines.inference.design_choices import choose_measurements, even_mask
from jaxlines.inference.design_criteria import HOWS, Goal, covariance_of
from jaxlines.inference.design_excitation import AbstractExcitation
from jaxlines.inference.design_model import DesignModel, make_model
from jaxlines.inference.design_outcome import make_result
from jaxlines.inference.design_result import Design
from jaxlines.inference.design_search import Best, OutputLimit, Search, Start, check_start, descend, random_start
from jaxlines.inference.design_space import Space
from jaxlines.inference.design_target import Prediction, Target, as_target, untold
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.priors import Prior
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.integration import make_method

Progress = Callable[[str, float], None]

_ROUNDS = 4
"""At most so many times are excitation and measurements chosen in turn."""


def design(
    circuit: Circuit,
    free: Sequence[Free],
    *,
    times,
    sensors: Sequence[str],
    noise: dict,
    excite: AbstractExcitation | Sequence[AbstractExcitation] = (),
    target: str | Sequence[str] | Mapping[str, float] | Prediction | None = None,
    criterion: str | None = None,
    limits: Mapping[str, tuple[float | None, float | None]] | None = None,
    num_sensors: int | None = None,
    num_samples: int | None = None,
    evenly: bool = False,
    inputs: dict | None = None,
    known: Sequence[Known] = (),
    initial: dict | str | None = None,
    earlier: Fit | None = None,
    robust: str = "nominal",
    scenarios: int = 4,
    starts: int = 3,
    max_iterations: int = 60,
    seed: int = 0,
    solver=None,
    tolerance: float = 1e-7,
    max_steps: int = 100_000,
    precision: str = "float64",
    progress: Progress | None = None,
) -> Design:
    """Choose the test that most reduces the uncertainty of what is asked, by exact gradients through the simulator.

    A test gives the information M = sum s s'/sigma^2 of the slopes s of all readings by the parameters. With what is
    known before (priors, or an earlier fit) it leaves the covariance C that a fit will state, of which the criterion
    is made (see `Criterion`).

    Main arguments:
        circuit: the model; free: what a fit of the test will estimate, at its `start` (else prior median, else the
            number in the circuit); priors are what is known now.
        times: instants at which can be measured [s], shape (times,); the test lasts from the first to the last.
        sensors: names of outputs that can be measured; noise: standard deviation of each in SI, or a `Noise`.
        excite: inputs to be chosen: `Knots`, `Multisine` or `Scaled`, with their limits; what they start with is what
            the design is compared with.
        target: a parameter, several, weights of a combination in SI, or a `Prediction`; all parameters by default.
        criterion: "c" for one number, "D", "A" or "E" for several.

    Other arguments:
        limits: output -> (lowest, highest) in SI that the circuit must keep at each of the times; None: no limit.
        num_sensors: how many of the sensors to use; num_samples: how many of the times, the same for each sensor;
            evenly: with a start and an interval instead of freely chosen (by default all are used).
        inputs: other inputs, as for `simulate`; initial: start values in SI, or "steady".
        known: numbers that the fit will hold, with their standard uncertainty, which is counted.
        earlier: a fit of the same parameters whose estimates are taken and whose information is kept, but for that of
            its start values: the next test has its own.
        robust: "nominal" values only, or the "average" or "worst" of `scenarios` samples of the priors beside them.
        starts: searches, the first from what is given; max_iterations of each; seed: of random starts and scenarios.
        solver, tolerance, max_steps, precision: as in `simulate`; progress: called with a text and a fraction done.

    Returns: a `Design`; print it.
    Raises: ValueError, KeyError or TypeError for a wrong call, for limits that leave no room, and where no excitation
        within them can tell what is asked.
    Validity: C is that of a linearised fit: true where the model is nearly linear within a standard deviation of the
        result. What the optimiser finds is a local optimum: more starts may find a better one.
    Reference: Atkinson, Donev and Tobias, "Optimum Experimental Designs, with SAS", 2007; Franceschini and Macchietto,
        "Model-based design of experiments for parameter precision", Chem. Eng. Sci. 63, 2008.
    """
    began, say = time.perf_counter(), progress or (lambda text, share: None)
    excitations = (excite,) if isinstance(excite, AbstractExcitation) else tuple(excite)
    _check_call(excitations, num_sensors, num_samples, robust, scenarios, starts)
    say("compiling the test", 0.0)
    bounds = _limits(limits or {})
    model = make_model(
        circuit,
        free,
        times=times,
        sensors=_distinct(sensors),
        noise=noise,
        excitations=excitations,
        inputs=inputs,
        known=known,
        initial=initial,
        limited=[limit.name for limit in bounds],
        method=make_method(solver, "forward", max_steps),
        tolerance=tolerance,
        precision=precision,
    )
    asked = as_target(target, criterion, [f.label for f in model.free])
    cases = _scenarios(model, earlier, robust, scenarios, seed)
    before = [known_before(model, values, earlier) for values in cases]
    goal = Goal(tuple(asked.criterion(model, v, b) for v, b in zip(cases, before, strict=True)), robust)
    everything = np.ones((model.times.size, len(model.sensors)), dtype=int)
    search = Search(model, cases, goal, everything > 0, bounds)
    rng = np.random.default_rng(seed)
    begin = _begin(search, asked, before[0], rng, starts)
    base_mask = even_mask(everything, num_sensors, num_samples)
    base = search.trial(begin[0])
    counts, selections, best, table = everything, {}, Best(begin[0], base if not excitations else None), []
    for turn in range(_ROUNDS):
        if excitations:
            best, found = _excite(search, begin if turn == 0 else [best.coefficients], max_iterations, say, turn)
            table = found if turn == 0 else table
        if num_sensors is None and num_samples is None:
            break
        say("choosing what to measure", 0.9)
        assert best.trial is not None
        chosen, selections = choose_measurements(search, best.trial, everything, num_sensors, num_samples, evenly)
        same, counts = np.array_equal(chosen, counts), chosen
        search = dataclasses.replace(search, mask=counts > 0, _last=None)
        best = Best(best.coefficients, search.trial(best.coefficients))
        if same or not excitations:
            break
    say("done", 1.0)
    return make_result(search, asked, before[0], (base_mask > 0, begin[0]), best, counts, selections, table, began)


def _check_call(excitations, num_sensors, num_samples, robust: str, scenarios: int, starts: int) -> None:
    """Raise for a call that leaves nothing to choose, or with numbers out of range."""
    for one in excitations:
        if not isinstance(one, AbstractExcitation):
            raise TypeError(f"excite must be Knots, Multisine or Scaled, got {one!r}")
    if not excitations and num_sensors is None and num_samples is None:
        raise ValueError(
            "there is nothing to design: give excite (an input to choose), num_sensors (of the candidates) or "
            "num_samples (of the times)"
        )
    if robust not in HOWS:
        raise ValueError(f"robust must be one of {', '.join(HOWS)}, got {robust!r}")
    if scenarios < 1 or starts < 1:
        raise ValueError(f"scenarios and starts must be at least 1, got {scenarios} and {starts}")


def _distinct(sensors: Sequence[str]) -> tuple[str, ...]:
    """Names of sensors. Raises for none or a name twice."""
    names = (sensors,) if isinstance(sensors, str) else tuple(sensors)
    if not names or len(set(names)) < len(names):
        raise ValueError(f"sensors must be one or more different outputs, got {names}")
    return names


def _limits(given: Mapping) -> tuple[OutputLimit, ...]:
    """Limits of outputs, checked."""
    found = []
    for name, pair in given.items():
        low, high = (-np.inf if pair[0] is None else pair[0]), (np.inf if pair[1] is None else pair[1])
        if not low < high:
            raise ValueError(f"limits of {name} must be increasing, got {low:g} .. {high:g}: they leave no room")
        found.append(OutputLimit(name, float(low), float(high)))
    return tuple(found)


def _nominal(model: DesignModel, earlier: Fit | None) -> np.ndarray:
    """Values for which the test is designed: an earlier estimate, the start, the prior median, the circuit's number."""
    if earlier is not None and earlier.parameters:
        return np.array([earlier.parameters[f.label].value for f in model.free])
    found = []
    for f in model.free:
        number = None
        if f.start is not None:
            number = f.start
        elif isinstance(f.prior, Prior):
            number = float(f.prior.distribution.quantile(np.array([0.5]))[0])
        elif not f.paths[0].startswith("initial."):
            at = np.asarray(model.circuit[f.paths[0]] if f.paths[0] in model.circuit.paths() else np.nan)
            number = float(at) / f.path_ratios[0] if at.ndim == 0 else None
        elif f.paths[0].removeprefix("initial.") in model.initial:
            number = float(model.initial[f.paths[0].removeprefix("initial.")]) / f.path_ratios[0]
        inside = number is not None and f.bounds[0] <= number <= f.bounds[1]
        found.append(number if inside else float(f.to_value(f.start_coordinate())))
    return np.array(found)


def _scenarios(model: DesignModel, earlier: Fit | None, robust: str, count: int, seed: int) -> np.ndarray:
    """Parameter values to be considered, nominal first, shape (scenarios, free), SI."""
    nominal = _nominal(model, earlier)
    if robust == "nominal":
        return nominal[None]
    from scipy.special import ndtri
    from scipy.stats import qmc

    spread = qmc.LatinHypercube(len(model.free), rng=np.random.default_rng(seed)).random(count)
    if earlier is not None:
        nothing = np.zeros(2 * (len(nominal),))
        vary = np.linalg.cholesky(covariance_of(nothing, known_before(model, nominal, earlier).information))
        centre = np.array([f.to_coordinate(v) for f, v in zip(model.free, nominal, strict=True)])
        drawn = centre + (ndtri(spread) @ vary.T) * model.scale
    else:
        drawn = np.stack([_quantile(f, spread[:, i]) for i, f in enumerate(model.free)], axis=1)
    ends = np.array([f.coordinate_bounds() for f in model.free])
    drawn = np.clip(drawn, ends[:, 0], ends[:, 1])
    values = [[float(f.to_value(c)) for f, c in zip(model.free, row, strict=True)] for row in drawn]
    return np.concatenate([nominal[None], np.array(values)])


def _quantile(free: Free, u) -> np.ndarray:
    """Coordinates at probabilities: of the prior, or evenly between the bounds."""
    if isinstance(free.prior, Prior):
        return np.asarray(free.to_coordinate(np.clip(free.prior.distribution.quantile(u), *free.bounds)))
    low, high = free.coordinate_bounds()
    return low + u * (high - low)


def _begin(search: Search, asked: Target, before: Before, rng, starts: int) -> list[np.ndarray]:
    """Coefficients to begin with, the given ones first. Raises ValueError where no start tells what is asked."""
    model = search.model
    if not model.excitations:
        trials = [search.trial(np.zeros(0))]
        points = [np.zeros(0)]
        if not trials[0].ok:
            raise ValueError(f"the test cannot be simulated: {trials[0].outcomes[0].status}")
    else:
        space = Space(model)
        trials = [check_start(search, space)]
        points = [space.coefficients(space.nearest(space.start))]
        for _ in range(max(starts - 1, 2)):
            points.append(space.coefficients(random_start(search, space, rng)))
            trials.append(search.trial(points[-1]))
    directions = search.goal.criteria[0].directions
    verdicts = [
        untold(t.outcomes[0].rows.reshape(-1, t.outcomes[0].rows.shape[-1]), len(model.free), before.rows, directions)
        for t in trials
    ]
    if all(verdict[0] for verdict in verdicts):
        tied = ", ".join(model.free[i].label for i in verdicts[0][1])
        what = "no excitation within the limits tells" if model.excitations else "the test does not tell"
        raise ValueError(
            f"{what} {asked} from {', '.join(model.sensors)}: only together are told {tied}; add a sensor or an input, "
            "hold one of them (known), or give it a prior"
        )
    return points[:starts]


def _excite(search: Search, begin, max_iterations: int, say: Progress, turn: int) -> tuple[Best, list[Start]]:
    """Search the excitation from several starts. Raises ValueError when none keeps the limits of outputs."""
    space, best, table = Space(search.model), Best(begin[0], None), []
    for number, point in enumerate(begin):
        say(f"searching the excitation, start {number + 1} of {len(begin)}", 0.1 + 0.8 * number / len(begin))
        best, found = descend(search, space, space.scaled(point), best, max_iterations)
        table.append(found)
    if best.trial is None:
        raise ValueError(_no_room(search, begin[0]))
    return best, sorted(table, key=lambda s: (not s.kept, s.after))


def _no_room(search: Search, coefficients) -> str:
    """Why no excitation keeps the limits of outputs."""
    trial, units = search.trial(coefficients), search.model.units
    where = ", ".join(f"{limit.name} {limit.low:g} .. {limit.high:g} {units[limit.name]}" for limit in search.limits)
    for limit in search.limits:
        first = float(trial.outcomes[0].outputs[0, search.model.outputs.index(limit.name)])
        if not limit.low <= first <= limit.high:
            return (
                f"no excitation keeps the limits of outputs ({where}): {limit.name} begins at {first:g} "
                f"{units[limit.name]}; widen them or begin within them"
            )
    return (
        f"no excitation was found that keeps the limits of outputs ({where}): the starting one misses them by "
        f"{-float(trial.room.min()) if trial.room.size else 0.0:.3g} of their range; widen them, lower the limits of "
        "the inputs, or try more starts"
    )
