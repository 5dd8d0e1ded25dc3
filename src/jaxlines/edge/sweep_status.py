"""How far the sweeps of a folder are: lanes, rate, remaining time, failures, who is at work."""

from pathlib import Path

from rich.markup import escape

from jaxlines.edge.showing import plain_console, plain_table, show_sentences
from jaxlines.inference.sweep_claims import Claims
from jaxlines.inference.sweep_run import Progress
from jaxlines.inference.sweep_store import SweepStore, stores_in
from jaxlines.simulation.ensemble_result import LANE_MESSAGES

RECENT = 600.0
"""Seconds over which the rate is taken."""


def status_of(store: SweepStore) -> dict:
    """What is known of a sweep from its folder alone.

    Returns: lanes done; count that was asked for last; failed: status name -> lanes; rate [lanes/s] of the last ten
    minutes of work; working: chunks with a living claim; hosts; engine; torn lines of the manifest; notes.
    """
    events, torn = store.manifest()
    runs = [event for event in events if event.get("event") == "run"]
    chunks = [event for event in events if event.get("event") == "chunk"]
    done = sum(piece.stop - piece.start for piece in store.done())
    names, failed = list(LANE_MESSAGES), {}
    for event in {(event["start"], event["stop"]): event for event in chunks}.values():
        for code, lanes in event["status"].items():
            if code != "0":
                name = names[int(code)] if int(code) < len(names) else code
                failed[name] = failed.get(name, 0) + lanes
    return {
        "done": done,
        "count": runs[-1]["count"] if runs else done,
        "failed": failed,
        "rate": _rate(chunks),
        "working": Claims(store.folder / "claims").living(),
        "hosts": sorted({event["host"] for event in chunks}),
        "engine": f"{runs[-1]['engine']}, {runs[-1]['program'].get('engine')}" if runs else "",
        "torn": torn,
        "notes": [event["note"] for event in events if "note" in event],
    }


def _rate(chunks: list[dict]) -> float:
    """Lanes a second over the last minutes of work."""
    if not chunks:
        return 0.0
    last = max(event["time"] for event in chunks)
    recent = [event for event in chunks if event["time"] > last - RECENT]
    begun = min(event["time"] - event["seconds"] for event in recent)
    return sum(event["stop"] - event["start"] for event in recent) / max(last - begun, 1e-9)


def show_status(folder: Path) -> None:
    """Print how far the sweeps in a folder are. Raises FileNotFoundError without any."""
    found = stores_in(folder)
    if not found:
        raise FileNotFoundError(f"{folder}: there is no sweep in this folder")
    console = plain_console()
    for path in found:
        store = SweepStore(path)
        status = status_of(store)
        progress = Progress(status["done"], status["count"], sum(status["failed"].values()), status["rate"])
        console.print(f"[bold]{escape(store.asked()['title'])}[/bold]  ({escape(str(path))})")
        console.print(f"{progress}" if status["done"] < status["count"] else f"done: {status['done']:,} lanes")
        table = plain_table("", "", "")
        table.add_row("engine", escape(status["engine"]), "")
        table.add_row("computed on", escape(", ".join(status["hosts"])), "")
        table.add_row("at work", f"{status['working']} chunks", "")
        for name, lanes in status["failed"].items():
            table.add_row(f"failed ({name})", f"{lanes:,}", f"{100 * lanes / max(status['done'], 1):.3g} %")
        console.print(table)
        torn = [f"{status['torn']} lines of the manifest are torn: a computer crashed"] if status["torn"] else []
        show_sentences(console, "notes", [*status["notes"], *torn])
        console.print()
