"""How the tests compile: with little optimisation, but for those of the machine code itself.

Compiling takes most of the time of the tests, and most of it goes into optimising programs that run for milliseconds.
The tests of ensembles, of sweeps and of whole studies compile as users do: equality to the last bit, accuracy of
vectorised functions and speed depend on it. JAX_DISABLE_MOST_OPTIMIZATIONS=0 (or 1) in the environment decides for all.
"""

import gc
import os
from pathlib import Path

import jax
import pytest

HERE = Path(__file__).parent
FOLDERS = ("physics", "simulation", "inference", "edge")  # the others compile as users do
AS_USERS_DO = (  # beginnings of names in these folders
    *("test_batch", "test_block", "test_circuit_sweep", "test_closed_forms", "test_ensemble", "test_expression"),
    *("test_lockstep", "test_problem_checkpoint", "test_rosenbrock", "test_speed", "test_sweep"),
)
QUICKLY = pytest.StashKey[bool]()
DECIDED = "JAX_DISABLE_MOST_OPTIMIZATIONS" in os.environ


def compiles_quickly(item: pytest.Item) -> bool:
    """Whether the programs of a test are compiled with little optimisation."""
    if HERE not in item.path.parents:
        return False
    parts = item.path.relative_to(HERE).parts
    return parts[0] in FOLDERS and not parts[-1].startswith(AS_USERS_DO)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of either kind run together: the programs of one kind are forgotten where the other begins."""
    items.sort(key=compiles_quickly)
    gc.freeze()  # modules live to the end: the collector need not look at them again and again
    gc.set_threshold(50_000, 20, 20)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Choose how a test compiles."""
    quickly = compiles_quickly(item)
    if not DECIDED and quickly != item.config.stash.get(QUICKLY, False):
        jax.clear_caches()
        jax.config.update("jax_disable_most_optimizations", quickly)
        item.config.stash[QUICKLY] = quickly
