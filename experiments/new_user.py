"""Plays a new user: a clean environment, installation, `new`, `check`, `fit`, `sweep`, the reports; each step timed.

The recording is one that the templates have not seen: a dead-ended line computed here by its closed form (constant
modulus, rigid walls, laminar leak), with noise, in a German logger's file: semicolons, decimal commas, a row of
units, time stamps, and headings of its own. The user corrects one guess, the volume, which no recording tells. The
reports are opened in Chromium where there is one (chromium, chromium-browser or google-chrome on the path); where there
is none, results.json and the finding say so.

    python experiments/new_user.py --out out/new_user [--from RECORDING] [--keep-environment FOLDER]
"""

import argparse
import datetime
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
MODULUS, VOLUME, LEAK = 1.25e9, 2.4e-3, 4e-13
NOISE, LIMIT = 2e4, 900.0
"""Noise of the pressure [Pa], and the seconds that the whole may take."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def recorded_pressure(times: np.ndarray, flow_amplitude: float) -> tuple[np.ndarray, np.ndarray]:
    """Gauge pressure [Pa] and flow [m^3/s] of V dp/dt = K (q - G p) with q = a sin^2(w t), exactly.

    With q = a (1 - cos 2wt)/2 and k = K G/V, p is a sum of a constant, two harmonics and a decay exp(-k t).
    """
    rate, omega = MODULUS * LEAK / VOLUME, 2.0 * 0.4
    gain = 0.5 * flow_amplitude * MODULUS / VOLUME
    harmonic = (rate * np.cos(omega * times) + omega * np.sin(omega * times)) / (rate**2 + omega**2)
    pressure = gain * (1.0 / rate - harmonic)
    decay = (5e5 - pressure[0]) * np.exp(-rate * times)
    return pressure + decay, 0.5 * flow_amplitude * (1.0 - np.cos(omega * times))


def write_recording(path: Path) -> None:
    """The recording of a logger that writes German."""
    times = np.arange(1000) * 0.01
    pressure, flow = recorded_pressure(times, 4e-6)
    pressure = pressure + NOISE * np.random.default_rng(20).standard_normal(times.size)
    start = datetime.datetime(2026, 3, 4, 14, 59, 56)
    lines = ["Messung 17;;", "Zeit;Leitungsdruck;Zulauf", "hh:mm:ss.fff;bar;l/min"]
    for t, p, q in zip(times, pressure, flow, strict=True):
        stamp = (start + datetime.timedelta(seconds=float(t))).strftime("%d.%m.%Y %H:%M:%S.%f")
        lines.append(f"{stamp};{p / 1e5:.4f};{q * 6e4:.6f}".replace(".", ",", 0))
    body = "\n".join(lines[:3] + [re.sub(r"(?<=;)(-?\d+)\.(\d+)", r"\1,\2", line) for line in lines[3:]])
    path.write_text(body + "\n", encoding="cp1252")


class Session:
    """Commands of the user in one folder. Fields: folder; steps: name -> seconds; errors: stderr of the last one."""

    def __init__(self, folder: Path):
        self.folder, self.steps, self.errors = folder, {}, ""

    def run(self, name: str, *command: str) -> str:
        """Run a command, keep its time, and return what it printed. Raises RuntimeError with its output on failure."""
        began = time.perf_counter()
        environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
        environment["XDG_CACHE_HOME"] = str(self.folder / "cache")  # a new user has no compiled programs
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, check=False, env=environment)
        self.steps[name], self.errors = time.perf_counter() - began, done.stderr
        if done.returncode != 0:
            raise RuntimeError(f"{name}: {' '.join(command)}: {done.stdout[-800:]}{done.stderr[-1500:]}")
        return done.stdout


class Addresses(HTMLParser):
    """What a page would load from elsewhere. Field: outside."""

    def __init__(self, page: str):
        HTMLParser.__init__(self)
        self.outside: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        values = [value for name, value in attrs if name in ("src", "href", "xlink:href", "action") and value]
        self.outside += [value for value in values if not value.startswith(("#", "data:"))]


def open_report(session: Session, name: str, report: Path) -> dict:
    """What came of opening a report in a browser without a window.

    Returns: opened: whether there is a browser; plots: how many are drawn; errors: what the console said; bytes, and
    loads_from_outside, of the file.
    """
    text = report.read_text(encoding="utf-8")
    found = {"bytes": len(text.encode()), "loads_from_outside": Addresses(text).outside}
    browser = next((path for path in map(shutil.which, BROWSERS) if path), None)
    if browser is None:
        return {**found, "opened": False, "why_not": f"none of {', '.join(BROWSERS)} is installed"}
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=10000", "--enable-logging=stderr"]
    drawn = session.run(name, browser, *flags, "--dump-dom", report.resolve().as_uri())
    plots = re.search(r'<html[^>]* data-plots="(\d+)"', drawn)
    errors = re.findall(r"CONSOLE.*?(?:error|refused|violates).*", session.errors, flags=re.IGNORECASE)
    return {**found, "opened": True, "plots": int(plots[1]) if plots else 0, "errors": errors}


def correct_volume(study: Path) -> None:
    """What the user knows: a rigid vessel of a measured volume instead of the guessed pipe."""
    text = study.read_text(encoding="utf-8")
    guess = next(line for line in text.splitlines() if line.startswith("parts = "))
    text = text.replace(guess, f'parts = [{{ type = "Vessel", volume = "{VOLUME * 1e3} L" }}]')
    study.write_text(text, encoding="utf-8")


def play(session: Session, environment: Path, recording: Path, known: bool) -> dict:
    """The user's way, and what came out. `known`: whether the truth behind the recording is."""
    python = environment / "bin" / "python"
    if not python.exists():
        session.run("environment", sys.executable, "-m", "venv", str(environment))
        session.run("install", str(python), "-m", "pip", "install", "-q", str(ROOT))
    command = str(environment / "bin" / "jaxlines")
    session.run("help", command, "--help")
    proposal = session.run("new", command, "new", "study.toml", "--from", str(recording))
    if known:
        correct_volume(session.folder / "study.toml")
    checked = session.run("check", command, "check", "study.toml", "--quiet")
    session.run("fit", command, "fit", "study.toml", "--quiet", "--out", "fit")
    session.run("fit again", command, "fit", "study.toml", "--quiet", "--out", "fit")
    result = json.loads((session.folder / "fit" / "result.json").read_text(encoding="utf-8"))
    parameters = {name: entry["value"] for name, entry in (result["parameters"] | result["derived"]).items()}
    session.run("sweep", command, "sweep", "study.toml", "--quiet", "--out", "sweep")
    (swept,) = (session.folder / "sweep").rglob("summary.json")
    summary = json.loads(swept.read_text(encoding="utf-8"))
    return {
        "proposal": proposal.splitlines(),
        "checked": "identifiability" in checked,
        "status": result["status"],
        "parameters": parameters,
        "sweep": {"lanes": summary["count"], "failed": summary["failed"], "reductions": list(summary["reductions"])},
        "reports": {
            "fit": open_report(session, "open fit", session.folder / "fit" / "report.html"),
            "sweep": open_report(session, "open sweep", swept.with_name("report.html")),
        },
    }


