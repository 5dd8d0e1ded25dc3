"""What the commands print: progress while they work, tables when they are done."""

import contextlib
import sys

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from jaxlines.edge.display import estimate_row, readable, readable_text, readable_unit
from jaxlines.edge.naming import path_metadata
from jaxlines.edge.study import Study
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.identifiability import Identifiability
from jaxlines.inference.parameters import Free
from jaxlines.inference.posterior import Posterior
from jaxlines.inference.uncertainty import whiteness_text
from jaxlines.simulation.result import Simulation

MOST_CORRELATED = 10
"""Parameters up to which their correlations are printed; the report has all."""


@contextlib.contextmanager
def progress(quiet: bool):
    """A function of (text, fraction done): a bar on a terminal, lines elsewhere, nothing when quiet."""
    if quiet:
        yield lambda text, fraction: None
    elif not sys.stderr.isatty():
        yield _line_by_line()
    else:
        columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task("", total=1.0)
            yield lambda text, fraction: bar.update(task, description=escape(text), completed=fraction)


def _line_by_line():
    """Lines on stderr, one for each kind of step."""
    last = ""

    def say(text: str, fraction: float) -> None:
        nonlocal last
        step = text.split(",")[0]
        if step != last:
            print(f"{100 * fraction:3.0f} % {step}", file=sys.stderr, flush=True)
        last = step

    return say


def plain_console() -> Console:
    """The standard output; wide where it is no terminal, so that lines are not broken."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else 160)


def plain_table(*columns: str) -> Table:
    """A plain table whose first column is left-aligned."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if 0 < i < len(columns) - 1 else "left", overflow="fold")
    return table


def show_sentences(console: Console, heading: str, sentences) -> None:
    """A heading and its sentences; nothing without any."""
    if sentences:
        console.print(f"\n[bold]{heading}[/bold]")
        for sentence in sentences:
            console.print(f"  - {escape(readable_text(sentence))}", soft_wrap=not console.is_terminal)


def show_fit(
    fit: Fit,
    title: str,
    classes: dict[str, Identifiability] | None = None,
    posterior: Posterior | None = None,
) -> None:
    """A fit: status, estimates, channels, and everything a reader must know about them.

    classes, posterior: of `Fit.assess` and `Fit.posterior`, where they were asked for.
    """
    console = plain_console()
    colour = {"converged": "green", "failed": "red"}.get(fit.status, "yellow")
    console.print(f"[bold]{escape(title)}[/bold]")
    console.print(f"[{colour}]{fit.status}[/{colour}]: {escape(readable_text(fit.message))} ({fit.seconds:.1f} s)\n")
    table = plain_table("number", "estimate", "sd", "95 % interval", "unit")
    for name, estimate in (fit.parameters | fit.derived).items():
        row = estimate_row(estimate)
        table.add_row(escape(name), row.value, row.sd, row.interval, row.unit)
    if table.row_count:
        console.print(table)
    notes = [f"{name}: {e.note}" for name, e in (fit.parameters | fit.derived).items() if e.note]
    show_sentences(console, "notes", notes)
    channels = [
        f"{name}: rmse {readable(channel.unit, channel.rmse)}, noise {readable(channel.unit, channel.sigma)}, "
        f"residuals {whiteness_text(channel.whiteness_p)}"
        for name, channel in fit.channels.items()
    ]
    show_sentences(console, "channels", channels)
    show_sentences(console, "intervals", [fit.intervals] if fit.intervals else [])
    if 1 < len(fit.parameters) <= MOST_CORRELATED:
        console.print("\n[bold]correlations[/bold]", _correlations(fit), sep="\n")
    show_sentences(console, "scatter between recordings", [own.sentence(name) for name, own in fit.scatter.items()])
    show_sentences(console, "searches", _searches(fit))
    show_sentences(console, "identifiability", [f"{n}: {c.kind}: {c.sentence}" for n, c in (classes or {}).items()])
    if posterior is not None:
        show_sentences(console, "posterior", _posterior(fit, posterior))
    show_sentences(console, "cannot be told apart", fit.identifiability)
    show_sentences(console, "rests on", fit.scale)
    show_sentences(console, "validity of the lumped model", fit.validity.sentences() if fit.validity else ())
    show_sentences(console, "warnings", fit.warnings)


def _correlations(fit: Fit) -> Table:
    """The lower half of the correlation matrix, columns in the order of the rows."""
    names = list(fit.parameters)
    table = plain_table("  number", *(str(i + 1) for i in range(len(names) - 1)), "")
    for i, name in enumerate(names):
        cells = [f"{value:+.2f}" if np.isfinite(value) else "-" for value in fit.correlations[i, :i]]
        table.add_row(f"  {i + 1} {escape(name)}", *cells)
    return table


