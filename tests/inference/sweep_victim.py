"""A sweep in a process of its own, to be killed: python -m tests.inference.sweep_victim FOLDER."""

import sys

from jaxlines.inference.samplers import MonteCarlo
from jaxlines.inference.sweep import run_sweep
from jaxlines.inference.sweep_plan import SweepPlan

from .sweep_cases import ANGLES, Analytic

PLAN = SweepPlan(Analytic("ishigami", ("a", "b", "c"), outputs=("wave",), pause=0.008), ANGLES, MonteCarlo(1))
COUNT = 2400


def main(folder: str) -> None:
    """Resume the sweep in a folder; say when the first chunk of this process is written."""
    run_sweep(PLAN, COUNT, store=folder, resume=True, chunk=16, progress=lambda p: print(p.done, flush=True))
    print("finished", flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
