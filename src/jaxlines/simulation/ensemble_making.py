"""From a circuit, its inputs and what varies to the program of an ensemble, every argument checked."""

from collections.abc import Iterable, Mapping

import numpy as np

from jaxlines.simulation.assembly import compile_circuit, number_locations
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.ensemble import EnsembleProgram
from jaxlines.simulation.ensemble_columns import (
    Varied,
    check_shapes,
    columns_of,
    out_of_range,
    places_of,
    why_out_of_range,
)
from jaxlines.simulation.ensemble_program import LaneProgram, is_small
from jaxlines.simulation.inputs import bind_inputs
from jaxlines.simulation.integration import make_method
from jaxlines.simulation.lane_field import special_numbers
from jaxlines.simulation.lane_times import input_times, step_grid
from jaxlines.simulation.precision import computing_in
from jaxlines.simulation.reductions import AbstractReduction
from jaxlines.simulation.segments import choose_segments
from jaxlines.simulation.simulate import checked_times, wanted_units


def checked_reductions(reductions) -> dict[str, AbstractReduction]:
    """Reductions by name. Raises: TypeError that shows how they are given."""
    how = 'reductions must be by name, such as {"peak": Peak("A.pressure")}'
    if reductions is not None and not isinstance(reductions, Mapping):
        raise TypeError(f"{how}, got {reductions!r}")
    for name, reduction in (reductions or {}).items():
        if not isinstance(reduction, AbstractReduction):
            raise TypeError(f"{how}, got {reduction!r} for {name!r}")
    return dict(reductions or {})


def make_program(
    circuit: Circuit,
    times,
    varied: Varied,
    inputs: dict | None,
    initial: dict | None,
    outputs: Iterable[str] | None,
    reductions: Mapping[str, AbstractReduction] | None,
    tolerance: float,
    precision: str,
    solver,
    max_steps: int,
) -> EnsembleProgram:
    """A program without engine, steps and audit yet; see `prepare_ensemble`."""
    times = np.asarray(checked_times(times))
    if not 1e-12 <= tolerance <= 0.1:
        raise ValueError(f"tolerance must be 1e-12..0.1 (a share of each output's magnitude), got {tolerance:g}")
    if initial is not None and not isinstance(initial, dict):
        raise ValueError(
            f"initial must be a table of start values, got {initial!r}: every lane would have its own steady state; "
            "let the inputs rest for a while before what you are after"
        )
    columns, reductions = columns_of(varied), checked_reductions(reductions)
    with computing_in(precision):
        bound = bind_inputs(circuit, inputs, times)
        circuit = choose_segments(circuit, times, bound, initial=initial)
        plan, values = compile_circuit(circuit, initial, bound)
        places = places_of(varied, number_locations(plan, values))
    check_shapes(values, places, columns)
    if out_of_range(circuit, list(places), columns).all():
        why = why_out_of_range(circuit, list(places), columns)
        raise ValueError(f"no lane has all its varied numbers within their ranges: are they in SI? In lane 0, {why}")
    shown = wanted_units(circuit, plan, [] if outputs is None and reductions else outputs)
    needed = wanted_units(circuit, plan, [name for r in reductions.values() for name in r.outputs])
    pressures = {f"{node}.pressure": "Pa" for node, domain in plan.free_nodes if domain == "hydraulic"}
    units = shown | needed | pressures
    observed = tuple(units)
    taken = tuple(tuple(observed.index(n) for n in wanted_units(circuit, plan, r.outputs)) for r in reductions.values())
    program = LaneProgram(
        plan=plan,
        observed=observed,
        places=tuple(places.values()),
        kept=tuple(observed.index(name) for name in shown),
        reductions=tuple(reductions.values()),
        taken=taken,
        pressures=tuple(observed.index(name) for name in pressures),
        engine="explicit",
        small=is_small(plan, values),
        method=make_method(solver, "forward", max_steps),
        fixed=special_numbers(values, tuple(places.values())) if is_small(plan, values) else (),
    )
    grid = step_grid(times, input_times(values))
    return EnsembleProgram(
        circuit,
        program,
        tuple(places),
        values,
        times,
        grid,
        tuple(reductions),
        units,
        1,
        tolerance,
        precision,
        None,
        {},
    )
