"""The entry point of the command line: sets up JAX before anything loads it, then runs the commands."""

import os
import sys

from jaxlines.edge.exit_codes import INTERRUPTED
from jaxlines.simulation.program_cache import default_cache_folder


def set_up_jax() -> None:
    """Cache compiled programs on disk, and make failed checks inside them NaN, without which they cannot be cached.

    Only environment variables that are not set; they count when JAX is imported, which must not have happened.
    """
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        folder = default_cache_folder()
        if folder is not None:
            os.environ["JAX_COMPILATION_CACHE_DIR"] = folder


def main() -> None:
    """Run the command line and exit with its code."""
    set_up_jax()
    try:
        from jaxlines.edge.commands import run

        sys.exit(run())
    except KeyboardInterrupt:
        print("jaxlines: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
