"""From the search of a test to its `Design`: predicted standard deviations, limits reached, what is not told."""

import time

import numpy as np

from jaxlines.inference.design_before import Before
from jaxlines.inference.design_criteria import stated_covariance
from jaxlines.inference.design_inputs import Multisine
from jaxlines.inference.design_model import DesignModel, Outcome
from jaxlines.inference.design_result import Design, Profile
from jaxlines.inference.design_search import Best, Search, Start, Trial
from jaxlines.inference.design_target import Target, untold
from jaxlines.inference.parameter_checks import number_metadata
from jaxlines.physics.fields import driven_of

NEAR = 1e-4
"""Closer than this part of its range to a limit counts as at it."""


def _stated(search: Search, outcome: Outcome, mask, before: Before) -> np.ndarray:
    """Covariance in scaled coordinates that a fit will state."""
    return stated_covariance(before.with_rows(outcome.rows[mask]), len(search.model.free))


def _profiles(model: DesignModel, coefficients, base) -> dict[str, Profile]:
    """The designed inputs."""
    found, places = {}, model.circuit.external_inputs()
    for excitation, own, first in zip(model.excitations, model.split(coefficients), model.split(base), strict=True):
        component, field = places[excitation.input][0]
        sines = isinstance(excitation, Multisine)
        found[excitation.input] = Profile(
            excitation.grid,
            excitation.values(own),
            excitation.values(first),
            excitation.low,
            excitation.high,
            excitation.rate,
            excitation.energy_of(own),
            excitation.energy_of(first),
            driven_of(model.circuit.components[component])[field]["unit"],
            excitation.frequencies if sines else None,
            excitation.amplitudes(own) if sines else None,
        )
    return found


def _active(search: Search, trial: Trial, coefficients) -> tuple[str, ...]:
    """Limits of inputs and outputs that are reached, in words."""
    model, found = search.model, []
    for excitation, own in zip(model.excitations, model.split(coefficients), strict=True):
        values, room = excitation.values(own), NEAR * (excitation.high - excitation.low)
        at = np.sum(values <= excitation.low + room), np.sum(values >= excitation.high - room)
        if any(at):
            found.append(f"level of {excitation.input}: {at[0]} of {values.size} points lowest, {at[1]} highest")
        if excitation.rate is not None:
            slopes = np.abs(np.diff(values) / np.diff(excitation.grid))
            steep = int(np.sum(slopes >= excitation.rate * (1.0 - NEAR)))
            found += [f"rate of {excitation.input}: {steep} of {slopes.size} pieces"] if steep else []
        if excitation.energy is not None and excitation.energy_of(own) >= (1.0 - NEAR) * excitation.energy:
            found.append(f"energy of {excitation.input}")
    for limit in search.limits:
        column = model.outputs.index(limit.name)
        for number, outcome in enumerate(trial.outcomes):
            shown = outcome.outputs[:, column]
            whose = "" if number == 0 else f" in parameter sample {number}"
            for end, at, word in ((limit.low, shown.argmin(), "lowest"), (limit.high, shown.argmax(), "highest")):
                if np.isfinite(end) and abs(shown[at] - end) <= 1e-3 * limit.range:
                    level = f"{end:.6g} {model.units[limit.name]}".removesuffix(" 1")
                    found.append(f"{limit.name} at its {word}, {level}, at {model.times[at]:.4g} s{whose}")
    return tuple(found)


def _unidentified(search: Search, outcome: Outcome, covariance, before: Before) -> tuple[str, ...]:
    """What the designed test leaves open: combinations it says nothing of, and parameters it hardly narrows."""
    model, found, open_ones = search.model, [], set()
    names, size = [f.label for f in model.free], len(model.free)
    lost, tied = untold(search.outcome_rows(outcome), size, before.rows, np.eye(size))
    if lost:
        open_ones = {names[i] for i in tied}
        words = "of " + names[tied[0]] if len(tied) == 1 else "that sets apart " + ", ".join(names[i] for i in tied)
        found.append(f"the test says nothing {words}")
    for i, name in enumerate(names):
        if name in open_ones:
            continue
        sd, known = np.sqrt(covariance[i, i]), before.sizes[i]
        if sd > 0.5:
            found.append(f"{name}: its standard deviation is {sd:.2g} of the width of its bounds")
        elif before.rows.size and sd > 0.95 * known:
            found.append(f"{name}: the test adds next to nothing to what is known before")
    return tuple(found)


