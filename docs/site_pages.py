"""Pages of the documentation site that come from the code: commands, keys of studies, models, formulas."""

import importlib.util
import inspect
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def _performance_page() -> str:
    """The page made from results of experiments; its module stands beside this one, outside any package."""
    spec = importlib.util.spec_from_file_location("performance_page", ROOT / "docs" / "performance_page.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.performance_page()


def models_page() -> str:
    """Every public class and function with its docstring, by module."""
    import jaxlines

    lines = [
        "# Models and functions",
        "",
        "Everything that `import jaxlines as jl` offers, by module, with its docstring.",
        "",
    ]
    found: dict[str, list[tuple[str, object]]] = {}
    for name in dir(jaxlines):
        thing = getattr(jaxlines, name)
        if not name.startswith("_") and (inspect.isclass(thing) or inspect.isfunction(thing)):
            found.setdefault(thing.__module__, []).append((name, thing))
    for module, things in sorted(found.items()):
        lines += [f"## {module.removeprefix('jaxlines.')}", ""]
        for name, thing in things:
            lines += [f"### {name}", "", "```text", inspect.getdoc(thing) or name, "```", ""]
    return "\n".join(lines)


def _command_lines(name: str, command) -> list[str]:
    """A command with its arguments and options, and those below it."""
    lines = [f"## {name}", "", inspect.cleandoc(command.help or ""), ""]
    lines += ["| argument | meaning | default |", "|---|---|---|"]
    for parameter in command.params:
        opts = "`, `".join(parameter.opts) if parameter.param_type_name == "option" else parameter.name.upper()
        default = "" if parameter.default in (None, False) or parameter.required else f"`{parameter.default}`"
        text = " ".join((getattr(parameter, "help", None) or "").split())
        lines.append(f"| `{opts}` | {text.replace('|', '/')} | {'**required**' if parameter.required else default} |")
    if not command.params:
        del lines[-2:]
    below = sorted(getattr(command, "commands", {}).items())
    return [*lines, "", *(line for own, one in below for line in _command_lines(f"{name} {own}", one))]


def commands_page() -> str:
    """The help of every command, as the terminal shows it."""
    import typer

    from jaxlines.edge.commands import app

    lines = ["# Commands", "", "`jaxlines COMMAND --help` shows the same. Shell completion: see the FAQ.", ""]
    return "\n".join([*lines, *_command_lines("jaxlines", typer.main.get_command(app))])


def _copied(path: str) -> str:
    """A page of docs/, its links to files of the repository made plain."""
    text = (ROOT / "docs" / path).read_text(encoding="utf-8")
    return re.sub(r"\[([^\]]+)\]\((?!https?:)[^)]+\)", r"\1", text)


def generated_pages() -> dict[str, str]:
    """Path in the site -> content, of every page that is made from code or from docs/."""
    from jaxlines.edge.study_keys import keys_as_markdown
    from jaxlines.edge.study_schema import study_schema_text

    return {
        "performance.md": _performance_page(),
        "reference/commands.md": commands_page(),
        "reference/study-keys.md": keys_as_markdown(),
        "reference/study.schema.json": study_schema_text(),
        "reference/models.md": models_page(),
        "reference/physics.md": _copied("physics.md"),
        "reference/components.md": _copied("components.md"),
        "example.svg": (ROOT / "docs" / "example.svg").read_text(encoding="utf-8"),
    }


def on_files(files, config):
    """Add the generated pages to those of the folder (a hook of MkDocs)."""
    from mkdocs.structure.files import File

    for path, content in generated_pages().items():
        files.append(File.generated(config, path, content=content))
    return files
