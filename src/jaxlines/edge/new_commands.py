"""The commands that a new user meets first: new, schema and keys."""

from pathlib import Path
from typing import Annotated

import typer

from jaxlines.edge import help_texts

# Whatever is heavy is imported inside the commands, so that --version and --help answer at once.

Recording = Annotated[
    Path, typer.Option("--from", metavar="RECORDING", help="The recording: .csv, .parquet, .mat, ...")
]
Template = Annotated[
    str | None, typer.Option("--template", help="The circuit, instead of the one that the columns suggest.")
]
Step = Annotated[
    str | None, typer.Option("--step", help='Time from row to row, such as "1 ms", for a file without time.')
]
Force = Annotated[bool, typer.Option("--force", help="Write over an existing study.")]
Target = Annotated[Path, typer.Argument(metavar="STUDY", help="The study file to write (TOML).")]


def _trouble(study: Path) -> str:
    """Why a study that was just written cannot be read; "" where it can."""
    from jaxlines.edge.building import StudyError
    from jaxlines.edge.study import load_study

    try:
        load_study(study)
    except StudyError as error:
        return " ".join(str(error).split()).removeprefix(f"{study}: ")
    return ""


def _new(study: Path, recording: Path, template: str | None, step: str | None, force: bool) -> None:
    """Propose a study, show what it is, write it."""
    from jaxlines.edge.building import StudyError
    from jaxlines.edge.proposing import TEMPLATES, propose_study

    if study.exists() and not force:
        raise StudyError("is there already: give another name, or --force to write over it")
    if not study.parent.is_dir():
        raise StudyError(f"the folder {study.parent} is not there: make it first")
    found = propose_study(recording, template=template, step=step, base=study.parent)
    study.write_text(found.text, encoding="utf-8")
    typer.echo(f"wrote {study}: {found.template}, {TEMPLATES[found.template]}")
    if found.others:
        typer.echo(f"  also possible: --template {', '.join(found.others)}")
    for doubt in found.doubts:
        typer.echo(f"  CHECK {doubt}")
    guesses = sum("# CHECK" in line for line in found.text.splitlines()) - len(found.doubts)
    typer.echo(
        f"  CHECK {guesses} more numbers marked in the file: geometry and data-sheet values that no recording tells"
    )
    trouble = _trouble(study)
    if trouble:
        typer.echo(f"  FIRST {trouble}")
    typer.echo(f"next: jaxlines check {study}")


def add_commands(app: typer.Typer, one_line_errors) -> None:
    """Add the commands to an application.

    Args: app; one_line_errors: context manager of a file that turns errors into one line and an exit code.
    """

    @app.command(help=str(help_texts.NEW))
    def new(
        study: Target, recording: Recording, template: Template = None, step: Step = None, force: Force = False
    ) -> None:
        """Write a study for a recording."""
        with one_line_errors(str(study)):
            _new(study, recording, template, step, force)

    @app.command(help=str(help_texts.SCHEMA))
    def schema(
        out: Annotated[
            Path | None, typer.Option("--out", help="File to write, instead of the standard output.")
        ] = None,
    ) -> None:
        """Print or write the schema of study files."""
        from jaxlines.edge.study_schema import study_schema_text

        with one_line_errors(str(out or "schema")):
            text = study_schema_text()
            if out is None:
                typer.echo(text)
            else:
                out.write_text(text + "\n", encoding="utf-8")
                typer.echo(f"wrote {out}")

    @app.command(help=str(help_texts.KEYS))
    def keys(
        table: Annotated[
            str, typer.Argument(help="A table or class, such as fit.free, fluid or Line; all without.")
        ] = "",
    ) -> None:
        """Print the keys of a table or class."""
        from jaxlines.edge.study_keys import keys_as_text

        with one_line_errors(table or "keys"):
            typer.echo(keys_as_text(table))
