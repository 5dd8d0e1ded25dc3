"""What is released: a source archive from which the wheel is built, and a wheel that works where it is installed."""

import importlib.metadata
import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import build
import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "jaxlines"
IMPORT_SECONDS = 2.0
"""What the import of jaxlines with JAX and all that a fit needs may take [s of the processor]."""


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> tuple[Path, Path]:
    """The source archive, and the wheel built from what is in it and nothing else."""
    folder = tmp_path_factory.mktemp("dist")
    archive = Path(build.ProjectBuilder(ROOT, runner=quietly).build("sdist", folder))
    with tarfile.open(archive) as content:
        content.extractall(folder / "unpacked", filter="data")
    (unpacked,) = (folder / "unpacked").iterdir()
    return archive, Path(build.ProjectBuilder(unpacked, runner=quietly).build("wheel", folder))


def quietly(cmd, cwd=None, extra_environ=None) -> None:
    """Run a step of the build. Raises CalledProcessError with what it printed."""
    subprocess.run(cmd, cwd=cwd, env={**os.environ, **(extra_environ or {})}, check=True, capture_output=True)


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory) -> Path:
    """The programs of a fresh environment with the wheel, which borrows the dependencies of this one."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    if not python.exists():
        pytest.skip("virtual environments have another layout here")
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--no-deps", "--no-index"]
    quietly([*pip, "--disable-pip-version-check", str(built[1])])
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return folder / "bin"


def run(program: Path, *arguments: str) -> str:
    """What a program prints, away from the sources."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(
        [str(program), *arguments], cwd=program.parent, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_wheel_holds_the_package_and_only_it(built):
    with zipfile.ZipFile(built[1]) as wheel:
        names = {name for name in wheel.namelist() if not name.endswith("/")}
        tops = {name.split("/")[0] for name in names}
        (about,) = tops - {"jaxlines"}
        metadata = wheel.read(f"{about}/METADATA").decode()
        commands = wheel.read(f"{about}/entry_points.txt").decode()
    here = [path for path in SOURCE.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    assert {path.relative_to(ROOT / "src").as_posix() for path in here} <= names
    assert {"jaxlines/py.typed", f"{about}/licenses/LICENSE"} <= names
    assert any(name.startswith("jaxlines/examples/") and name.endswith(".toml") for name in names)
    assert any(name.startswith("jaxlines/edge/templates/") for name in names)
    assert "License-Expression: Apache-2.0" in metadata
    assert "# jaxlines" in metadata  # the README, which the package index shows
    assert "jaxlines = jaxlines.edge.main:main" in commands


def test_the_source_archive_holds_tests_and_documents(built):
    with tarfile.open(built[0]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    for name in ("LICENSE", "CHANGELOG.md", "CITATION.cff", "README.md", "mkdocs.yml", "pyproject.toml", ".ci/run"):
        assert name in names
    for folder, pattern in (("tests", "test_*.py"), ("docs", "*.md"), ("experiments", "*.py"), ("src", "*.py")):
        here = {path.relative_to(ROOT).as_posix() for path in (ROOT / folder).rglob(pattern)}
        assert here
        assert here <= names
    assert built[0].stat().st_size < 5_000_000


def test_the_installed_package_is_imported_quickly_and_finds_its_files(installed):
    code = (
        "import time, jaxlines; jaxlines.fit; took = time.process_time(); "
        "from jaxlines.edge.report_page import _environment; "
        "[_environment().get_template(f'{name}report.html.jinja') for name in ('', 'sweep_', 'design_')]; "
        "print(took, len(jaxlines.load_study('example:control-line').title), jaxlines.__file__)"
    )
    tries = [run(installed / "python", "-c", code).split(" ", 2) for _ in range(2)]
    took, title, place = min(tries, key=lambda found: float(found[0]))
    assert Path(place).is_relative_to(installed.parent.resolve()), place
    assert int(title) > 0
    assert float(took) < IMPORT_SECONDS


def test_the_installed_command_tells_its_version_and_help(installed):
    version = importlib.metadata.version("jaxlines")
    assert run(installed / "jaxlines", "--version") == f"jaxlines {version}"
    assert "simulate" in run(installed / "jaxlines", "--help")
