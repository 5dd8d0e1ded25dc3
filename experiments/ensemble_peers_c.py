"""The bound: the same fixed-step scheme in C, for the compiler's SIMD instructions and all cores.

`PLAIN` is what one writes first: the problem as stated, libmvec, no more flags than any. `BEST` is as
fast as C got: only the open lands, polynomials in the loop, unrolled. What it computes is the same.
"""

import ctypes
import functools
import itertools
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ensemble_peers import CORES, Missing, Run, best_seconds, in_threads
from ensemble_peers_c_source import c_source
from servo_axis import SAMPLES, command, matrix, times

FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-fPIC", "-c")


class Build(NamedTuple):
    """How the bound is built.

    mathematics: "libmvec" or "inline"; lands: "all" or "open"; flags: besides FLAGS; width: lanes in a block.
    """

    mathematics: str
    lands: str
    flags: tuple[str, ...] = ()
    width: int = 64


PLAIN = Build("libmvec", "all")
BEST = Build("inline", "open", ("-funroll-loops",))


class Library(NamedTuple):
    """The compiled function, the seconds that took, and whether it calls vector functions of libmvec."""

    function: Any
    seconds: float
    calls_libmvec: bool


@functools.cache
def library(precision: str, build: Build = BEST) -> Library:
    """The bound, compiled. Raises: Missing without a compiler, or when that fails."""
    compiler = shutil.which("gcc")
    if compiler is None:
        raise Missing("no gcc on this machine")
    with tempfile.TemporaryDirectory(prefix="simd_bound_") as folder:
        source, part, target = (Path(folder) / f"bound.{kind}" for kind in ("c", "o", "so"))
        source.write_text(c_source(precision, build.mathematics, build.lands, build.width), encoding="utf-8")
        # Linked without -ffast-math, which would make the whole process flush small numbers to zero.
        orders = [
            [compiler, *FLAGS, *build.flags, str(source), "-o", str(part)],
            [compiler, "-shared", str(part), "-o", str(target), *build.flags, "-lm"],
        ]
        began = time.perf_counter()
        for order in orders:
            built = subprocess.run(order, capture_output=True, text=True, check=False)
            if built.returncode:
                raise Missing(f"gcc could not compile the bound: {built.stderr[-500:]}")
        seconds = time.perf_counter() - began
        function, calls = ctypes.CDLL(str(target)).simulate, b"_ZGV" in target.read_bytes()
    real = ctypes.c_double if precision == "float64" else ctypes.c_float
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    function.argtypes = [pointer, pointer, real, integer, integer, ctypes.c_long, pointer]
    function.restype = None
    return Library(function, seconds, calls)


def simd_c(columns, steps: int, precision: str = "float64", build: Build = BEST, repeats: int = 3) -> Run:
    """All lanes with `steps` steps between samples, blocks of lanes on all cores.

    Args: columns; steps; precision; build; repeats, of which the fastest counts. Raises: Missing.
    """
    compiled, numbers = library(precision, build), matrix(columns).astype(precision)
    blocks = -(-len(numbers) // build.width)
    padded = np.concatenate([numbers, np.repeat(numbers[-1:], blocks * build.width - len(numbers), axis=0)])
    packed = np.ascontiguousarray(padded.reshape(blocks, build.width, -1).swapaxes(1, 2))
    u, out = command.astype(precision), np.empty((blocks, build.width, SAMPLES), precision)
    bounds, interval = np.linspace(0, blocks, CORES + 1).astype(int), float(times[1] - times[0])

    def work(piece: slice) -> None:
        given, shown = packed[piece], out[piece]
        compiled.function(given.ctypes.data, u.ctypes.data, interval, SAMPLES, steps, len(given), shown.ctypes.data)

    pieces = [slice(a, b) for a, b in itertools.pairwise(bounds) if b > a]
    seconds = best_seconds(lambda: in_threads(work, pieces), repeats)
    return Run(out.reshape(-1, SAMPLES)[: len(numbers)], seconds, compiled.seconds)
