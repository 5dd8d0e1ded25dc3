"""How many lanes of an ensemble run at once, in how many threads and on which devices."""

import contextlib
import os

import jax

CACHE_BYTES = 3_000_000
"""Bytes of a chunk's arrays that should stay in the caches of a core."""

FEWEST, MOST_ON_CPU, MOST_ON_GPU = 128, 8192, 131072
"""Lanes of a chunk. They are multiples of 128, so that every lane is computed by the same vector instructions and
results do not depend on the size of the chunk."""

DEVICE_SHARE = 0.25
"""Share of a device's memory for the arrays of a chunk: the compiler keeps copies, and two chunks may overlap."""

UNKNOWN_BYTES = 4_000_000_000
"""Memory of a device that does not tell how much it has."""


def workers() -> int:
    """Threads that run chunks: one for each core that this process may use, or for each other device."""
    if jax.default_backend() != "cpu":
        return jax.local_device_count()
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def devices() -> list:
    """The devices that chunks are dealt out to in turn: all of the kind that JAX prefers, or the one it was told."""
    told = getattr(jax.config, "jax_default_device")  # noqa: B009, since stubs do not know it
    return jax.local_devices() if told is None or isinstance(told, str) else [told]


def on_device(device):
    """A context in which arrays are made on a device; none where there is no choice, which programs would notice."""
    return jax.default_device(device) if len(devices()) > 1 else contextlib.nullcontext()


def device_bytes() -> int:
    """Memory of the smallest device [bytes]."""
    found = [device.memory_stats() or {} for device in devices()]
    return min(int(stats.get("bytes_limit", UNKNOWN_BYTES)) for stats in found)


def cpu_chunk(lanes: int, lane_bytes: float, workers: int) -> int:
    """Lanes at once on a processor. Args: lanes in all; lane_bytes: of the arrays of a lane; workers: threads."""
    fits = FEWEST * max(int(CACHE_BYTES / (FEWEST * lane_bytes)), 1)
    # Few sizes, so that programs serve other numbers of lanes too; the largest of those that are done first.
    sizes = [size for k in range(7, 14) for size in (2**k, 3 * 2 ** (k - 1)) if not size % FEWEST]
    sizes = [size for size in sizes if size <= min(fits, MOST_ON_CPU)] or [FEWEST]
    if lanes >= 4 * sizes[-1] * workers:
        return sizes[-1]
    return min(reversed(sizes), key=lambda size: -(-lanes // (size * workers)) * size)


def gpu_chunk(lanes: int, lane_bytes: float, memory: int) -> int:
    """Lanes at once on other devices: all of them if the memory [bytes] has room, a power of two of them."""
    most = max(DEVICE_SHARE * memory / lane_bytes, FEWEST)
    fits = 1 << (int(most).bit_length() - 1)
    wanted = 1 << max(int(lanes) - 1, FEWEST - 1).bit_length()
    return min(wanted, fits, MOST_ON_GPU)


def checked_chunk(chunk: int) -> int:
    """The size of a chunk. Raises: ValueError unless it is a multiple of 128."""
    if chunk < FEWEST or chunk % FEWEST:
        raise ValueError(f"chunk must be a multiple of {FEWEST} lanes, got {chunk}")
    return int(chunk)
