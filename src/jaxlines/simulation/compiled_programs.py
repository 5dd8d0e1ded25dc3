"""How programs of lanes are compiled for a device, and which of them must not run side by side."""

import functools
import threading
from collections.abc import Callable
from typing import Any

import jax

LAPACK = threading.Lock()
"""Held while a program that factorises matrices in batches runs on the processor.

Each such program waits in one of XLA's threads for pieces that it has handed to the others; two of them at once can
wait for each other for ever (jaxlib 0.10, two cores, matrices of 16 by 16 and more).
"""


def compiler_options(platform: str, engine: str) -> dict[str, Any] | None:
    """What the compiler is told for a platform ("cpu", "gpu", ...) and an engine; None: nothing.

    On the processor, vectors of 512 bits where XLA prefers 256 (where there are none, it changes nothing). And its
    older way of making loops for all but the explicit engine: it compiles in half the time, and the steps of the
    implicit engine run up to twice as fast (jaxlib 0.10). Other compilers refuse these options.
    """
    if platform != "cpu":
        return None
    options: dict[str, Any] = {"xla_cpu_prefer_vector_width": "512", "xla_cpu_multi_thread_eigen": False}
    if engine != "explicit":
        options["xla_cpu_use_fusion_emitters"] = False
    return options if _known(tuple(options.items())) else None


@functools.cache
def _known(options: tuple[tuple[str, Any], ...]) -> bool:
    """Whether the compiler of this version takes some options."""
    try:
        jax.jit(lambda x: x + 1, compiler_options=dict(options)).lower(0).compile()
    except Exception:  # jaxlib raises errors of a class that it does not export
        return False
    return True


def calls_lapack(program: Any, platform: str) -> bool:
    """Whether a program (`LaneProgram`) factorises matrices in batches by LAPACK, which only the processor has."""
    import diffrax

    if platform != "cpu":
        return False
    if program.engine == "adaptive":
        return isinstance(program.method.solver, diffrax.AbstractImplicitSolver)
    return program.engine == "implicit" and program.dense


@functools.cache
def compiled(function: Callable, static: tuple[int, ...] = (0,)) -> Callable:
    """A function of lanes as a program of its own, for the device that JAX prefers.

    Args: function: its first argument is a `LaneProgram`; static: positions of the arguments that the program is
        compiled for. Programs that call LAPACK run one after another, whatever thread they are called from.
    """
    platform = jax.default_backend()
    programs = {
        engine: jax.jit(function, static_argnums=static, compiler_options=compiler_options(platform, engine))
        for engine in ("explicit", "implicit", "adaptive")
    }

    @functools.wraps(function)
    def call(program, *arguments):
        if not calls_lapack(program, platform):
            return programs[program.engine](program, *arguments)
        with LAPACK:
            return jax.block_until_ready(programs[program.engine](program, *arguments))

    return call