def make_result(
    search: Search,
    asked: Target,
    before: Before,
    base: tuple[np.ndarray, np.ndarray],
    best: Best,
    counts,
    selections: dict,
    table: list[Start],
    began: float,
) -> Design:
    """Put the result together; base: (mask, coefficients) of the starting test."""
    model, trial = search.model, best.trial
    assert trial is not None
    base_mask, base_coefficients = base
    first = search.trial(base_coefficients)
    nominal = search.scenarios[0]
    step = model.slopes(nominal) * model.scale
    covariances = [
        _stated(search, outcome, mask, before)
        for outcome, mask in ((first.outcomes[0], base_mask), (trial.outcomes[0], search.mask))
    ]
    sd_base, sd = (np.sqrt(np.diag(c)) * step for c in covariances)
    base_information = np.stack([r.T @ r for r in (o.rows[base_mask] for o in first.outcomes)])
    single = search.goal.criteria[0].directions if search.goal.criteria[0].directions.shape[1] == 1 else None
    asked_sd = [None, None] if single is None else [_along(single[:, 0], c) for c in covariances]
    improvement = float(np.exp(search.goal.value(base_information) - trial.goal))
    single_sd = [sd for sd in asked_sd if sd is not None and np.isfinite(sd)]
    if search.goal.how == "nominal" and len(single_sd) == 2:
        improvement = single_sd[0] / single_sd[1]  # the goal counts the bounds as if they told a little
    keeps = bool(np.all(first.room >= -1e-6))
    warnings = [] if keeps else ["the starting test does not keep the limits of outputs"]
    if table and not any(start.kept for start in table):
        warnings.append("no search ended within the limits: the best point on the way is given")
    order = search.model.outputs
    return Design(
        names=tuple(f.label for f in model.free),
        units=tuple(number_metadata(model.circuit, f.paths[0]).get("unit", "") for f in model.free),
        values=nominal,
        sd_before=np.sqrt(np.diag(before.covariance)) * step,
        sd_base=sd_base,
        sd=sd,
        target=str(asked),
        criterion=asked.kind,
        target_sd_base=asked_sd[0],
        target_sd=asked_sd[1],
        target_unit=asked.unit(model),
        improvement=improvement,
        profiles=_profiles(model, best.coefficients, base_coefficients) if model.excitations else {},
        inputs=model.drive(best.coefficients),
        base_inputs=model.drive(base_coefficients),
        sensors=tuple(name for name, used in zip(model.sensors, counts.any(axis=0), strict=True) if used),
        times=model.times[counts.any(axis=1)],
        candidate_sensors=model.sensors,
        candidate_times=model.times,
        measured=counts,
        outputs={name: trial.outcomes[0].outputs[:, i] for i, name in enumerate(order)},
        base_outputs={name: first.outcomes[0].outputs[:, i] for i, name in enumerate(order)},
        output_units={name: model.units[name] for name in order},
        limits=search.limits,
        base_keeps_limits=keeps,
        selections=selections,
        active=_active(search, trial, best.coefficients) if model.excitations else (),
        unidentified=_unidentified(search, trial.outcomes[0], covariances[1], before),
        warnings=tuple(warnings),
        scenarios=search.scenarios,
        robust=search.goal.how,
        starts=tuple(table),
        num_simulations=search.count,
        seconds=time.perf_counter() - began,
    )


def _along(direction, covariance) -> float:
    """Standard deviation along a direction; infinite where the test does not tell it."""
    part = np.abs(direction) > 0.0
    inner = covariance[np.ix_(part, part)]
    return float(np.sqrt(direction[part] @ inner @ direction[part])) if np.all(np.isfinite(inner)) else float("inf")
