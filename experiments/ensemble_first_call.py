"""Time to the first result of an ensemble in a fresh process: `python ensemble_first_call.py WHAT [CACHE]`.

WHAT is "ensemble" or "gradient"; CACHE a folder for compiled programs. Prints seconds after imports.
"""

import sys
import time


def main(what: str, cache: str | None) -> None:
    """Run one ensemble of the servo axis and print how long it took."""
    import jax.numpy as jnp
    import servo_axis as axis
    from ensemble_ours import axis_program

    import jaxlines as jl

    if cache:
        jl.cache_programs(cache)
    columns = axis.lane_numbers(4096)
    began = time.perf_counter()
    program = axis_program(columns, engine="explicit", steps=3, audit=0)
    if what == "gradient":
        jl.ensemble_gradient(
            program, lambda times, outputs: jnp.mean(outputs["A.pressure"], axis=0), axis.varied(columns)
        )
    else:
        program.run(axis.varied(columns))
    print(time.perf_counter() - began)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else None)
