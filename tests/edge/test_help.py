"""The help of every command: its sections, examples that can be called, exit codes of the code; at once."""

import re
import shlex
import subprocess
import sys
import time
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from jaxlines.edge import exit_codes
from jaxlines.edge.commands import app, run

SECTIONS = ("EXAMPLES", "EXIT STATUS", "SEE ALSO")
CODES = {value for name, value in vars(exit_codes).items() if name.isupper()}
MORE = {  # beside those of every command: 0, 2, 130
    "fit": {exit_codes.FIT_FAILED},
    "sweep": {exit_codes.TOO_MANY_FAILED, exit_codes.STOPPED},
    "sweep run": {exit_codes.TOO_MANY_FAILED, exit_codes.STOPPED},
    "sweep collect": {exit_codes.TOO_MANY_FAILED},
}
WRITING = {"fit", "simulate", "new", "schema", "sweep run", "sweep collect", "design"}
HELP = """
import sys
from jaxlines.edge.commands import run
code = run(sys.argv[1:])
print(sorted({name.split(".")[0] for name in sys.modules} & {"jax", "numpy", "pint", "pandas", "equinox"}), code)
"""


def named(command, name: str = "") -> dict[str, Any]:
    """The commands below one, by what is typed after `jaxlines`."""
    found = {}
    for own, one in getattr(command, "commands", {}).items():
        found |= {f"{name} {own}".strip(): one, **named(one, f"{name} {own}")}
    return found


COMMANDS = named(typer.main.get_command(app))


def shown(name: str, width: int = 80) -> str:
    """What --help prints where it is no terminal."""
    result = CliRunner().invoke(app, [*name.split(), "--help"], env={"COLUMNS": str(width)})
    assert result.exit_code == 0, result.output
    return result.stdout


def test_every_command_is_here():
    assert {"fit", "simulate", "check", "new", "schema", "keys", "sweep", "sweep run", "sweep status"} <= set(COMMANDS)


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_sections_in_order_and_no_wider_than_a_terminal(name):
    text = shown(name)
    places = [text.find(f" {section}") for section in SECTIONS]
    assert -1 not in places and places == sorted(places)
    assert (" FILES" in text) == (name in WRITING)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert not re.search(r"\*\*|```|`", text), "Markdown that was not rendered"


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_exit_codes_are_those_of_the_code(name):
    listed = shown(name).partition("EXIT STATUS")[2].partition("SEE ALSO")[0]
    codes = {int(code) for code in re.findall(r"^\s*• (\d+): \S", listed, flags=re.MULTILINE)}
    assert codes == {exit_codes.DONE, exit_codes.WRONG_CALL, exit_codes.INTERRUPTED} | MORE.get(name, set())
    assert codes <= CODES


def test_every_exit_code_belongs_to_a_command():
    assert set().union(*MORE.values(), {exit_codes.DONE, exit_codes.WRONG_CALL, exit_codes.INTERRUPTED}) == CODES


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_examples_and_related_commands_can_be_called(name):
    text = shown(name, width=200)
    examples = re.findall(r"^\s*\$ (.*?)\s*$", text, flags=re.MULTILINE)
    related = re.findall(r"jaxlines [a-z ]+[a-z]", text.partition("SEE ALSO")[2].partition("╭")[0])
    assert examples and related
    for line in "; ".join(examples).split("; "):
        words = shlex.split(line)
        assert words[0] == "jaxlines"
        parsed(words[1:])
    for line in related:
        assert line.split()[1] in COMMANDS, line


def parsed(words: list[str]) -> None:
    """The options of a command line are those of its command; nothing is run. Raises the usage error of typer."""
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands"):
        if words[0] not in command.commands:
            words = ["run", *words]  # of a sweep
        command, words = command.commands[words[0]], words[1:]
    if words != ["--help"]:
        assert command.make_context(command.name, list(words)).params


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "sweep"])
def test_a_wrong_option_is_a_wrong_call_that_points_to_the_help(name, capsys):
    assert run([*name.split(), "--no-such-option"]) == exit_codes.WRONG_CALL
    assert f"see jaxlines {name} --help" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["", "fit"])
def test_help_answers_at_once(name):
    began = time.perf_counter()
    words = [sys.executable, "-c", HELP, *name.split(), "--help"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.stdout.strip().splitlines()[-1] == "[] 0", done.stderr
    assert time.perf_counter() - began < 5.0  # 0.3 s alone; this machine may be busy


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_shown_and_completes(shell, monkeypatch):
    monkeypatch.setattr("typer.completion._get_shell_name", lambda: shell)
    shows = CliRunner().invoke(app, ["--show-completion"], prog_name="jaxlines")
    assert shows.exit_code == 0 and "_JAXLINES_COMPLETE" in shows.stdout
    environment = {
        "_JAXLINES_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": "jaxlines si",
        "COMP_WORDS": "jaxlines si",
        "COMP_CWORD": "1",
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    completes = CliRunner().invoke(app, [], prog_name="jaxlines", env=environment)
    assert "simulate" in completes.stdout and "schema" not in completes.stdout
