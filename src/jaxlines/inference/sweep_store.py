"""The folder of a sweep: chunks written once and whole, a manifest, and what becomes of damage.

ROOT/<hash of the plan>/
    plan.json                      the plan, names, units, lanes of a chunk
    asked.json                     quantiles and thresholds that the statistics are to have
    prepared.json                  engine, steps, precision and scales, fixed by the first worker
    manifest.jsonl                 who computed what, when, how fast (nothing else here has a time in it)
    chunks/<start>-<stop>.parquet  a row a lane: index, numbers, reductions, status, error
    chunks/<start>-<stop>.npz      sketches of the outputs over time, and the series that are kept
    claims/                        who works on what
    table.parquet, bands.parquet, summary.json, report.html     made of the above by collecting, at any time
"""

import contextlib
import json
import os
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxlines.inference.statistics import QUANTILES
from jaxlines.inference.sweep_claims import Claims
from jaxlines.inference.sweep_plan import SweepPlan

ROW_GROUP = 65_536


class Piece(NamedTuple):
    """Lanes start..stop, all in the chunk of this number."""

    chunk: int
    start: int
    stop: int


class ChangedPlan(ValueError):
    """The folder holds another sweep than the one that was asked for."""


def write_new(path: Path, write: Callable[[Path], Any]) -> bool:
    """Write a file whole, under its name only when it is complete and on the disk, and only if there is none yet.

    Args: path; write: what writes the content to the path it is given. Returns False when the file was there already.
    Raises: OSError when it cannot be written (a full disk): nothing is left then.
    """
    temporary = path.with_name(f".tmp-{uuid.uuid4().hex}{path.suffix}")
    try:
        write(temporary)
        _synced(temporary)
        try:
            os.link(temporary, path)
        except FileExistsError:
            return False
        except OSError:  # a file system without links: its claim keeps others away
            os.replace(temporary, path)
        _synced(path.parent)
        return True
    finally:
        temporary.unlink(missing_ok=True)


