"""How short the steps of the explicit scheme must be for the fastest motions of a circuit, from its Jacobian.

A linear mode y' = lambda y grows by R(h lambda) in a step h, where R is the polynomial of the scheme. Steps are too
long where some mode of the Jacobian grows although it decays.

Reference: Hairer and Wanner, "Solving Ordinary Differential Equations II", 2nd ed. 1996, IV.2 (stability function).
"""

from collections.abc import Callable

import numpy as np

from jaxlines.simulation.lockstep import ADVANCE, DECAY

MOST_SPECTRA = 20_000_000
"""Cubes of states times lanes beyond which only the lanes with the largest Jacobians have theirs looked at."""

NUDGE = 1e-6
"""Change of a state, in units of its typical size, for differences."""


def growth(z: np.ndarray) -> np.ndarray:
    """R(z) of the explicit scheme: what one step of h makes of y = 1 with y' = lambda y, z = h lambda (complex)."""
    y, memory = np.ones_like(z, dtype=complex), np.zeros_like(z, dtype=complex)
    for kept, go in zip(DECAY, ADVANCE, strict=True):
        memory = kept * memory + z * y
        y = y + go * memory
    return y


def steps_needed(eigenvalues: np.ndarray, interval: float, most: int) -> int:
    """The fewest equal steps of an interval [s] in which no mode that decays grows, `most` if there are not so few.

    Args: eigenvalues of the Jacobian [1/s], any shape.
    """
    z = interval * np.ravel(eigenvalues)
    counts = np.unique(np.ceil(np.geomspace(1, most, 120)).astype(int))
    scaled = z / counts[:, None]
    with np.errstate(all="ignore"):
        allowed = np.exp(np.minimum(np.maximum(scaled.real, 0.0), 50.0)) * (1.0 + 1e-6)
        unstable = ~(np.abs(growth(scaled)) <= allowed).all(axis=1)
    if not unstable.any():
        return 1
    last = int(np.flatnonzero(unstable)[-1])
    return int(counts[last + 1]) if last + 1 < len(counts) else most


def spectra(rates: Callable, states: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Eigenvalues [1/s] of the Jacobians of some lanes, by differences, shape (lanes, states).

    Args: rates(lane, states): the rates of a lane in several states, (states, copies) both; states: of each lane,
        (states, lanes); sizes: typical size of each state, (states,).
    """
    count, lanes = states.shape
    found = []
    for lane in range(lanes):
        moved = np.repeat(states[:, lane, None], count + 1, axis=1)
        moved[np.arange(count), np.arange(count)] += NUDGE * sizes
        slopes = rates(lane, moved)
        jacobian = (slopes[:, :-1] - slopes[:, -1:]) / NUDGE / sizes[:, None]
        found.append(np.where(np.isfinite(jacobian), jacobian, 0.0))
    norms = [np.linalg.norm(jacobian) for jacobian in found]
    most = max(int(MOST_SPECTRA / max(count, 1) ** 3), 1)
    chosen = np.argsort(norms)[::-1][:most]
    return np.stack([np.linalg.eigvals(found[lane]) for lane in chosen])
