"""The commands sweep, sweep status and sweep collect: run the sweep of a study, look at one, collect one."""

import contextlib
import signal
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from jaxlines.edge import help_texts
from jaxlines.edge.exit_codes import STOPPED, TOO_MANY_FAILED

# Whatever needs JAX is imported inside the commands, so that --version and --help answer at once.

LINE_SECONDS = 10.0

StudyFile = Annotated[str, typer.Argument(metavar="STUDY", help="A study file (TOML) with a table [sweep].")]
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The folder that was given as --out.")]
Out = Annotated[Path, typer.Option("--out", help="Folder for the sweep, made if needed.")]
Count = Annotated[int | None, typer.Option("--count", help="How many lanes, instead of the study's number.")]
EngineName = Annotated[str, typer.Option("--engine", help="local, dask (this machine) or dask://HOST:PORT.")]
Workers = Annotated[int, typer.Option("--workers", help="Processes of the engine on this machine.")]
Shard = Annotated[str, typer.Option("--shard", help="I/N: only every N-th chunk from the I-th, for batch queues.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with what is in the folder.")]
Allow = Annotated[bool, typer.Option("--allow-changes", help="Begin a new sweep beside one of another plan.")]
Chunk = Annotated[int | None, typer.Option("--chunk", help="Lanes of a call and of a file.")]
Limit = Annotated[float, typer.Option("--max-failed", help="Exit with 3 when a larger share of lanes failed.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress.")]


class _Group(TyperGroup):
    """`sweep STUDY ...` is `sweep run STUDY ...`."""

    def parse_args(self, ctx, args: list[str]) -> list[str]:
        """Put in the name of the command where it is left out."""
        first = args[0] if args else "--help"
        return super().parse_args(ctx, args if first in ("--help", *self.commands) else ["run", *args])


def add_commands(app: typer.Typer, one_line_errors) -> None:
    """Add `sweep STUDY`, `sweep status DIR` and `sweep collect DIR` to an application.

    Args: app; one_line_errors: context manager of a file or folder that turns errors into one line and an exit code.
    """
    group = typer.Typer(cls=_Group, add_completion=False, rich_markup_mode="markdown", help=str(help_texts.SWEEPS))
    group.command("run", help=str(help_texts.SWEEP))(_sweep_command(one_line_errors))
    group.command("status", help=str(help_texts.STATUS))(_status_command(one_line_errors))
    group.command("collect", help=str(help_texts.COLLECT))(_collect_command(one_line_errors))
    app.add_typer(group, name="sweep")


def _sweep_command(one_line_errors):
    def sweep(
        study: StudyFile,
        out: Out,
        count: Count = None,
        engine: EngineName = "local",
        workers: Workers = 1,
        shard: Shard = "1/1",
        resume: Resume = False,
        allow_changes: Allow = False,
        chunk: Chunk = None,
        max_failed: Limit = 0.1,
        quiet: Quiet = False,
    ) -> None:
        """Run a sweep, or go on with one."""
        with one_line_errors(study), _stopped(study), _terminated():
            options = {"where": engine, "workers": workers, "shard": _shard(shard), "resume": resume}
            _run(study, out, count, {**options, "allow_changes": allow_changes, "chunk": chunk}, max_failed, quiet)

    return sweep


def _status_command(one_line_errors):
    def status(folder: Folder) -> None:
        """Show the sweeps of a folder."""
        with one_line_errors(str(folder)):
            from jaxlines.edge.sweep_status import show_status

            show_status(folder)

    return status


def _collect_command(one_line_errors):
    def collect(folder: Folder, max_failed: Limit = 0.1) -> None:
        """Collect a sweep."""
        with one_line_errors(str(folder)):
            from jaxlines.inference.sweep_collect import collect as collect_store
            from jaxlines.inference.sweep_result import SweepResult
            from jaxlines.inference.sweep_store import open_store

            store = open_store(folder)
            _show(SweepResult(store.folder, store.content, collect_store(store)), store.asked()["title"], max_failed)

    return collect


def _run(study: str, out: Path, count: int | None, options: dict[str, Any], max_failed: float, quiet: bool) -> None:
    """Load, run, show."""
    from jaxlines.edge.showing import progress
    from jaxlines.edge.sweep_study import load_sweep
    from jaxlines.edge.writing import make_folder
    from jaxlines.inference.sweep import run_sweep

    loaded = load_sweep(study, count)
    make_folder(out)
    with progress(quiet) as say:
        say("preparing", 0.0)
        report = _reporter(say, quiet)
        result = run_sweep(
            loaded.plan,
            loaded.count,
            store=out,
            thresholds=loaded.thresholds,
            quantiles=loaded.quantiles,
            title=loaded.study.title,
            progress=report,
            **options,
        )
    _show(result, loaded.study.title, max_failed)


def _reporter(say, quiet: bool):
    """A function of a `Progress`: into the bar on a terminal, a line every ten seconds elsewhere."""
    last = 0.0

    def report(progress) -> None:
        nonlocal last
        if sys.stderr.isatty():
            say(str(progress), progress.done / progress.count)
        elif not quiet and time.monotonic() > last + LINE_SECONDS:
            last = time.monotonic()
            typer.echo(str(progress), err=True)

    return report


def _show(result, title: str, max_failed: float) -> None:
    """Print a sweep, write its report and summary, and exit by the share that failed."""
    from jaxlines.edge.sweep_report import write_sweep
    from jaxlines.edge.sweep_showing import show_sweep

    files = write_sweep(result, title) if result.count else []
    show_sweep(result, title)
    if files:
        typer.echo(f"\nwrote {', '.join(str(file) for file in files)}")
    if result.failed_fraction > max_failed:
        typer.echo(f"jaxlines: {100 * result.failed_fraction:.3g} % of the lanes failed", err=True)
        raise typer.Exit(TOO_MANY_FAILED)


def _shard(text: str) -> tuple[int, int]:
    """ "2/8" as (2, 8). Raises ValueError."""
    number, _, of = text.partition("/")
    if not (number.isdigit() and of.isdigit()):
        raise ValueError(f"--shard must be I/N such as 2/8, got {text!r}")
    return int(number), int(of)


@contextlib.contextmanager
def _stopped(study: str):
    """A sweep that stopped before its end as one line and exit code 4."""
    from jaxlines.inference.sweep_run import SweepStopped

    try:
        yield
    except SweepStopped as error:
        typer.echo(f"jaxlines: {study}: {' '.join(str(error).split())}", err=True)
        raise typer.Exit(STOPPED) from None


@contextlib.contextmanager
def _terminated():
    """SIGTERM, with which batch queues end jobs, as Ctrl-C: claims are given back, what is done is kept."""

    def interrupt(number, frame):
        raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:  # not in the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
