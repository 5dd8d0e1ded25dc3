"""The commands: fit, simulate and check a study."""

import contextlib
import importlib.metadata
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxlines.edge import design_commands, help_texts, new_commands, sweep_commands
from jaxlines.edge.exit_codes import FIT_FAILED, INTERRUPTED, WRONG_CALL

# Whatever needs JAX is imported inside the commands, so that --version and --help answer at once.

UsageError: Any = typer.BadParameter.__base__  # of click, which typer does not export

app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode="markdown", help=str(help_texts.ALL))

StudyFile = Annotated[str, typer.Argument(metavar="STUDY", help="A study file (TOML), or example:NAME.")]
Out = Annotated[Path | None, typer.Option("--out", help="Folder for the results, made if needed.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress.")]


def _show_version(wanted: bool) -> None:
    """Print the version and stop."""
    if wanted:
        typer.echo(f"jaxlines {importlib.metadata.version('jaxlines')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Options before the command."""


@contextlib.contextmanager
def _one_line_errors(study: str):
    """What a user did wrong, or a failed simulation, as one line on stderr and exit code 2; 130 for Ctrl-C."""
    try:
        yield
    except typer.Exit:
        raise
    except KeyboardInterrupt:
        typer.echo("jaxlines: interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except (ValueError, KeyError, TypeError, OSError, RuntimeError, ImportError) as error:
        line = _one_line(error)
        typer.echo(f"jaxlines: {line}" if line.startswith(study) else f"jaxlines: {study}: {line}", err=True)
        raise typer.Exit(WRONG_CALL) from None


def _one_line(error: Exception) -> str:
    """What went wrong, in one line."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    return " ".join(text.split())


def _writable(out: Path | None) -> None:
    """Raise OSError before any work when the results could not be written."""
    if out is not None:
        from jaxlines.edge.writing import make_folder

        make_folder(out)


def _report_files(files) -> None:
    """Say what was written, if anything."""
    if files:
        typer.echo(f"wrote {', '.join(str(file) for file in files)}")


Checkpoint = Annotated[
    Path | None, typer.Option("--checkpoint", help="File kept up to date; a fit that was killed goes on from it.")
]
Assess = Annotated[
    bool, typer.Option("--assess", help="Class each parameter by its likelihood profile (many more simulations).")
]
Draws = Annotated[
    int,
    typer.Option(
        "--posterior", metavar="DRAWS", min=0, help="Sample the posterior, so many draws in each of 4 chains (minutes)."
    ),
]


def _more_of(found, assess: bool, draws: int, say) -> dict:
    """What was asked for beside the fit: classes of identifiability, draws of the posterior."""
    more = {}
    if found.status != "failed" and assess:
        say("profiles", 0.95)
        more["classes"] = found.assess()
    if found.status != "failed" and draws:
        say("posterior", 0.97)
        more["posterior"] = found.posterior(draws=draws)
    return more


@app.command(help=str(help_texts.FIT))
def fit(
    study: StudyFile,
    out: Out = None,
    quiet: Quiet = False,
    checkpoint: Checkpoint = None,
    assess: Assess = False,
    posterior: Draws = 0,
) -> None:
    """Fit the free parameters of a study to its recording."""
    from jaxlines.edge.showing import progress, show_fit

    with _one_line_errors(study):
        from jaxlines.edge.study import load_study

        _writable(out)
        if posterior:
            from jaxlines.inference.posterior import check_installed

            check_installed()
        loaded = load_study(study)
        with progress(quiet) as say:
            found = loaded.fit(say, checkpoint)
            more = _more_of(found, assess, posterior, say)
        files = []
        if out is not None:  # before anything is shown: a closed pipe must not lose the result
            from jaxlines.edge.writing import write_fit

            files = write_fit(found, loaded, out, **more)
        show_fit(found, loaded.title, **more)
        _report_files(files)
        if found.status == "failed":
            typer.echo(f"jaxlines: {study}: the fit failed: {found.message}", err=True)
            raise typer.Exit(FIT_FAILED)


@app.command(help=str(help_texts.SIMULATE))
def simulate(study: StudyFile, out: Out = None, quiet: Quiet = False) -> None:
    """Simulate a study and show its outputs."""
    from jaxlines.edge.showing import progress, show_simulation

    with _one_line_errors(study):
        from jaxlines.edge.study import load_study

        _writable(out)
        loaded = load_study(study)
        with progress(quiet) as say:
            say("simulating", 0.3)
            simulation = loaded.simulate()
        files = []
        if out is not None:
            from jaxlines.edge.writing import write_simulation

            files = write_simulation(simulation, loaded, out, loaded.outputs)
        show_simulation(simulation, loaded.title, loaded.outputs)
        _report_files(files)


@app.command(help=str(help_texts.CHECK))
def check(study: StudyFile, quiet: Quiet = False) -> None:
    """Show what is in a study, and what looks odd."""
    from jaxlines.edge.showing import progress, show_simulation, show_study

    with _one_line_errors(study):
        from jaxlines.edge.checking import check_study, show_findings
        from jaxlines.edge.study import load_study

        loaded = load_study(study)
        with progress(quiet) as say:
            say("simulating", 0.3)
            simulation = loaded.simulate(on_recording=True)
            findings = check_study(loaded, say=say)
        show_study(loaded, simulation)
        show_simulation(simulation, "simulated with the numbers of the file", ())
        show_findings(findings)


sweep_commands.add_commands(app, _one_line_errors)
design_commands.add_commands(app, _one_line_errors)
new_commands.add_commands(app, _one_line_errors)


def run(arguments: list[str] | None = None) -> int:
    """Run a command line (by default that of the process; help without any) and return its exit code."""
    given = sys.argv[1:] if arguments is None else arguments
    try:
        return app(given or ["--help"], prog_name="jaxlines", standalone_mode=False) or 0
    except UsageError as error:
        command = error.ctx.command_path if error.ctx else "jaxlines"
        line = " ".join(error.format_message().split()).rstrip(".")
        typer.echo(f"jaxlines: {line}: see {command} --help", err=True)
        return WRONG_CALL
