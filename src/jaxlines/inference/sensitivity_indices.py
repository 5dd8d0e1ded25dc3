"""What spreads an output: Sobol indices, Morris and Shapley effects, derivative-based measures, tornado."""

import dataclasses
from typing import Any

import numpy as np

RESAMPLES = 100


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """How much each uncertain number matters for one output.

    Fields: method; output; names of the numbers; measures: name of a measure ("first", "total", ...) -> values, shape
    (names,) ("second": (names, names)); confidence: half-widths of the 95 % intervals of the same; bounds: measure ->
    (low, high) when the failed lanes had given the smallest, or the largest, value that was seen; blocks of lanes that
    belong together, failed_blocks among them.
    """

    method: str
    output: str
    names: tuple[str, ...]
    measures: dict[str, np.ndarray]
    confidence: dict[str, np.ndarray]
    bounds: dict[str, tuple[np.ndarray, np.ndarray]]
    blocks: int
    failed_blocks: int


def _salib(module: str) -> Any:
    """A module of SALib, or an error that says how to get it."""
    import importlib

    try:
        return importlib.import_module(f"SALib.{module}")
    except ImportError as error:
        raise ImportError("sensitivity indices need SALib: pip install 'jaxlines[sensitivity]'") from error


def _problem(names) -> dict:
    return {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}


