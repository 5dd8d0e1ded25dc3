"""The README: its Python blocks and commands run and print what it shows, and what it names exists."""

import contextlib
import importlib
import inspect
import io
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

import jaxlines as jl
from jaxlines.edge.commands import app
from jaxlines.physics.fields import AbstractSignal

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
INSTALL = "python -m pip install . && jaxlines fit example:control-line"
TEST = 'python -m pip install ".[test]" && python -m pytest'
FIT = "jaxlines fit example:control-line"
NAMES = ["fit", "simulate", "gradient", "cylinder", "ensemble", "sweep", "waves"]
PYTHON = [(code, BLOCKS[i + 1]) for i, (kind, code) in enumerate(BLOCKS) if kind == "python"]
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def last_digit(number: str) -> float:
    """What one more in the last printed digit is."""
    mantissa, _, exponent = number.lower().partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def agrees(shown: str, printed: str) -> bool:
    """Whether a line of the README is a printed one, up to one in the last digit; a closing ... stands for any rest."""
    shown, printed = " ".join(shown.split()), " ".join(printed.split())
    words = NUMBER.sub("#", shown)
    found = NUMBER.sub("#", printed)
    if not (found.startswith(words.removesuffix("...").rstrip()) if words.endswith("...") else found == words):
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=False)
    return all(abs(float(a) - float(b)) <= 1.01 * last_digit(a) for a, b in pairs)


def check_output(shown: str, printed: str) -> None:
    """Every line of the README was printed, in this order; other lines may stand between them."""
    rest = iter(printed.splitlines())
    for line in shown.splitlines():
        assert any(agrees(line, other) for other in rest), f"not printed, or not in this order: {line!r}\n\n{printed}"


@pytest.fixture(scope="module")
def fit_output() -> str:
    result = CliRunner().invoke(app, [*shlex.split(FIT)[1:], "--quiet"])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_lines_are_compared_to_their_last_digit():
    assert agrees("modulus  1.379 GPa", "modulus 1.3781 GPa") and agrees("a 2e-12; ...", "a 3e-12; b 7")
    assert not agrees("modulus 1.379 GPa", "modulus 1.377 GPa")
    assert not agrees("modulus 1.379 GPa", "modulus 1.379 MPa") and not agrees("a 2e-12; ...", "a 4e-12; b 7")


def test_the_two_commands_stand_there_as_they_are():
    commands = [text.strip() for kind, text in BLOCKS if kind == "sh"]
    assert commands[:2] == [INSTALL, TEST]
    assert INSTALL.endswith(FIT)


def test_the_fit_prints_what_is_shown(fit_output):
    shown = next(text for kind, text in BLOCKS if kind == "text")
    assert "fluid.bulk_modulus" in shown and len(shown.splitlines()) > 8
    check_output(shown, fit_output)


@pytest.mark.parametrize(("code", "shown"), PYTHON, ids=NAMES)
def test_python_blocks(code, shown):
    kind, text = shown
    assert kind == "text" and len([line for line in code.splitlines() if line]) <= 20
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(compile(code, "README.md", "exec"), {})
    assert len(output.getvalue().splitlines()) == len(text.splitlines())
    check_output(text, output.getvalue())


def commands() -> list[str]:
    """The `jaxlines` commands in blocks of their own, other than those of the installation."""
    lines = [line for kind, text in BLOCKS if kind == "sh" for line in text.splitlines()]
    return [line for line in lines if line.startswith("jaxlines ")]


@pytest.mark.parametrize("command", commands())
def test_commands(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, [*shlex.split(command)[1:], "--quiet"])
    assert result.exit_code == 0, result.output


def test_the_short_study_can_be_read(tmp_path):
    study = next(text for kind, text in BLOCKS if kind == "toml")
    rows = "\n".join(f"{0.1 * i:.1f},{1 + 0.1 * i:.1f},{0.5 * (i % 2)}" for i in range(20))
    (tmp_path / "run_027.csv").write_text(f"t [s],p_line [bar_g],q_valve [L/min]\n{rows}\n")
    (tmp_path / "study.toml").write_text(study)
    loaded = jl.load_study(tmp_path / "study.toml")
    assert [free.label for free in loaded.free] == ["fluid.bulk_modulus", "fluid.air_fraction"]
    assert loaded.recording is not None and set(loaded.recording.channels) == {"A.pressure", "flow"}


def test_experiments_tests_and_links_exist():
    named = set(re.findall(r"(?:experiments|tests)/[\w/]+\.py", README))
    links = {link for link in re.findall(r"\]\(([^)#]+)\)", README) if "://" not in link}
    assert len(named) >= 8 and len(links) >= 4
    assert [path for path in sorted(named | links) if not (ROOT / path).exists()] == []


def test_every_model_is_in_the_table_and_nothing_else_is():
    public = {name: getattr(jl, name) for name in dir(jl) if not name.startswith("_")}
    classes = {name: thing for name, thing in public.items() if inspect.isclass(thing)}
    physical = {name for name, thing in classes.items() if thing.__module__.startswith("jaxlines.physics")}
    models = physical | {name for name, thing in classes.items() if issubclass(thing, AbstractSignal)}
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", README, flags=re.MULTILINE)
    assert {name for row in rows for name in re.findall(r"\w+", row)} == models


def test_the_comparison_with_other_tools_names_models_that_exist():
    rows = re.findall(r"^\| (`.*?) \|", (ROOT / "docs/components.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert len(named) > 30 and not [name for name in sorted(named) if not hasattr(jl, name)]


def test_named_modules_and_functions_exist():
    for module in set(re.findall(r"`(jaxlines\.[\w.]+)`", README)):
        importlib.import_module(module)
    for name in set(re.findall(r"`jl\.(\w+)`", README)):
        assert callable(getattr(jl, name))
