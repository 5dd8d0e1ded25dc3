"""A designed test on disk: design.json, profiles and readings as tables, a study's tables that run it, a report."""

import importlib.metadata
import json
import re
from pathlib import Path

from jaxlines.edge.design_report import design_report
from jaxlines.edge.writing import _csv, _json, make_folder, write_whole
from jaxlines.inference.design_result import Design


def design_result(design: Design, title: str) -> dict:
    """What design.json says of a design; SI units, null for what is not known."""
    profiles = {
        name: {
            "unit": profile.unit,
            "times": profile.times,
            "values": profile.values,
            "base_values": profile.base_values,
            "low": profile.low,
            "high": profile.high,
            "rate": profile.rate,
            "energy": profile.energy,
            "base_energy": profile.base_energy,
            "frequencies": profile.frequencies,
            "amplitudes": profile.amplitudes,
        }
        for name, profile in design.profiles.items()
    }
    choices = {
        what: {"method": found.method, "efficiency": found.efficiency, "counts": found.counts, "weights": found.weights}
        for what, found in design.selections.items()
    }
    return {
        "title": title,
        "finding": design.finding(),
        "target": design.target,
        "criterion": design.criterion,
        "improvement": design.improvement,
        "target_sd_base": design.target_sd_base,
        "target_sd": design.target_sd,
        "target_unit": design.target_unit,
        "parameters": design.table(),
        "profiles": profiles,
        "sensors": design.sensors,
        "times": design.times,
        "limits": [limit._asdict() for limit in design.limits],
        "starting_test_keeps_limits": design.base_keeps_limits,
        "choices": choices,
        "at_limits": design.active,
        "not_told": design.unidentified,
        "warnings": design.warnings,
        "robust": design.robust,
        "scenarios": {name: design.scenarios[:, i] for i, name in enumerate(design.names)},
        "starts": [start._asdict() for start in design.starts],
        "num_simulations": design.num_simulations,
        "seconds": design.seconds,
        "version": importlib.metadata.version("jaxlines"),
    }


def profile_csv(design: Design, name: str) -> str:
    """A designed input as a table: time, designed and starting value, SI."""
    profile = design.profiles[name]
    columns = {"time": profile.times, name: profile.values, f"{name} of the starting test": profile.base_values}
    units = ("s", profile.unit, profile.unit)
    return _csv({f"{key} [{unit}]": values for (key, values), unit in zip(columns.items(), units, strict=True)})


def readings_csv(design: Design) -> str:
    """What the designed test is predicted to show: time, each output, and how often each sensor is read then; SI."""
    columns = {"time [s]": design.candidate_times}
    columns |= {f"{name} [{design.output_units[name]}]": values for name, values in design.outputs.items()}
    columns |= {f"{name} readings": design.measured[:, i] for i, name in enumerate(design.candidate_sensors)}
    return _csv(columns)


def simulate_toml(design: Design, levels: dict[str, bool]) -> str:
    """The tables [simulate] and [simulate.inputs] of a study file that run the designed test.

    Args: levels: input -> whether it is a pressure level, which is written as absolute.
    """
    start, stop = design.candidate_times[0], design.candidate_times[-1]
    others = [name for name in design.inputs if name not in design.profiles]
    lines = ["[simulate]", f'start = "{start:.9g} s"', f'stop = "{stop:.9g} s"']
    lines += [f"samples = {design.candidate_times.size}", "", "[simulate.inputs]"]
    lines += [f"# as before: {', '.join(others)}"] if others else []
    for name, profile in design.profiles.items():
        unit = f"{profile.unit}{'_a' if levels.get(name) else ''}"
        times = ", ".join(f'"{t:.9g} s"' for t in profile.times)
        values = ", ".join(f"{v:.9g}" if unit == "1" else f'"{v:.9g} {unit}"' for v in profile.values)
        how = 'method = "linear", delay = "0 s"'
        lines.append(f"{json.dumps(name)} = {{ sampled = {{ times = [{times}], values = [{values}], {how} }} }}")
    return "\n".join(lines) + "\n"


def write_design(design: Design, title: str, directory, levels: dict[str, bool] | None = None) -> list[Path]:
    """Write a design as design.json, profile-INPUT.csv, readings.csv, simulate.toml and report.html into a folder.

    Args: design; title; directory: made if needed; levels: as for `simulate_toml`.
    Returns: the files; without a designed input neither profiles nor simulate.toml. Raises: OSError where the folder
    cannot be made or written.
    """
    folder = make_folder(directory)
    texts = {"design.json": _json(design_result(design, title))}
    for name in design.profiles:
        texts[f"profile-{re.sub('[^a-zA-Z0-9_.-]', '_', name)}.csv"] = profile_csv(design, name)
    texts |= {"readings.csv": readings_csv(design)}
    if design.profiles:
        texts["simulate.toml"] = simulate_toml(design, levels or {})
    texts["report.html"] = design_report(design, title)
    return [write_whole(folder / name, text) for name, text in texts.items()]
