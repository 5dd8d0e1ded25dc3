"""Results on disk: result.json, traces.csv, budget.csv and report.html, each written whole or not at all."""

import dataclasses
import importlib.metadata
import io
import json
import math
import os
import uuid
from pathlib import Path

import numpy as np

from jaxlines.edge.fit_files import budget_table, identifiability_table, posterior_summary, posterior_table
from jaxlines.edge.report import fit_report
from jaxlines.inference.fit_result import Fit
from jaxlines.inference.identifiability import Identifiability
from jaxlines.inference.posterior import Posterior
from jaxlines.inference.uncertainty import Estimate
from jaxlines.simulation.result import MESSAGES, Simulation
from jaxlines.simulation.validity import Validity


def plain(value):
    """Numbers, texts, lists and dictionaries that strict JSON can hold; what is not finite becomes null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def write_whole(path: Path, text: str) -> Path:
    """Write a file so that a reader sees the old one or the new one, never a part. Raises OSError."""
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
    try:
        with open(temporary, "x", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def _json(content: dict) -> str:
    """Strict JSON, readable."""
    return json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _csv(columns: dict[str, np.ndarray]) -> str:
    """A table as CSV, nine digits, empty where a number is missing."""
    import pandas

    buffer = io.StringIO()
    series = {name: pandas.Series(values) for name, values in columns.items()}  # of different lengths
    pandas.DataFrame(series).to_csv(buffer, index=False, float_format="%.9g", lineterminator="\n")
    return buffer.getvalue()


def _unit_suffix(unit: str) -> str:
    """ " [Pa]"; a plain number has the unit 1."""
    return f" [{unit}]"


def _estimates(estimates: dict[str, Estimate]) -> dict:
    """Estimates by name as plain dictionaries."""
    return {name: estimate._asdict() for name, estimate in estimates.items()}


def _validity(validity: Validity | None) -> dict | None:
    return None if validity is None else validity.to_dict()


def _noise_model(fit: Fit) -> dict | None:
    """The noise that the intervals assume, and how sure it leaves each parameter."""
    if fit.analysis is None:
        return None
    noise = fit.analysis.noise
    return {
        "method": noise.method,
        "sentence": noise.sentence,
        "whiteness_p": noise.whiteness_p,
        "autoregressive": [{"coefficients": m.coefficients, "sd_of_weighted_residuals": m.sd} for m in noise.models],
        "degrees_of_freedom": dict(zip(fit.parameters, fit.analysis.freedom, strict=True)),
    }


def _starts(fit: Fit) -> list[dict]:
    """Where each search began and ended, best first; SI."""
    names = list(fit.parameters)
    rows = []
    for start in fit.starts:
        ends = {"start": start.start, "end": start.end}
        row = start._asdict() | {key: dict(zip(names, values, strict=False)) for key, values in ends.items()}
        rows.append(row)
    return rows


def fit_result(fit: Fit, title: str) -> dict:
    """What result.json says of a fit; SI units."""
    return {
        "title": title,
        "status": fit.status,
        "message": fit.message,
        "parameters": _estimates(fit.parameters),
        "derived": _estimates(fit.derived),
        "rmse": {name: channel.rmse for name, channel in fit.channels.items()},
        "noise": {name: channel.sigma for name, channel in fit.channels.items()},
        "noise_given": {name: dataclasses.asdict(noise) for name, noise in fit.noise.items()},
        "whiteness": {name: {"p": c.whiteness_p, "white": c.white} for name, c in fit.channels.items()},
        "intervals": _noise_model(fit),
        "scatter_between_recordings": {name: between._asdict() for name, between in fit.scatter.items()},
        "log_likelihood": fit.log_likelihood,
        "starts": _starts(fit),
        "correlations": {"names": list(fit.parameters), "matrix": fit.correlations},
        "identifiability": fit.identifiability,
        "scale": fit.scale,
        "singular_values": fit.singular_values,
        "validity": _validity(fit.validity),
        "initial": fit.initial,
        "warnings": fit.warnings,
        "num_evaluations": fit.num_evaluations,
        "seconds": fit.seconds,
        "version": importlib.metadata.version("jaxlines"),
    }


def _fit_traces(fit: Fit) -> dict[str, np.ndarray]:
    """Time, and measured and simulated values of every channel; measured is empty where it was not used."""
    columns: dict[str, np.ndarray] = {}
    for name, channel in fit.channels.items():
        run = f" [{name.partition(' [')[2]}" if len(fit.runs) > 1 else ""  # each recording has times of its own
        columns.setdefault(f"time{run} [s]", channel.times)
        columns[f"{name} measured{_unit_suffix(channel.unit)}"] = np.where(channel.used, channel.measured, np.nan)
        columns[f"{name} simulated{_unit_suffix(channel.unit)}"] = channel.simulated
    return columns


def make_folder(directory) -> Path:
    """The folder of the results, made if needed. Raises OSError when it cannot be written."""
    folder = Path(directory)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "is a file" if folder.is_file() else error.strerror
        raise OSError(f"{folder}: no folder can be made there ({reason}): choose another with --out") from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(f"{folder}: the folder cannot be written: choose another with --out")
    return folder


def _title(study) -> str:
    """The title of a study, or the title itself."""
    return study if isinstance(study, str) else study.title


def write_fit(
    fit: Fit,
    study,
    directory,
    *,
    classes: dict[str, Identifiability] | None = None,
    posterior: Posterior | None = None,
) -> list[Path]:
    """Write a fit as result.json, traces.csv, budget.csv and report.html into a folder.

    Args: fit; study: the `Study` or a title; directory: made if needed; classes: of `Fit.assess`, to
    identifiability.csv; posterior: of `Fit.posterior`, its draws to posterior.csv; both to the report as well.
    Returns: the files. A failed fit has neither traces nor budgets. Raises: OSError when the folder cannot be written.
    """
    folder, title = make_folder(directory), _title(study)
    content = fit_result(fit, title)
    if classes is not None:
        content["classes"] = {name: {"class": c.kind, "why": c.sentence} for name, c in classes.items()}
    if posterior is not None:
        content["posterior"] = posterior_summary(fit, posterior)
    files = [write_whole(folder / "result.json", _json(content))]
    if fit.channels:
        files.append(write_whole(folder / "traces.csv", _csv(_fit_traces(fit))))
    if fit.analysis is not None and (budgets := budget_table(fit)):
        files.append(write_whole(folder / "budget.csv", budgets))
    if classes is not None:
        files.append(write_whole(folder / "identifiability.csv", identifiability_table(classes)))
    if posterior is not None:
        files.append(write_whole(folder / "posterior.csv", posterior_table(fit, posterior)))
    return [*files, write_whole(folder / "report.html", fit_report(fit, title, classes, posterior))]


def write_simulation(simulation: Simulation, study, directory, outputs=()) -> list[Path]:
    """Write a simulation as result.json and traces.csv into a folder.

    Args: simulation; study: the `Study` or a title; directory: made if needed; outputs: which (default: all).
    Returns: the files. Raises: OSError when the folder cannot be written.
    """
    folder, names = make_folder(directory), list(outputs) or list(simulation.outputs)
    series = {name: np.asarray(simulation[name]) for name in names}
    content = {
        "title": _title(study),
        "status": simulation.status,
        "message": MESSAGES[simulation.status],
        "outputs": {
            name: {"unit": simulation.units[name], "min": values.min(), "max": values.max(), "last": values[-1]}
            for name, values in series.items()
        },
        "validity": _validity(simulation.validity()),
        "num_steps": simulation.num_steps,
        "num_rejected": simulation.num_rejected,
        "version": importlib.metadata.version("jaxlines"),
    }
    columns = {"time [s]": np.asarray(simulation.times)}
    columns |= {f"{name}{_unit_suffix(simulation.units[name])}": values for name, values in series.items()}
    return [
        write_whole(folder / "result.json", _json(content)),
        write_whole(folder / "traces.csv", _csv(columns)),
    ]
