"""Linear propagation of uncertainty next to sampling, with the error that linearising makes."""

import dataclasses

import numpy as np

from jaxlines.inference.samplers import Sobol
from jaxlines.inference.uncertain import Uncertain

_POINTS = 4096
_STEP = 0.01
"""Step of central differences in standard deviations of the number."""


@dataclasses.dataclass(frozen=True)
class Linear:
    """y = f(mean of x) + g (x - mean), so that V(y) = g C g^T with the covariance C of x.

    Fields: output; names; value: f at the means; derivatives g, shape (names,); sd of y; shares of its variance, shape
    (names,) (each number alone; they add up to one when numbers are independent); curvature: second-order shift of the
    mean, 1/2 sum f_ii V(x_i); method of the derivatives. Filled in from sampled lanes: sampled_mean, sampled_sd;
    remainder: root mean square of y - linear y over the sampled sd (0: linear; 1: linearising says nothing).
    Reference: JCGM 100:2008 (GUM), 5.1.2.
    """

    output: str
    names: tuple[str, ...]
    means: np.ndarray
    value: float
    derivatives: np.ndarray
    sd: float
    shares: np.ndarray
    curvature: float
    method: str
    sampled_mean: float = np.nan
    sampled_sd: float = np.nan
    remainder: float = np.nan

    def compared(self, samples: np.ndarray, values: np.ndarray) -> "Linear":
        """With its error, from lanes that succeeded: samples, shape (lanes, names), values, shape (lanes,)."""
        if len(values) < 2:
            return self
        linear = self.value + (samples - self.means) @ self.derivatives
        sd = float(values.std(ddof=1))
        rest = float(np.sqrt(np.mean((values - linear) ** 2))) / sd if sd > 0 else np.nan
        return dataclasses.replace(self, sampled_mean=float(values.mean()), sampled_sd=sd, remainder=rest)


def lanes_to_evaluate(uncertain: Uncertain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means and covariance of the numbers (from 4096 points), and the lanes of central differences around the means.

    Returns: means, shape (names,); covariance, shape (names, names); lanes, shape (1 + 2 names, names).
    """
    points = uncertain.values(Sobol(0).uniforms(0, _POINTS, uncertain.dims))
    means, count = points.mean(axis=0), points.shape[1]
    centred = points - means
    covariance = centred.T @ centred / (len(points) - 1)
    steps = np.diag(_STEP * np.sqrt(np.diag(covariance)))
    return means, covariance, np.concatenate([means[None], means + steps, means - steps]).reshape(1 + 2 * count, count)


def linear_propagation(output, names, means, covariance, lanes, values, exact=None) -> Linear:
    """Linear propagation from the outputs of `lanes_to_evaluate`.

    Args: values, shape (1 + 2 names,), of the output; exact: derivatives at the means, shape (names,), where there are.
    """
    count = len(names)
    steps = np.diag(lanes[1 : 1 + count]) - means
    safe = np.where(steps > 0, steps, 1.0)
    up, down = values[1 : 1 + count], values[1 + count :]
    gradient = np.where(steps > 0, (up - down) / (2 * safe), 0.0)
    second = np.where(steps > 0, (up - 2 * values[0] + down) / safe**2, 0.0)
    method = "central differences"
    if exact is not None:
        gradient, method = np.asarray(exact, dtype=float), "exact derivatives"
    variance = float(gradient @ covariance @ gradient)
    alone = gradient**2 * np.diag(covariance)
    shares = alone / variance if variance > 0 else np.zeros(count)
    curvature = float(0.5 * second @ np.diag(covariance))
    sd = float(np.sqrt(max(variance, 0.0)))
    return Linear(output, tuple(names), means, float(values[0]), gradient, sd, shares, curvature, method)


def differences(run, lanes: np.ndarray, scales: np.ndarray) -> dict[str, np.ndarray]:
    """Derivatives of the reductions of many lanes by central differences.

    Args: run: lanes (any, names) -> {reduction: (any,)}; lanes, shape (lanes, names); scales: standard deviations of
        the numbers, shape (names,).
    Returns: reduction -> shape (lanes, names).
    """
    columns: dict[str, list[np.ndarray]] = {}
    for j, scale in enumerate(scales):
        step = np.zeros(lanes.shape[1])
        step[j] = _STEP * scale
        up, down = run(lanes + step), run(lanes - step)
        for name, values in up.items():
            columns.setdefault(name, []).append((values - down[name]) / (2 * _STEP * scale))
    return {name: np.stack(found, axis=1) for name, found in columns.items()}
