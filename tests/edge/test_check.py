"""What a check says before any fit: guesses, units, what cannot be told apart, slopes, run time."""

import numpy as np
import pytest
from studies import write_study

from jaxlines.edge.checking import GRADIENT_LIMIT, check_study, gradient_errors, show_findings
from jaxlines.edge.study import load_study

VISCOSITY = """[[fit.free]]
path = "fluid.kinematic_viscosity"
bounds = ["10 mm^2/s", "100 mm^2/s"]
[[fit.known]]
path = "line.parts.0.length"
sd = "0.05 m"
"""
KNOWN = '[[fit.known]]\npath = "line.parts.0.length"\nsd = "0.05 m"\n'


@pytest.fixture(scope="module")
def findings(tmp_path_factory):
    """A study with a number that the model cannot see: the viscosity of one lump."""
    folder = tmp_path_factory.mktemp("check")
    path = write_study(folder, (KNOWN, VISCOSITY))
    path.write_text(path.read_text().replace('density = "850 kg/m^3"', 'density = "850 kg/m^3"  # CHECK: data sheet'))
    return check_study(load_study(path), points=3)


def texts(findings, topic):
    return [finding.text for finding in findings if finding.topic == topic]


def test_guesses_and_units(findings):
    assert texts(findings, "guesses") == ["1 lines are marked CHECK (5): replace the guesses, then the mark"]
    pressure, flow = texts(findings, "units")[:2]
    assert pressure.startswith("A.pressure: ") and pressure.endswith("MPa absolute") and "L/min" in flow


def test_what_the_model_cannot_tell(findings):
    (stop,) = [finding for finding in findings if finding.level == "stop"]
    assert "at all 4 points tried, 1 combination(s) of the free numbers change nothing" in stop.text
    assert "the recording says nothing about fluid.kinematic_viscosity within its bounds" in texts(
        findings, "identifiability"
    )
    assert "fluid.kinematic_viscosity: hardly better than its bounds" in texts(findings, "expected")
    assert any(text.startswith("fluid.bulk_modulus: to about ") for text in texts(findings, "expected"))


def test_validity_gradients_and_run_time(findings):
    assert any("2L/c0" in text for text in texts(findings, "validity"))
    assert "exact slopes agree with differences within" in texts(findings, "gradients")[0]
    assert "s on this machine" in texts(findings, "run time")[0]


def test_they_are_shown(findings, capsys):
    show_findings(findings)
    shown = capsys.readouterr().out
    assert "identifiability" in shown and " !  at all 4 points" in shown and " ?  1 lines are marked CHECK" in shown


class Known:
    """Two samples of known functions of two coordinates."""

    widths = np.array([2.0, 3.0])

    def predictions(self, x):
        return np.array([np.sin(x[0]) * x[1], np.exp(x[1])])

    def jacobian(self, x):
        return np.array([[np.cos(x[0]) * x[1], np.sin(x[0])], [0.0, np.exp(x[1])]])


def test_a_wrong_slope_is_found():
    x = np.array([0.7, 0.4])
    right = Known().jacobian(x)
    assert gradient_errors(Known(), x, right).max() < 1e-9
    wrong = right * np.array([1.0, 1.1])
    errors = gradient_errors(Known(), x, wrong)
    assert errors[0] < 1e-9 and errors[1] == pytest.approx(0.1 / 1.1, rel=1e-6) and errors[1] > GRADIENT_LIMIT


def test_a_study_without_a_fit_is_checked_too(tmp_path):
    path = write_study(tmp_path)
    text = path.read_text()
    path.write_text(text[: text.index("[recording]")] + text[text.index("[simulate]") :])
    topics = {finding.topic for finding in check_study(load_study(path))}
    assert topics == {"validity"}


@pytest.mark.slow
def test_a_swapped_unit_is_found_beside_the_model(tmp_path):
    """Pressures in bar that are read as psi: the model moves 14.5 times as much."""
    path = write_study(tmp_path, ("p_line [bar_g]", "p_line [psi_g]"))
    table = (tmp_path / "line.csv").read_text()
    (tmp_path / "line.csv").write_text(table.replace("p_line [bar_g]", "p_line [psi_g]"))
    found = [f for f in check_study(load_study(path), points=1) if f.topic == "recordings"]
    assert found and any("psi" in finding.text for finding in found)