def judge(found: dict, seconds: float, known: bool) -> list[str]:
    """What was missed."""
    missed = [] if found["status"] != "failed" else ["the fit failed"]
    failed, lanes = sum(found["sweep"]["failed"].values()), found["sweep"]["lanes"]
    missed += [f"{failed} of {lanes} runs of the sweep failed"] * (lanes == 0 or failed > 0.1 * lanes)
    for name, report in found["reports"].items():
        missed += [f"the report of the {name} loads {report['loads_from_outside']}"] * bool(
            report["loads_from_outside"]
        )
        missed += [f"the report of the {name} is larger than 5 MB"] * (report["bytes"] > 5e6)
        if report["opened"]:
            missed += [f"the report of the {name} shows no plot"] * (report["plots"] == 0)
            missed += [f"the report of the {name}: {error}" for error in report["errors"][:1]]
    missed += [f"it took {seconds:.0f} s"] * (seconds > LIMIT)
    if known:
        modulus = found["parameters"]["line.effective_bulk_modulus"]
        leak = found["parameters"]["leak.conductance"]
        missed += [f"effective modulus {modulus:.4g} Pa, not {MODULUS:.4g}"] * (abs(modulus / MODULUS - 1.0) > 0.02)
        missed += [f"leak {leak:.3g}, not {LEAK:.3g}"] * (abs(leak / LEAK - 1.0) > 0.1)
    return missed


def main() -> int:
    """Play, write results.json, and print the finding."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--from", dest="recording", type=Path, help="another recording, whose truth is not known")
    parser.add_argument("--keep-environment", type=Path, help="folder of the environment, used again if it is there")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        recording, known = options.recording, options.recording is None
        if recording is None:
            recording = folder / "Messung_17.csv"
            write_recording(recording)
        session = Session(folder)
        environment = (options.keep_environment or folder / "venv").resolve()
        found = play(session, environment, recording.resolve(), known)
        (options.out / "study.toml").write_text((folder / "study.toml").read_text(encoding="utf-8"), encoding="utf-8")
        (options.out / "report.html").write_bytes((folder / "fit" / "report.html").read_bytes())
        (sweep_page,) = (folder / "sweep").rglob("report.html")
        (options.out / "sweep_report.html").write_bytes(sweep_page.read_bytes())
    seconds = sum(session.steps.values())
    missed = judge(found, seconds, known)
    results = {"steps_s": session.steps, "total_s": seconds, "missed": missed, **found}
    partial = options.out / "results.json.part"
    partial.write_text(json.dumps(results, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    partial.replace(options.out / "results.json")
    for name, taken in session.steps.items():
        print(f"{name:12} {taken:7.1f} s")
    steps = " ".join(f"{name} {taken:.1f} s;" for name, taken in session.steps.items() if name != "fit again")
    unseen = "" if found["reports"]["fit"]["opened"] else "; the reports were not opened: no browser is installed"
    met = f"a new user's first fit and sweep in {seconds:.0f} s: {steps[:-1]}{unseen}"
    print(f"missed: {'; '.join(missed)}" if missed else met)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
