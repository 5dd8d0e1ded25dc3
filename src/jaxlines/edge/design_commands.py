"""The command design: choose the test that makes a parameter of a study best known."""

from pathlib import Path
from typing import Annotated

import typer

from jaxlines.edge import help_texts

# Whatever needs JAX is imported inside the command, so that --version and --help answer at once.

StudyFile = Annotated[str, typer.Argument(metavar="STUDY", help="A study file (TOML) with a table [design].")]
Target = Annotated[
    list[str] | None,
    typer.Option("--target", metavar="PARAMETER", help="What the test is for (may be given again), not the study's."),
]
CriterionName = Annotated[str | None, typer.Option("--criterion", help="c for one parameter; D, A or E for several.")]
Out = Annotated[Path | None, typer.Option("--out", help="Folder for the results, made if needed.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress.")]


def add_commands(app: typer.Typer, one_line_errors) -> None:
    """Add `design STUDY` to an application.

    Args: app; one_line_errors: context manager of a file that turns errors into one line and an exit code.
    """

    @app.command(help=str(help_texts.DESIGN))
    def design(
        study: StudyFile, target: Target = None, criterion: CriterionName = None, out: Out = None, quiet: Quiet = False
    ) -> None:
        """Design the next test."""
        with one_line_errors(study):
            _run(study, target or [], criterion, out, quiet)


def _run(study: str, target: list[str], criterion: str | None, out: Path | None, quiet: bool) -> None:
    """Load, design, write, show."""
    from jaxlines.edge.design_showing import show_design
    from jaxlines.edge.design_study import load_design
    from jaxlines.edge.design_writing import write_design
    from jaxlines.edge.showing import progress
    from jaxlines.edge.writing import make_folder

    if out is not None:  # before any work
        make_folder(out)
    loaded = load_design(study, target, criterion)
    with progress(quiet) as say:
        found = loaded.design(say)
    title, files = loaded.study.title, []
    if out is not None:  # before anything is shown: a closed pipe must not lose the result
        levels = {name: bool(metadata.get("level")) for name, metadata in loaded.study.names.inputs.items()}
        files = write_design(found, title, out, levels)
    show_design(found, title)
    if files:
        typer.echo(f"\nwrote {', '.join(str(file) for file in files)}")
