"""Who works on which chunk: claims on a shared folder, without a server."""

import contextlib
import json
import os
import socket
import threading
import time
from pathlib import Path

STALE_SECONDS = 180.0
HEARTBEAT_SECONDS = 20.0


def _read(path: str) -> str:
    try:
        return Path(path).read_text().strip()
    except OSError:
        return ""


def _place() -> str:
    """The machine, and where process numbers mean the same (a container has its own)."""
    with contextlib.suppress(OSError):
        return f"{socket.gethostname()} {_read('/proc/sys/kernel/random/boot_id')} {os.readlink('/proc/self/ns/pid')}"
    return socket.gethostname()


def _born(pid: int) -> str:
    """When a process started, in ticks, so that a reused number is not taken for it; empty where that is unknown."""
    text = _read(f"/proc/{pid}/stat")
    return text.rpartition(")")[2].split()[19] if text else ""


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


class Claims:
    """Claims on the chunks of a store.

    A claim is a file "CHUNK.GENERATION", made so that only one process can make it. The owner is that of the highest
    generation; who finds it dead makes the next one, so that two that find it dead at once cannot both win. A claim is
    dead when its process on this machine is gone, or, from elsewhere, when nobody touched it for three minutes.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.held: dict[int, Path] = {}
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def take(self, chunk: int) -> bool:
        """Claim a chunk. Returns False when somebody alive has it."""
        self.folder.mkdir(exist_ok=True)
        newest = self._newest(chunk)
        if newest is not None and not self._is_dead(newest):
            return False
        generation = 0 if newest is None else int(newest.suffix[1:]) + 1
        path = self.folder / f"{chunk:09d}.{generation}"
        try:
            descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
        except FileExistsError:
            return False
        with os.fdopen(descriptor, "w") as file:
            json.dump({"place": _place(), "pid": os.getpid(), "born": _born(os.getpid())}, file)
        self.held[chunk] = path
        self._beat()
        return True

    def release(self, chunk: int) -> None:
        """Give a chunk back; older claims on it go too."""
        path = self.held.pop(chunk, None)
        if path is not None:
            for file in self.folder.glob(f"{chunk:09d}.*"):
                if int(file.suffix[1:]) < int(path.suffix[1:]):
                    file.unlink(missing_ok=True)
            path.unlink(missing_ok=True)

    def clear(self) -> None:
        """Remove the claims of the dead, which nobody may ever take over (their chunk was written before they died)."""
        for path in self.folder.glob("*.*"):
            if self._is_dead(path):
                path.unlink(missing_ok=True)

    def living(self) -> int:
        """How many chunks somebody alive has."""
        return sum(not self._is_dead(path) for path in self.folder.glob("*.*"))

    def close(self) -> None:
        """Give everything back."""
        self._stop.set()
        for chunk in list(self.held):
            self.release(chunk)

    def _newest(self, chunk: int) -> Path | None:
        return max(self.folder.glob(f"{chunk:09d}.*"), key=lambda path: int(path.suffix[1:]), default=None)

    def _is_dead(self, path: Path) -> bool:
        try:
            age, text = time.time() - path.stat().st_mtime, path.read_text()
        except FileNotFoundError:  # given back meanwhile
            return False
        try:
            owner = json.loads(text)
        except json.JSONDecodeError:  # being written, or its writer died
            return age > STALE_SECONDS
        if owner["place"] == _place():
            born = _born(owner["pid"])
            return not _lives(owner["pid"]) or bool(born and owner["born"] and born != owner["born"])
        return age > STALE_SECONDS

    def _beat(self) -> None:
        """Touch what is held from time to time, so that other machines see that it is alive."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._touch, daemon=True)
            self._thread.start()

    def _touch(self) -> None:
        while not self._stop.wait(HEARTBEAT_SECONDS):
            for path in list(self.held.values()):
                with contextlib.suppress(OSError):
                    os.utime(path)