def _blocks(values: np.ndarray, good: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Values and whether all are good, by whole blocks: shapes (blocks, size), (blocks,)."""
    whole = len(values) // size * size
    return values[:whole].reshape(-1, size), np.asarray(good[:whole].reshape(-1, size).all(axis=1))


def _with_failures(values: np.ndarray, good: np.ndarray, size: int, estimate) -> tuple[dict, dict, dict, int, int]:
    """An estimate from the whole blocks, its confidence, and what it would be with failed lanes at either extreme."""
    blocks, complete = _blocks(values, good, size)
    if complete.sum() < 2:
        raise ValueError(f"sensitivity indices need two or more blocks of {size} lanes without a failed one")
    measures, confidence = estimate(blocks[complete], complete)
    bounds = {}
    if not complete.all():
        seen = values[good]
        filled = [np.where(good, values, end)[: blocks.size].reshape(blocks.shape) for end in (seen.min(), seen.max())]
        others = [estimate(piece, np.ones(len(piece), bool))[0] for piece in filled]
        for name, value in measures.items():
            every = np.stack([value, *(other[name] for other in others)])
            bounds[name] = (every.min(axis=0), every.max(axis=0))
    return measures, confidence, bounds, len(blocks), int((~complete).sum())


def sobol_indices(output: str, names, values, good, second_order: bool = False) -> Sensitivity:
    """Sobol indices from lanes of `SobolIndices`: S_i = V(E(y | x_i))/V(y), and S_Ti = E(V(y | all but x_i))/V(y).

    Args: output: its name; names of the numbers; values, good (whether a lane succeeded), shape (lanes,), in the order
        of the sampler; second_order as in the sampler.
    Returns: measures "first", "total" and, where asked for, "second" (upper triangle), with bootstrap confidence.
    Raises: ValueError when fewer than two blocks are complete; ImportError without SALib.
    Reference: Saltelli and others, Computer Physics Communications 181, 2010.
    """
    names, analyze = tuple(names), _salib("analyze.sobol").analyze
    size = 2 * len(names) + 2 if second_order else len(names) + 2

    def estimate(blocks, complete):
        if np.ptp(blocks) == 0.0:
            nothing = {"first": np.zeros(len(names)), "total": np.zeros(len(names))}
            return nothing, nothing
        found = analyze(_problem(names), blocks.ravel(), second_order, RESAMPLES, seed=1)
        keys = {"first": "S1", "total": "ST"} | ({"second": "S2"} if second_order else {})
        return ({n: np.asarray(found[k]) for n, k in keys.items()},
                {n: np.asarray(found[f"{k}_conf"]) for n, k in keys.items()})  # fmt: skip

    return Sensitivity("Sobol", output, names, *_with_failures(np.asarray(values), np.asarray(good), size, estimate))


def morris_effects(output: str, names, uniforms, values, good, levels: int = 4) -> Sensitivity:
    """Elementary effects from lanes of `Morris`: change of the output over the change of the probability level.

    Args: uniforms, shape (lanes, names), of the sampler; the others as for `sobol_indices`.
    Returns: measures "mu", "mu_star" (mean of absolute effects) and "sigma" (interactions and curvature), in the unit
        of the output, with the confidence of mu_star.
    Reference: Campolongo, Cariboni and Saltelli, Environmental Modelling & Software 22, 2007.
    """
    names, analyze = tuple(names), _salib("analyze.morris").analyze
    size = len(names) + 1
    levels_of = np.asarray(uniforms)[: len(values) // size * size].reshape(-1, size, len(names))
    stretched = (levels_of * levels - 0.5) / (levels - 1)  # SALib's levels are 0, 1/(m - 1), ..., 1

    def estimate(blocks, complete):
        points = stretched[complete].reshape(-1, len(names))
        found = analyze(_problem(names), points, blocks.ravel(), RESAMPLES, num_levels=levels, seed=1)
        measures = {key: np.asarray(found[key], dtype=float) for key in ("mu", "mu_star", "sigma")}
        return measures, {"mu_star": np.asarray(found["mu_star_conf"], dtype=float)}

    return Sensitivity("Morris", output, names, *_with_failures(np.asarray(values), np.asarray(good), size, estimate))


def shapley_effects(output: str, names, uniforms, values, good) -> Sensitivity:
    """Shapley effects from lanes of `ShapleyEffects`: shares of the variance that add up to one, interactions divided.

    Args, Raises: as `morris_effects`. Returns: measure "share" with confidence.
    Reference: Goda, Reliability Engineering & System Safety 213, 2021; Owen, "Sobol' indices and Shapley value", 2014.
    """
    names, analyze = tuple(names), _salib("analyze.shapley").analyze
    size = len(names) + 1
    points = np.asarray(uniforms)[: len(values) // size * size].reshape(-1, size, len(names))

    def estimate(blocks, complete):
        found = analyze(_problem(names), points[complete].reshape(-1, len(names)), blocks.ravel())
        return ({"share": np.asarray(found["shapley_normalized"])},
                {"share": np.asarray(found["shapley_normalized_conf"])})  # fmt: skip

    return Sensitivity("Shapley", output, names, *_with_failures(np.asarray(values), np.asarray(good), size, estimate))


def derivative_based(output: str, names, effects, values, good) -> Sensitivity:
    """Derivative-based measure: an upper bound of the total Sobol index from gradients in the lanes.

    With every number written as x_i(z_i) of a standard normal z_i, whose Poincare constant is one,
    S_Ti <= E((dy/dz_i)^2)/V(y), dy/dz_i = dy/dx_i dx_i/dz_i.

    Args: effects dy/dz, shape (lanes, names); values, good, shape (lanes,); lanes that are independent samples (Monte
        Carlo, Latin hypercube, Sobol).
    Returns: measures "total_bound" and "rms" (root of the mean square of dy/dz, unit of y) with confidence of the first
        (lanes as independent).
    Reference: Kucherenko and Iooss, "Derivative-based global sensitivity measures", 2017; Lamboley and others, 2013.
    """
    usable = np.asarray(good) & np.isfinite(effects).all(axis=1)
    squares, kept = np.asarray(effects)[usable] ** 2, np.asarray(values)[usable]
    if len(kept) < 2 or np.var(kept) == 0.0:
        raise ValueError("derivative-based measures need two or more lanes that succeeded and differ")
    variance, mean = np.var(kept, ddof=1), squares.mean(axis=0)
    half = 1.96 * squares.std(axis=0, ddof=1) / np.sqrt(len(kept)) / variance
    measures = {"total_bound": mean / variance, "rms": np.sqrt(mean)}
    failed = int(len(usable) - usable.sum())
    return Sensitivity("derivatives", output, tuple(names), measures, {"total_bound": half}, {}, len(usable), failed)


def tornado(output: str, names, samples, values, good, share: float = 0.1) -> Sensitivity:
    """Mean of the output where each number is among its lowest, and its highest, tenth; from any lanes.

    Args: samples, shape (lanes, names); values, good, shape (lanes,); share of the lanes at either end.
    Returns: measures "low", "high" (means, unit of the output) and "swing" = high - low, with confidence of the means;
        NaN for a number that does not vary or when too few lanes are left.
    """
    kept, ys = np.asarray(samples)[good], np.asarray(values)[good]
    found = np.full((4, len(names)), np.nan)
    count = int(share * len(ys))
    if count >= 2:
        for j in range(len(names)):
            if np.ptp(kept[:, j]) == 0.0:
                continue
            order = np.argsort(kept[:, j], kind="stable")
            ends = ys[order[:count]], ys[order[-count:]]
            found[:, j] = [*(end.mean() for end in ends), *(1.96 * end.std(ddof=1) / np.sqrt(count) for end in ends)]
    low, high, low_half, high_half = found
    measures = {"low": low, "high": high, "swing": high - low}
    confidence = {"low": low_half, "high": high_half, "swing": np.hypot(low_half, high_half)}
    failed = int(len(good) - np.sum(good))
    return Sensitivity("tornado", output, tuple(names), measures, confidence, {}, len(good), failed)
