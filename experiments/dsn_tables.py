"""Recompute every number of the DSN 70-metre antenna article: Tables 1 and 2, eqs. (13)-(17).

    python experiments/dsn_tables.py --out results/dsn_tables

Each number was printed in SI and in inch-pound units. Ours comes from the inch-pound numbers of Tables 1 and 2
and the equations in `jaxlines.physics.article`; a printed number agrees with ours when some number rounds to
the one and fits the rounding of what the other was computed from. Exits with 1 when a number disagrees,
other than the viscosity, whose misprint is known.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from jaxlines.catalogue import dsn70m
from jaxlines.physics import article
from jaxlines.physics.validity import frequency_of_error, lumped_impedance_error, quarter_wave_frequency

VISCOSITY_NOTE = (
    "misprinted: the metric number is in mm^2/s (27.7 m^2/s would be 42935 in^2/s), and the inch number is "
    "27.7 times 39.37, the factor of a length instead of that of an area; right is 27.7e-6 m^2/s = 0.0429 in^2/s"
)


def entry(name: str, source: str, printed: dsn70m.Printed, ours: float, interval, note: str = "") -> dict:
    """One number of the article against ours [SI], with the interval that the inputs' rounding leaves to ours."""
    factor = dsn70m.FACTORS[printed.inch_pound.unit]
    metric, inch = printed.si.interval(), printed.interval()
    overlap = max(metric[0], inch[0], interval[0]) <= min(metric[1], inch[1], interval[1])
    return {
        "name": name,
        "source": source,
        "article_si": printed.si.text,
        "unit_si": printed.si.unit,
        "article_inch_pound": printed.inch_pound.text,
        "unit_inch_pound": printed.inch_pound.unit,
        "ours_si": ours,
        "ours_inch_pound": ours / factor,
        "difference_si": printed.si.value / ours - 1.0,
        "difference_inch_pound": printed.value / ours - 1.0,
        "agrees": bool(overlap),
        "note": note,
    }


def given_numbers() -> list[dict]:
    """Tables 1 and 2: the two printings against each other; ours is the inch-pound one."""
    tables = {"volume of {}": dsn70m.VOLUMES, "effective modulus of {}": dsn70m.EFFECTIVE_MODULI}
    entries = [
        entry(form.format(line), "Table 1", printed, printed.value, printed.interval())
        for form, table in tables.items()
        for line, printed in table.items()
    ]
    for name, printed in dsn70m.PROPERTIES.items():
        viscosity = name == "fluid_kinematic_viscosity"
        ours = dsn70m.KINEMATIC_VISCOSITY if viscosity else printed.value
        interval = (27.65e-6, 27.75e-6) if viscosity else printed.interval()
        entries.append(entry(name, "Table 2", printed, ours, interval, VISCOSITY_NOTE if viscosity else ""))
    return entries


def computed_numbers() -> list[dict]:
    """Eqs. (13)-(17) from Tables 1 and 2, and the numbers of the text."""
    entries, density = [], dsn70m.OIL.density
    for number, (line, printed) in enumerate(dsn70m.LINE_CONSTANTS.items(), start=13):
        beta, volume = dsn70m.EFFECTIVE_MODULI[line], dsn70m.VOLUMES[line]
        low = article.line_constant(beta.interval()[0], volume.interval()[1])
        high = article.line_constant(beta.interval()[1], volume.interval()[0])
        ours = article.line_constant(beta.value, volume.value)
        entries.append(entry(f"K of {line}", f"eq. ({number})", printed, ours, (low, high)))
    text, modulus = dsn70m.TEXT, dsn70m.EFFECTIVE_MODULI["azimuth_2"]
    speeds = [article.wave_speed(beta, density) for beta in modulus.interval()]
    speed, trip = article.wave_speed(modulus.value, density), dsn70m.PATH_LENGTH
    times = (article.round_trip_time(trip, speeds[1]), article.round_trip_time(trip, speeds[0]))
    period, path, drop = 1.0 / dsn70m.COMMAND_RATE, text["path_length"], text["viscous_drop_limit"]
    return [
        *entries,
        entry("wave speed", "eq. (9)", text["wave_speed"], speed, speeds),
        entry("round trip 2L/c0", "eq. (17)", text["round_trip_time"], article.round_trip_time(trip, speed), times),
        entry("command period 1/f", "eq. (17)", text["command_period"], period, (period, period)),
        entry("longest path", "text", path, path.value, path.interval()),
        entry("limit of viscous drop", "text", drop, drop.value, drop.interval()),
    ]