def _searches(fit: Fit) -> list[str]:
    """How many of several searches ended at the best optimum."""
    if len(fit.starts) < 2:
        return []
    best = min(start.cost for start in fit.starts)
    same = sum(start.cost - best < 0.01 * max(abs(best), 1.0) for start in fit.starts)
    return [f"{same} of {len(fit.starts)} ended within 1 % of the best cost, {best:.5g}"]


def _posterior(fit: Fit, drawn: Posterior) -> list[str]:
    """Median and 95 % interval of each parameter, and what speaks against the draws."""
    from jaxlines.edge.fit_files import posterior_summary

    found = []
    for name, own in posterior_summary(fit, drawn)["parameters"].items():
        unit = fit.parameters[name].unit
        found.append(f"{name}: median {readable(unit, own['median'])}, 95 % {readable(unit, *own['ci95'])}")
    return [*found, *drawn.warnings]


def _statistics(series: dict[str, tuple[np.ndarray, str]]) -> Table:
    """Smallest, mean and largest value of each series, in readable units; the mean of the values, not over time."""
    table = plain_table("channel", "min", "mean", "max", "unit")
    for name, (values, unit) in series.items():
        finite = values[np.isfinite(values)]
        label, factor = readable_unit(unit, float(np.abs(finite).max()) if finite.size else 0.0)
        numbers = (finite.min(), finite.mean(), finite.max()) if finite.size else ()
        table.add_row(escape(name), *(f"{x * factor:.5g}" for x in numbers), label)
    return table


def show_simulation(simulation: Simulation, title: str, outputs) -> None:
    """A simulation: outputs, steps, validity."""
    console, names = plain_console(), list(outputs) or list(simulation.outputs)
    console.print(f"[bold]{escape(title)}[/bold]")
    times = np.asarray(simulation.times)
    steps = f"{int(simulation.num_steps)} steps"
    console.print(f"{simulation.status}: {times[0]:g} s to {times[-1]:g} s, {times.size} samples, {steps}\n")
    console.print(_statistics({n: (np.asarray(simulation[n]), simulation.units[n]) for n in names}))
    show_sentences(console, "validity of the lumped model", simulation.validity().sentences())


def show_study(study: Study, simulation: Simulation) -> None:
    """What a study contains: circuit, recording, what is free and known, what looks odd."""
    console = plain_console()
    console.print(f"[bold]{escape(study.title)}[/bold]  ({escape(study.source)})\n")
    parts = study.circuit.components
    kinds = ", ".join(f"{name} ({type(part).__name__})" for name, part in parts.items())
    console.print(f"circuit: {escape(kinds)}")
    console.print(f"nodes: {escape(', '.join(study.circuit.nodes()))}")
    console.print(f"inputs: {escape(', '.join(study.names.inputs)) or 'none'}\n")
    if study.recording is not None:
        times, channels = study.recording.times, study.recording.channels
        span = f"{times[0]:g} s to {times[-1]:g} s, step {np.median(np.diff(times)):.4g} s"
        console.print(f"recording {escape(study.recording.name)}: {times.size} samples, {span}")
        known = {**study.names.outputs, **study.names.inputs}
        console.print(_statistics({name: (values, known[name]["unit"]) for name, values in channels.items()}))
        show_sentences(console, "warnings", study.recording.warnings)
        show_sentences(console, "distance from the recording before any fit", _distances(study, simulation))
    show_sentences(console, "free", [_described(study, parameter) for parameter in study.free])
    known = [f"{k.path}: standard uncertainty {readable(_unit(study, k.path), k.sd)}" for k in study.known]
    show_sentences(console, "known", known)
    console.print()


def _unit(study: Study, path: str) -> str:
    """The SI unit of a number of the circuit."""
    return path_metadata(study.circuit, study.names, path, path)["unit"]


def _described(study: Study, parameter: Free) -> str:
    """A free parameter in one line: bounds, transform, start."""
    unit = _unit(study, parameter.paths[0])
    start = float(parameter.to_value(parameter.start_coordinate()))
    bounds = readable(unit, *parameter.bounds)
    return f"{parameter.label}: {bounds}, {parameter.transform}, search from {readable(unit, start)}"


def _distances(study: Study, simulation: Simulation) -> list[str]:
    """Root mean square of measured minus simulated, channel by channel."""
    found = []
    assert study.recording is not None
    for name, values in study.recording.channels.items():
        if name in simulation.outputs and np.array_equal(simulation.times, study.recording.times):
            rmse = float(np.sqrt(np.nanmean((values - np.asarray(simulation[name])) ** 2)))
            found.append(f"{name}: {readable(simulation.units[name], rmse)}")
    return found
