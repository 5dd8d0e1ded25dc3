"""The new user's recording against an integrator, what is judged a miss, and (slow) the whole way."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

SCRIPTS = Path(__file__).parents[2] / "experiments"
REPORT = {"opened": True, "plots": 3, "errors": [], "bytes": 1_500_000, "loads_from_outside": []}


@pytest.fixture
def script(monkeypatch):
    """The script as a module."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import new_user  # pyright: ignore[reportMissingImports]

    return new_user


def found(**changes) -> dict:
    """What came out of a faultless way."""
    numbers = {"line.effective_bulk_modulus": 1.25e9, "leak.conductance": 4e-13}
    reports = {name: {**REPORT, **changes} for name in ("fit", "sweep")}
    sweep = {"lanes": 512, "failed": {}, "reductions": ["peak"]}
    return {"status": "converged", "parameters": numbers, "sweep": sweep, "reports": reports}


def test_the_recording_solves_its_equation(script):
    times = np.linspace(0.0, 10.0, 101)
    pressure, flow = script.recorded_pressure(times, 4e-6)

    def rate(t, p):
        inflow = 4e-6 * np.sin(0.4 * t) ** 2
        return script.MODULUS / script.VOLUME * (inflow - script.LEAK * p)

    exact = solve_ivp(rate, (0.0, 10.0), [5e5], t_eval=times, rtol=1e-10, atol=1e-3).y[0]
    np.testing.assert_allclose(pressure, exact, atol=1.0)
    np.testing.assert_allclose(flow, 4e-6 * np.sin(0.4 * times) ** 2, atol=1e-18)


def test_misses_are_told(script):
    assert script.judge(found(), 100.0, known=True) == []
    assert script.judge(found(opened=False), 100.0, known=True) == []
    assert script.judge(found(bytes=6_000_000), 100.0, True)[0] == "the report of the fit is larger than 5 MB"
    assert script.judge(found(plots=0), 100.0, True)[1] == "the report of the sweep shows no plot"
    assert "CONSOLE error" in script.judge(found(errors=["CONSOLE error"]), 100.0, True)[0]
    assert "http://a" in script.judge(found(loads_from_outside=["http://a"]), 100.0, True)[0]
    assert script.judge(found(), 1000.0, True) == ["it took 1000 s"]
    failing = found()
    failing["sweep"]["failed"] = {"diverged": 100}
    assert script.judge(failing, 100.0, True) == ["100 of 512 runs of the sweep failed"]
    wrong = found()
    wrong["parameters"]["leak.conductance"] = 5e-13
    assert script.judge(wrong, 100.0, True) == ["leak 5e-13, not 4e-13"]
    assert script.judge(wrong, 100.0, known=False) == []


def test_addresses_outside_are_noticed_and_those_in_scripts_are_not(script):
    page = '<a href="#x"></a><img src="data:x"><script>s = \'src="https://a"\'</script><link href="https://b">'
    assert script.Addresses(page).outside == ["https://b"]


def test_a_report_is_opened_where_there_is_a_browser(script, tmp_path):
    page = tmp_path / "report.html"
    page.write_text(
        "<html><body><script>document.documentElement.dataset.plots = 2; console.error('an error here')</script>",
        encoding="utf-8",
    )
    opened = script.open_report(script.Session(tmp_path), "open", page)
    if any(shutil.which(name) for name in script.BROWSERS):
        assert (opened["opened"], opened["plots"]) == (True, 2)
        assert "an error here" in opened["errors"][0]
    else:
        assert not opened["opened"]
        assert "installed" in opened["why_not"]


def test_without_a_browser_it_says_so(script, tmp_path, monkeypatch):
    monkeypatch.setattr(script.shutil, "which", lambda name: None)
    page = tmp_path / "report.html"
    page.write_text("<html></html>", encoding="utf-8")
    opened = script.open_report(script.Session(tmp_path), "open", page)
    assert opened["opened"] is False
    assert opened["why_not"] == "none of chromium, chromium-browser, google-chrome is installed"


@pytest.mark.slow
def test_the_whole_way_in_this_environment(tmp_path):
    command = [sys.executable, str(SCRIPTS / "new_user.py"), "--out", str(tmp_path), "--keep-environment", sys.prefix]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "a new user's first fit and sweep in" in done.stdout.splitlines()[-1]
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert results["missed"] == []
    assert results["sweep"]["lanes"] >= 256