def derived_numbers() -> dict:
    """What the article uses and does not print: moduli by eqs. (2) and (4), and each line's speed and validity."""
    oil, atmosphere = dsn70m.OIL, dsn70m.OIL.atmospheric_pressure
    parts = {f"{size}-in pipe": dsn70m.pipe(size, 1.0) for size in ("1", "1.5", "2")} | {"hose": dsn70m.hose()}
    containers = {}
    for name, part in parts.items():
        wall = part.container_modulus()
        effective = article.series_modulus(wall, oil.bulk_modulus)
        containers[name] = {
            "container_modulus_Pa": float(wall),
            "effective_modulus_Pa": float(effective),
            "effective_modulus_psi": float(effective / dsn70m.PSI),
            "wave_speed_m_per_s": float(article.wave_speed(effective, oil.density)),
        }
    lines = {}
    for name in dsn70m.VOLUMES:
        line = dsn70m.control_line(name, "A")
        speed = line.wave_speed(oil, atmosphere)
        lines[name] = {
            "line_constant_N_per_m5": float(line.line_constant(oil, atmosphere)),
            "wave_speed_m_per_s": float(speed),
            "round_trip_time_s": float(line.round_trip_time(oil, atmosphere)),
            "eq_11_holds": bool(article.lumped_model_is_valid(line.path_length, speed, dsn70m.COMMAND_RATE)),
            "impedance_error_at_20_Hz": float(lumped_impedance_error(line.path_length, speed, dsn70m.COMMAND_RATE)),
            "frequency_of_1_percent_error_Hz": float(frequency_of_error(line.path_length, speed, 0.01)),
            "frequency_of_10_percent_error_Hz": float(frequency_of_error(line.path_length, speed, 0.10)),
            "first_blocked_resonance_Hz": float(quarter_wave_frequency(line.path_length, speed)),
        }
    return {"containers": containers, "lines": lines}


def reconstructions() -> dict:
    """Compositions that reproduce Table 1. They are reconstructions; the article does not give them."""
    made = {}
    for name, printed in dsn70m.EFFECTIVE_MODULI.items():
        line, volumes = dsn70m.reconstructed_line(name, "A"), dsn70m.reconstruction(name)
        modulus = float(line.effective_bulk_modulus(dsn70m.OIL, dsn70m.OIL.atmospheric_pressure))
        made[name] = {
            "label": "reconstruction, not from the article",
            **{f"{part}_in3": volume / dsn70m.INCH**3 for part, volume in volumes._asdict().items()},
            "effective_modulus_psi": modulus / dsn70m.PSI,
            "difference_from_table_1": modulus / printed.value - 1.0,
        }
    return made


def show(entries: list[dict], console: Console) -> None:
    """The comparison as a table."""
    table = Table(title="Article against recomputation", title_justify="left")
    headings = ("number", "source", "article SI", "ours SI", "difference", "article in-lb", "ours in-lb", "difference")
    for heading in headings:
        table.add_column(heading, justify="left" if heading in ("number", "source") else "right", no_wrap=True)
    table.add_column("agrees")
    for e in entries:
        table.add_row(
            e["name"],
            e["source"],
            f"{e['article_si']} {e['unit_si']}",
            f"{e['ours_si']:.5g}",
            f"{100 * e['difference_si']:+.3g} %",
            f"{e['article_inch_pound']} {e['unit_inch_pound']}",
            f"{e['ours_inch_pound']:.5g}",
            f"{100 * e['difference_inch_pound']:+.3g} %",
            "yes" if e["agrees"] else "NO",
        )
    console.print(table)


def show_derived(derived: dict, made: dict, console: Console) -> None:
    """Moduli, speeds and reconstructions, a line each."""
    for name, c in derived["containers"].items():
        modulus, speed = c["effective_modulus_Pa"], c["wave_speed_m_per_s"]
        console.print(f"{name}: K_c {c['container_modulus_Pa']:.5g} Pa, effective {modulus:.5g} Pa, c0 {speed:.1f} m/s")
    for name, c in derived["lines"].items():
        speed, trip = c["wave_speed_m_per_s"], 1e3 * c["round_trip_time_s"]
        console.print(f"{name}: K {c['line_constant_N_per_m5']:.5g} N/m^5, c0 {speed:.1f} m/s, 2L/c0 {trip:.2f} ms")
    for name, c in made.items():
        volumes = f"hose {c['hose_in3']:.1f}, rigid {c['rigid_in3']:.1f}, 2-in pipe {c['pipe_in3']:.1f} in^3"
        console.print(f"{name}: {volumes} -> {c['effective_modulus_psi']:.0f} psi ({c['label']})")


def finding(entries: list[dict], derived: dict) -> str:
    """The result in one line."""
    wrong = [e["name"] for e in entries if not e["agrees"]]
    errors = [line["impedance_error_at_20_Hz"] for line in derived["lines"].values()]
    limits = [line["frequency_of_10_percent_error_Hz"] for line in derived["lines"].values()]
    return (
        f"{len(entries) - len(wrong)} of {len(entries)} printed numbers agree within rounding; "
        f"in disagreement: {', '.join(wrong) or 'none'}. Eq. (11) holds at 20 Hz, but the input impedance of a lumped "
        f"line is off by {100 * np.min(errors):.0f}..{100 * np.max(errors):.0f} % there, and by less than 10 % only "
        f"up to {np.min(limits):.1f} Hz."
    )


def main() -> int:
    """Compare, print, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/dsn_tables"), help="folder for results.json")
    folder = parser.parse_args().out
    entries, derived, made = given_numbers() + computed_numbers(), derived_numbers(), reconstructions()
    console = Console(width=170, highlight=False, markup=False)
    show(entries, console)
    show_derived(derived, made, console)
    for e in entries:
        if e["note"]:
            console.print(f"{e['name']}: {e['note']}", soft_wrap=True)
    result = {"numbers": entries, **derived, "reconstructions": made, "finding": finding(entries, derived)}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "results.json").write_text(json.dumps(result, indent=1) + "\n")
    console.print(result["finding"], soft_wrap=True)
    wrong = {e["name"] for e in entries if not e["agrees"]}
    return 0 if wrong == {"fluid_kinematic_viscosity"} else 1


if __name__ == "__main__":
    sys.exit(main())
