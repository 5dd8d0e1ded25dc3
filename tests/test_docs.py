"""The documentation site: every Python block and command runs and prints what is shown; pages and links exist."""

import contextlib
import importlib.util
import io
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from jaxlines.edge import commands
from jaxlines.edge.new_commands import add_commands
from tests.test_readme import check_output

ROOT = Path(__file__).parents[1]
SITE = ROOT / "docs" / "site"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def blocks(page: Path) -> list[tuple[str, str]]:
    """Kind and text of every block of a page, in order."""
    return BLOCK.findall(page.read_text(encoding="utf-8"))


PAGES = [page for page in sorted(SITE.rglob("*.md")) if any(kind in ("python", "console") for kind, _ in blocks(page))]


def app():
    """The command line, with the commands of new users."""
    names = {info.name or getattr(info.callback, "__name__", "") for info in commands.app.registered_commands}
    if "new" not in names:
        add_commands(commands.app, commands._one_line_errors)
    return commands.app


def run_console(text: str) -> None:
    """Commands after "$ " run; what is shown below each is printed, in order."""
    for part in text.split("$ ")[1:]:
        command, _, shown = part.partition("\n")
        words = shlex.split(command)
        assert words[0] == "jaxlines"
        result = CliRunner().invoke(app(), words[1:])
        assert result.exit_code == 0, result.output
        check_output(shown, result.stdout)


def run_python(code: str, shown: str | None, namespace: dict, name: str) -> None:
    """A block runs; a block of text after it is what it prints."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(compile(code, name, "exec"), namespace)
    if shown is not None:
        check_output(shown, output.getvalue())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(SITE).as_posix())
def test_snippets_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found, namespace = blocks(page), {"__name__": "page"}
    for i, (kind, text) in enumerate(found):
        following = found[i + 1] if i + 1 < len(found) else ("", "")
        if kind == "console":
            run_console(text)
        elif kind == "python":
            run_python(text, following[1] if following[0] == "text" else None, namespace, page.name)


def site_pages():
    """The module that makes the generated pages."""
    spec = importlib.util.spec_from_file_location("site_pages", ROOT / "docs" / "site_pages.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def nav(entries) -> list[str]:
    """The pages of a navigation."""
    found = []
    for entry in entries:
        target = entry if isinstance(entry, str) else next(iter(entry.values()))
        found += nav(target) if isinstance(target, list) else [target]
    return found


def test_pages_links_and_navigation():
    yaml = pytest.importorskip("yaml")
    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    written = {page.relative_to(SITE).as_posix() for page in SITE.rglob("*.md")}
    generated = site_pages().generated_pages()
    assert set(nav(config["nav"])) == written | {name for name in generated if name.endswith(".md")}
    assert (
        "### Servovalve" in generated["reference/models.md"] and "## jaxlines fit" in generated["reference/commands.md"]
    )
    for page in SITE.rglob("*.md"):
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            target = (page.parent / link).resolve()
            inside = target.is_relative_to(SITE) and target.relative_to(SITE).as_posix() in written | set(generated)
            assert "://" in link or inside, f"{page.name}: {link}"


def test_named_experiments_and_tests_exist():
    text = "\n".join(page.read_text(encoding="utf-8") for page in SITE.rglob("*.md"))
    named = set(re.findall(r"`((?:experiments|tests)/[\w/.]+)`", text))
    assert len(named) > 10 and not [path for path in named if not (ROOT / path).exists()]
    assert "None of the recordings used has an independently known bulk modulus or air content" in text


@pytest.mark.slow
def test_the_site_builds_without_warnings(tmp_path):
    pytest.importorskip("material")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "site" / "reference" / "study-keys.html").is_file()
