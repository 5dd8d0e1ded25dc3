"""Whether a way to draw posteriors is right: simulation-based calibration."""

from typing import NamedTuple

import numpy as np


class Calibration(NamedTuple):
    """Ranks of truths among their draws, against uniform ones.

    name; ranks, shape (replicates,), each 0..num_draws; worst: pointwise probability of the least likely point of their
    cumulative distribution; limit: below which all of `level` of uniform ones stay above; inside: whether it is.
    """

    name: str
    ranks: np.ndarray
    num_draws: int
    worst: float
    limit: float
    inside: bool


def rank_of(truth: float, draws, rng: np.random.Generator | None = None) -> int:
    """Number of draws below the truth; ties at random."""
    below, equal = int(np.sum(draws < truth)), int(np.sum(draws == truth))
    return below + (int(rng.integers(0, equal + 1)) if rng is not None and equal else 0)


def thin(draws: np.ndarray, count: int) -> np.ndarray:
    """`count` draws at equal distances from a chain, the first axis, so that they are nearly independent."""
    if draws.shape[0] < count:
        raise ValueError(f"cannot thin {draws.shape[0]} draws to {count}: draw more")
    return draws[np.linspace(draws.shape[0] / count - 1, draws.shape[0] - 1, count).round().astype(int)]


def _least_likely(ranks, num_draws: int) -> np.ndarray:
    """Twice the smallest tail probability of the number of ranks up to each value; ranks: (sets, replicates)."""
    from scipy.special import bdtr

    replicates = ranks.shape[1]
    edges = np.arange(num_draws)
    counts = np.stack([(ranks <= edge).sum(axis=1) for edge in edges], axis=1)
    share = (edges + 1.0) / (num_draws + 1.0)
    below = bdtr(counts, replicates, share)
    above = 1.0 - np.where(counts > 0, bdtr(np.maximum(counts - 1, 0), replicates, share), 0.0)
    return 2.0 * np.min(np.minimum(below, above), axis=1)


def band_limit(replicates: int, num_draws: int, level: float = 0.99, simulations: int = 2000, seed: int = 0) -> float:
    """The pointwise probability whose band holds the whole cumulative distribution of uniform ranks at a level.

    Reference: Saeilynoja, Buerkner and Vehtari, "Graphical test for discrete uniformity and its applications in
    goodness-of-fit evaluation and multiple sample comparison", Statistics and Computing 32, 2022, algorithm 1.
    """
    rng = np.random.default_rng(seed)
    uniform = rng.integers(0, num_draws + 1, size=(simulations, replicates))
    return float(np.quantile(_least_likely(uniform, num_draws), 1.0 - level))


def calibrate(
    ranks: dict[str, np.ndarray], num_draws: int, level: float = 0.99, *, simulations: int = 2000, seed: int = 0
) -> list[Calibration]:
    """Test ranks of several quantities, each against its own simultaneous band.

    Args: ranks: quantity -> shape (replicates,); num_draws: draws that each truth was ranked among; level a quantity.
    Reference: Talts and others, "Validating Bayesian inference algorithms with simulation-based calibration", 2018;
    Modrak and others, Bayesian Analysis 2023 (the log-likelihood among the test quantities).
    """
    found, limit = [], None
    for name, own in ranks.items():
        limit = band_limit(own.size, num_draws, level, simulations, seed) if limit is None else limit
        worst = float(_least_likely(own[None], num_draws)[0])
        found.append(Calibration(name, own, num_draws, worst, limit, worst >= limit))
    return found
