"""A designed test in the terminal, in units that read well."""

import numpy as np
from rich.markup import escape

from jaxlines.edge.display import readable, readable_text, readable_unit
from jaxlines.edge.showing import plain_console, plain_table, show_sentences
from jaxlines.inference.design_result import Design


def _number(value: float, unit: str, size: float) -> str:
    """A number in the unit that fits a size; "unknown" where it is infinite."""
    return f"{value * readable_unit(unit, size)[1]:.4g}" if np.isfinite(value) else "unknown"


def show_design(design: Design, title: str) -> None:
    """Standard deviations before, after the starting and after the designed test; what was chosen, what holds it."""
    console = plain_console()
    console.print(f"[bold]{escape(title)}[/bold]")
    found = escape(readable_text(design.finding()))
    console.print(f"{found} ({design.seconds:.1f} s, {design.num_simulations} simulations)\n", soft_wrap=True)
    table = plain_table("number", "value", "sd known before", "starting test", "designed test", "ratio", "unit")
    for row in design.table():
        unit, size = row["unit"], abs(row["value"])
        cells = [_number(row[key], unit, size) for key in ("value", "sd_before", "sd_base", "sd")]
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.3g}"
        table.add_row(escape(row["name"]), *cells, ratio, readable_unit(unit, size)[0])
    console.print(table)
    show_sentences(console, "chosen", _choices(design))
    show_sentences(console, "at its limits", design.active)
    show_sentences(console, "not told by the designed test", design.unidentified)
    show_sentences(console, "warnings", design.warnings)


def _choices(design: Design) -> list[str]:
    """What was chosen, in words."""
    found = []
    for name, profile in design.profiles.items():
        ends = readable(profile.unit, float(profile.values.min()), float(profile.values.max()))
        found.append(f"{name}: {profile.times.size} points, {ends}")
    count, every = design.times.size, design.candidate_times.size
    found.append(f"measure {', '.join(design.sensors)} at {count} of {every} instants")
    for what, choice in design.selections.items():
        found.append(f"{what}: {choice.method}, efficiency {choice.efficiency:.4g}")
    return found
