"""The shape of the package: floors, imports, sizes, docstrings, and what importing it does."""

import ast
import dataclasses
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

import jaxlines

ROOT = Path(jaxlines.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
FLOORS = {"physics": 0, "simulation": 1, "catalogue": 1, "inference": 2, "edge": 3}
LONGEST = 350


def module_name(path: Path) -> str:
    parts = ("jaxlines", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> set[str]:
    """Modules of jaxlines that a file imports, anywhere in it, with the names of submodules resolved."""
    known, found = {module_name(file) for file in FILES}, set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (inner & known) or {node.module}
    return {name for name in found if name and name.split(".")[0] == "jaxlines"}


GRAPH = {module_name(path): imports(path) for path in FILES}


def floor(module: str) -> int:
    """Floor of a module; the package itself collects what users need and stands with the edge."""
    parts = module.split(".")
    return FLOORS[parts[1]] if len(parts) > 1 else FLOORS["edge"]


def test_every_folder_is_on_a_floor():
    assert {path.relative_to(ROOT).parts[0] for path in FILES if path.parent != ROOT} <= set(FLOORS)


def test_imports_go_down_only():
    up = [f"{module} -> {to}" for module, used in GRAPH.items() for to in used if floor(to) > floor(module)]
    assert not up


def test_only_the_edge_imports_the_catalogue():
    below = {module: used for module, used in GRAPH.items() if floor(module) < 3 and ".catalogue" not in module}
    assert not [f"{module} -> {to}" for module, used in below.items() for to in used if ".catalogue" in to]


def test_imports_have_no_circle():
    done: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " -> ".join((*trail, module))
        if module not in done:
            for to in GRAPH.get(module, ()):
                visit(to, (*trail, module))
            done.add(module)

    for module in GRAPH:
        visit(module, ())
    assert len(done) >= len(GRAPH)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_files_are_short(path):
    assert len(path.read_text().splitlines()) <= LONGEST


def modules():
    return [importlib.import_module(name) for name in GRAPH]


def test_every_public_name_has_a_docstring():
    missing = []
    for module in modules():
        if not inspect.getdoc(module):
            missing.append(module.__name__)
        for name, thing in vars(module).items():
            if name.startswith("_") or getattr(thing, "__module__", None) != module.__name__:
                continue
            if inspect.isclass(thing):
                written = '"""' in inspect.getsource(thing).split("\n    def ")[0]
                methods = [n for n, m in vars(thing).items() if inspect.isfunction(m) and not n.startswith("_")]
                missing += [f"{module.__name__}.{name}.{n}" for n in methods if not inspect.getdoc(getattr(thing, n))]
                missing += [] if written else [f"{module.__name__}.{name}"]
            elif inspect.isfunction(thing) and not inspect.getdoc(thing):
                missing.append(f"{module.__name__}.{name}")
    assert not missing


def test_numbers_of_physical_objects_are_arrays():
    """A plain float would compile anew for each value and have no gradient."""
    plain, numbers = [], 0
    for module in modules():
        for thing in vars(module).values():
            if not (inspect.isclass(thing) and issubclass(thing, eqx.Module) and dataclasses.is_dataclass(thing)):
                continue
            for field in dataclasses.fields(thing):
                converter = field.metadata.get("converter")
                if field.type in (float, int, complex) and not field.metadata.get("static"):
                    plain.append(f"{thing.__name__}.{field.name}")
                if "unit" in field.metadata:
                    numbers += 1
                    if converter is None or not isinstance(converter(1), np.ndarray) or converter(1).dtype != float:
                        plain.append(f"{thing.__name__}.{field.name}")
    assert not plain
    assert numbers > 50


IMPORT = """
import os, sys, warnings
import jax, diffrax, equinox, optimistix, jaxtyping, numpy
before = set(sys.modules)
state = jax.config.values.copy(), dict(os.environ), list(warnings.filters), numpy.geterr(), numpy.get_printoptions()
import jaxlines
jaxlines.simulate, jaxlines.Circuit, jaxlines.fit
assert state == (jax.config.values, dict(os.environ), list(warnings.filters), numpy.geterr(), numpy.get_printoptions())
new = {name.split(".")[0] for name in set(sys.modules) - before}
heavy = {"scipy", "pandas", "matplotlib", "pint", "xarray", "pydantic", "jinja2", "typer", "pyarrow"}
print(*sorted(new & heavy))
"""


def test_importing_changes_nothing_global_and_loads_nothing_heavy():
    done = subprocess.run([sys.executable, "-c", IMPORT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""