def write_over(path: Path, write: Callable[[Path], Any]) -> Path:
    """Write a file so that a reader sees the old one or the new one, never a part. Raises OSError."""
    temporary = path.with_name(f".tmp-{uuid.uuid4().hex}{path.suffix}")
    try:
        write(temporary)
        _synced(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def _synced(path: Path) -> None:
    """Have a file, or a folder's list of names, on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _json_text(content: dict) -> Callable[[Path], Any]:
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    return lambda path: path.write_text(text, encoding="utf-8")


class SweepStore:
    """A sweep on disk. Make one with `create` or `open_store`.

    Fields: folder; content: of plan.json; claims.
    """

    def __init__(self, folder: Path):
        self.folder = Path(folder)
        self.chunks = self.folder / "chunks"
        self.content: dict[str, Any] = json.loads((self.folder / "plan.json").read_text(encoding="utf-8"))
        self.claims = Claims(self.folder / "claims")

    @classmethod
    def create(cls, root, plan: SweepPlan, chunk: int) -> "SweepStore":
        """The store of a plan, made if needed; one that is there keeps the size of its chunks."""
        folder = Path(root) / plan.hash()
        (folder / "chunks").mkdir(parents=True, exist_ok=True)
        content = {
            "hash": plan.hash(),
            "chunk": chunk,
            "names": list(plan.uncertain.names),
            "dims": plan.uncertain.dims,
            "reductions": list(plan.model.reductions),
            "outputs": list(plan.model.outputs),
            "units": dict(plan.model.units),
            "times": np.asarray(plan.model.times, dtype=float).tolist(),
            "extendable": plan.sampler.extendable,
            "plan": plan.identity(),
        }
        write_new(folder / "plan.json", _json_text(content))
        return cls(folder)

    @property
    def chunk(self) -> int:
        """Lanes of a chunk."""
        return self.content["chunk"]

    def prepared(self, make: Callable[[], dict] | None = None) -> dict | None:
        """What the first worker fixed; `make` makes it where there is none yet."""
        path = self.folder / "prepared.json"
        if not path.exists():
            if make is None:
                return None
            write_new(path, _json_text(make()))
        return json.loads(path.read_text(encoding="utf-8"))

    def ask(self, thresholds: dict[str, list[float]], quantiles, title: str) -> None:
        """Note what the statistics are to say; it may change at any time."""
        content = {"thresholds": thresholds, "quantiles": list(quantiles), "title": title or self.content["hash"]}
        write_over(self.folder / "asked.json", _json_text(content))

    def asked(self) -> dict:
        """What the statistics are to say: thresholds of reductions, quantiles, title of the report."""
        path = self.folder / "asked.json"
        if not path.exists():  # its first run died at once
            return {"thresholds": {}, "quantiles": list(QUANTILES), "title": self.content["hash"]}
        return json.loads(path.read_text(encoding="utf-8"))

    # What is there

    def done(self) -> list[Piece]:
        """The pieces that are there, in order, none overlapping another."""
        found, position = [], 0
        ranges = [_range(path) for path in self.chunks.glob("*.parquet") if path.name[0].isdigit()]
        for start, stop in sorted(ranges, key=lambda ends: (ends[0], -ends[1])):
            if start >= position:
                found.append(Piece(start // self.chunk, start, stop))
                position = stop
        return found

    def pending(self, count: int, shard: tuple[int, int] = (1, 1)) -> list[Piece]:
        """What is missing of `count` lanes, cut at borders of chunks; shard (i, n): every n-th chunk from the i-th."""
        missing, position = [], 0
        for piece in [*self.done(), Piece(0, count, count)]:
            while position < min(piece.start, count):
                number = position // self.chunk
                stop = min((number + 1) * self.chunk, piece.start, count)
                missing.append(Piece(number, position, stop))
                position = stop
            position = max(position, piece.stop)
        return [piece for piece in missing if piece.chunk % shard[1] == shard[0] - 1]

    def check(self) -> list[str]:
        """Set damaged chunks aside, to be computed again, and remove what dead writers left. Returns notes."""
        notes = []
        self.claims.clear()
        for piece in self.done():
            reason = self._damage(piece)
            if reason:
                notes.append(f"{self._path(piece).name} was damaged ({reason}): set aside, to be computed again")
                self.set_aside(piece)
        for left in self.chunks.glob(".tmp-*"):
            with contextlib.suppress(OSError):
                if left.stat().st_mtime < self._newest_time() - 3600.0:
                    left.unlink()
        for note in notes:
            self.log({"event": "damage", "note": note})
        return notes

    def set_aside(self, piece: Piece) -> None:
        """Rename a damaged chunk so that it counts as missing."""
        for path in (self._path(piece), self._path(piece).with_suffix(".npz")):
            if path.exists():
                os.replace(path, path.with_name(f"damaged-{uuid.uuid4().hex[:8]}-{path.name}"))

    def _newest_time(self) -> float:
        return max((path.stat().st_mtime for path in self.chunks.iterdir()), default=0.0)

    def _damage(self, piece: Piece) -> str:
        """What is wrong with a chunk; empty when nothing is seen without reading it all."""
        from pyarrow import ArrowException, parquet

        path = self._path(piece)
        try:
            rows = parquet.read_metadata(path).num_rows
        except (ArrowException, OSError) as error:
            return str(error).splitlines()[0][:80]
        if rows != piece.stop - piece.start:
            return f"{rows} rows"
        return "" if not self.content["outputs"] or path.with_suffix(".npz").exists() else "no series"

    def has(self, piece: Piece) -> bool:
        """Whether a piece is there, as one file."""
        return self._path(piece).exists()

    # Writing and reading

    def _path(self, piece: Piece) -> Path:
        return self.chunks / f"{piece.start:010d}-{piece.stop:010d}.parquet"

    def write(self, piece: Piece, columns: dict[str, np.ndarray], series: dict[str, np.ndarray]) -> None:
        """Write a chunk; its table last, so that a chunk with a table is complete."""
        import pyarrow
        from pyarrow import parquet

        if self.content["outputs"]:
            path = self._path(piece).with_suffix(".npz")
            with contextlib.suppress(FileNotFoundError):
                path.unlink()  # of a writer that died between the two files
            write_new(path, lambda temporary: _savez(temporary, series))
        table = pyarrow.table(columns)
        write_new(self._path(piece), lambda path: parquet.write_table(table, path, **PARQUET))

    def tables(self, columns: list[str] | None = None) -> Iterator[tuple[Piece, dict[str, np.ndarray]]]:
        """The chunks in order: piece, name -> column. Raises OSError, naming the chunk, for a damaged one."""
        from pyarrow import ArrowException, parquet

        for piece in self.done():
            try:
                table = parquet.read_table(self._path(piece), columns=columns, page_checksum_verification=True)
            except (ArrowException, OSError) as error:
                self.set_aside(piece)
                raise OSError(
                    f"{self._path(piece)} is damaged and was set aside: resume the sweep to compute it again ({error})"
                ) from error
            yield piece, {name: table[name].to_numpy() for name in table.column_names}

    def series(self) -> Iterator[tuple[Piece, dict[str, np.ndarray]]]:
        """The sketches and kept series of the chunks, in order."""
        for piece in self.done():
            path = self._path(piece).with_suffix(".npz")
            if path.exists():
                with np.load(path) as found:
                    yield piece, dict(found)

    # The manifest

    def log(self, event: dict) -> None:
        """Add a line to the manifest; one write, so that those of several processes do not mix."""
        path = self.folder / "manifest.jsonl"
        line = json.dumps(event, ensure_ascii=False) + "\n"
        descriptor = os.open(path, os.O_CREAT | os.O_RDWR | os.O_APPEND, 0o644)
        try:
            size = os.fstat(descriptor).st_size
            torn = size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"
            os.write(descriptor, (("\n" if torn else "") + line).encode())
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def manifest(self) -> tuple[list[dict], int]:
        """The events of the manifest, and how many lines could not be read (torn by a crash)."""
        path, events, torn = self.folder / "manifest.jsonl", [], 0
        for line in path.read_bytes().splitlines() if path.exists() else []:
            try:
                events.append(json.loads(line))
            except ValueError:
                torn += bool(line.strip())
        return events, torn


PARQUET: dict[str, Any] = {
    "write_page_checksum": True,
    "compression": "zstd",
    "use_dictionary": False,
    "row_group_size": ROW_GROUP,
}
"""How tables are written: sums of their pages show a flipped bit when they are read; numbers of which hardly two are
equal want no dictionary."""


def _savez(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Arrays into one compressed file."""
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]


def _range(path: Path) -> tuple[int, int]:
    start, stop = path.stem.split("-")
    return int(start), int(stop)


def stores_in(root) -> list[Path]:
    """The stores in a folder: itself, or those below it."""
    root = Path(root)
    return [root] if (root / "plan.json").is_file() else sorted(path.parent for path in root.glob("*/plan.json"))


def open_store(root) -> SweepStore:
    """The one store in a folder. Raises FileNotFoundError without one, ValueError for several."""
    found = stores_in(root)
    if not found:
        raise FileNotFoundError(f"{root}: there is no sweep in this folder")
    if len(found) > 1:
        raise ValueError(f"{root}: there are {len(found)} sweeps: name one, such as {found[0]}")
    return SweepStore(found[0])
