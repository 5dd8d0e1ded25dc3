"""Lanes taken from step to step by the implicit engine, driven from the host: pilots need no long compilation."""

from typing import NamedTuple

import jax
import numpy as np

from jaxlines.simulation.ensemble import EnsembleProgram
from jaxlines.simulation.ensemble_program import compiled
from jaxlines.simulation.explicit_stability import spectra
from jaxlines.simulation.graded_steps import graded_steps
from jaxlines.simulation.implicit_programs import implicit_outputs, implicit_start, implicit_trial, state_rates
from jaxlines.simulation.plan import scales, unravel
from jaxlines.simulation.precision import cast, computing_in

LOOKS = 4
"""At how many samples the Jacobians are looked at."""


class Shown(NamedTuple):
    """The wanted outputs (samples, wanted, lanes), NaN for failed lanes, and an error estimate for each lane."""

    series: np.ndarray
    estimate: np.ndarray


class LaneStepper:
    """Lanes of an ensemble, and where they have been.

    Args: made: the ensemble; columns: the varied numbers of the lanes; count: how many of them matter (the rest fill
    up); precision.
    """

    def __init__(self, made: EnsembleProgram, columns: list[np.ndarray], count: int, precision: str):
        inner = made.with_implicit_engine().program
        observed = tuple(inner.observed[i] for i in inner.wanted)
        self.program = inner._replace(kept=(), reductions=(), taken=(), observed=observed, pressures=())
        self.times, self.count, self.precision = made.times, count, precision
        self._data = cast((made.values, tuple(columns)), precision)
        with computing_in(precision):
            start = compiled(implicit_start)(self.program, *self._data, self._number(self.times[0]))
        self.visited = [(self.times[0], start)]

    def graded(self, tolerance: float, stops: np.ndarray, most: int) -> tuple[np.ndarray, Shown]:
        """The boundaries of steps that need no more than an error estimate each, and what lanes did. See `Pilot`."""
        (begin, start), samples = self.visited[0], set(self.times.tolist())
        del self.visited[1:]
        with computing_in(self.precision):
            shown, errors = [self._show(begin, start)], []

            def seen(t, state, error):
                errors.append(error)
                if t in samples:
                    shown.append(self._show(t, state))
                    if len(shown) % max(len(self.times) // LOOKS, 1) == 0:
                        self.visited.append((t, state))

            steps = graded_steps(self._trial, self.times, start, tolerance, knots=stops, max_steps=most, seen=seen)
        return steps.times, self._gathered(shown, errors)

    def through(self, boundaries: np.ndarray) -> Shown:
        """What lanes do in given steps."""
        t, state = self.visited[0]
        samples = set(self.times.tolist())
        with computing_in(self.precision):
            shown, errors = [self._show(t, state)], []
            for end in boundaries[1:]:
                state, error = self._trial(t, end - t, state)
                errors.append(error)
                t = end
                if t in samples:
                    shown.append(self._show(t, state))
        return self._gathered(shown, errors)

    def spectra(self) -> np.ndarray:
        """Eigenvalues of the Jacobians in all states visited."""
        sizes = unravel(self.program.plan, np.ones_like(scales(self.program.plan)))
        sizes = np.concatenate([np.ravel(size) for size in jax.tree.leaves(sizes)])
        with computing_in(self.precision):
            return np.concatenate([self._spectra(t, state, sizes).ravel() for t, state in self.visited])

    def _spectra(self, t, state, sizes) -> np.ndarray:
        leaves, tree = jax.tree.flatten(state)
        shapes = [leaf.shape[:-1] for leaf in leaves]
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
        flat = np.concatenate([np.asarray(leaf).reshape(-1, leaf.shape[-1]) for leaf in leaves])

        def rates(lane: int, states: np.ndarray) -> np.ndarray:
            (values, columns), copies = self._data, states.shape[-1]
            parts = [p.reshape(*s, copies) for p, s in zip(np.split(states, ends), shapes, strict=True)]
            columns = tuple(np.repeat(column[..., lane, None], copies, axis=-1) for column in columns)
            moved = jax.tree.unflatten(tree, parts)
            found = compiled(state_rates)(self.program, values, columns, self._number(t), moved)
            slopes = jax.tree.leaves(found)
            return np.concatenate(
                [
                    np.broadcast_to(np.asarray(slope), (*s, copies)).reshape(-1, copies)
                    for slope, s in zip(slopes, shapes, strict=True)
                ]
            )

        return spectra(rates, flat[:, : self.count], sizes)

    def _trial(self, t, h, state):
        return compiled(implicit_trial)(self.program, *self._data, self._number(t), self._number(h), state)

    def _show(self, t, state):
        return compiled(implicit_outputs)(self.program, *self._data, self._number(t), state)

    def _number(self, x) -> np.ndarray:
        return np.asarray(x, self.precision)

    def _gathered(self, shown: list, errors: list) -> Shown:
        series = np.stack([np.asarray(s) for s in shown])[..., : self.count]
        estimate = np.sum([np.asarray(e) for e in errors], axis=0)[: self.count]
        good = np.isfinite(series).all(axis=(0, 1)) & np.isfinite(estimate)
        return Shown(np.where(good, series, np.nan), estimate)
