"""The benchmark problem of ensembles and its peers, at a small size."""

import importlib
import importlib.util
import shutil
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "experiments"


@pytest.fixture
def load(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module


@pytest.fixture
def axis(load):
    return load("servo_axis")


def needs(package: str):
    return pytest.mark.skipif(importlib.util.find_spec(package) is None, reason=f"{package} is not installed")


needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")


def test_circuit_and_plain_statement_agree(axis):
    """Rates of the circuit from components against the formulas in the head of the file."""
    assert axis.right_hand_side_difference(200) < 1e-12
    assert axis.right_hand_side_difference(200, axis.STIFF) < 1e-12


def test_the_rates_are_those_worked_out_by_hand(axis):
    """No air, spool shut, no leakage: the motor pumps K/V D w out of one line into the other."""
    columns = axis.lane_numbers(1) | {"air_ratio": np.zeros(1), "leakage": np.zeros(1), "bulk_modulus": np.full(1, 1e9)}
    rates = axis.right_hand_side(np)((8e6, 5e6, 2.0, 0.0, 0.0), 0.5, axis.matrix(columns)[0])
    frequency = columns["spool_frequency"][0]
    expected = (-1e9 / 0.0271 * 2e-4, 1e9 / 0.0277 * 2e-4, (300.0 - 4.0) / columns["inertia"][0], 0.0)
    np.testing.assert_allclose(rates[:4], expected, rtol=1e-13)
    assert rates[4] == pytest.approx(0.5 * frequency**2)


def test_reference_of_two_methods_agree(axis):
    """DOP853 of lanes together, and LSODA of one alone; in the stiff variant as well."""
    for variant in (axis.AXIS, axis.STIFF):
        columns = {name: value[:1] for name, value in axis.lane_numbers(8, variant=variant).items()}
        one = _short_reference(axis, columns, "DOP853")
        other = _short_reference(axis, columns, "LSODA")
        assert np.abs(one - other).max() < 1.0
        assert np.ptp(one) > 1e5


def _short_reference(axis, columns, method):
    """The first 20 intervals only."""
    kept, axis.SAMPLES = axis.SAMPLES, 21
    try:
        return axis.reference(columns, [0], 1e-9, method).pressure
    finally:
        axis.SAMPLES = kept


@pytest.fixture(scope="module")
def truth():
    """Columns of 64 lanes and the reference of two of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        axis = importlib.import_module("servo_axis")
    columns = axis.lane_numbers(64)
    return columns, axis.reference(columns, [0, 41], 1e-9)


def test_errors_count_what_failed(load, axis):
    """Lanes that are not finite or far off are failed, the others compared by their index."""
    peers = load("ensemble_peers")
    reference = axis.Reference(np.array([1, 3, 4]), np.full((3, 5), 1e6))
    pressure = np.full((4, 5), 1e6)
    pressure[1] += [3.0, 0.0, 0.0, 0.0, 4.0]
    pressure[3, 2] = np.nan
    found = peers.errors(pressure, reference)
    assert (found.largest, found.failed) == (4.0, 1)
    assert found.rms == pytest.approx(np.sqrt(5.0))
    assert peers.errors(pressure[:1], reference) == (None, None, 0)
    assert peers.errors(pressure[1:2], reference, np.array([3])).largest == 4.0


def test_a_missing_peer_is_reported(load):
    """It gives its reason and no row; the others run."""
    peers = load("ensemble_peers")

    def absent():
        raise peers.Missing("no such package")

    row = peers.Row("a", "float64", "", 1, 10.0, 5.0, 6.0, 0.0, 0, False)
    rows, missing = peers.attempted({"absent": absent, "there": lambda: [row, row._replace(sims_per_second=20.0)]})
    assert missing == {"absent": "Missing: no such package"}
    assert peers.equal_accuracy(rows, 5.0).sims_per_second == 20.0
    assert peers.equal_accuracy(rows, 4.9) is None


@needs("numba")
@pytest.mark.slow
def test_numba_peer(load, truth):
    """Its error falls with its tolerance, in both precisions; compiling takes some 5 s each."""
    peers, numba = load("ensemble_peers"), load("ensemble_peers_numba")
    columns, reference = truth
    for precision in ("float64", "float32"):
        found = [
            peers.errors(numba.dopri5(columns, tolerance, precision, 1).pressure, reference)
            for tolerance in (1e-4, 1e-6)
        ]
        assert found[0].rms < 1500.0
        assert found[1].rms < 50.0


@needs_gcc
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_simd_bound(load, truth, precision):
    """Both builds solve the problem. Its order shows until the spool first crosses its sharp centre, at 0.46 s."""
    peers, bound = load("ensemble_peers"), load("ensemble_peers_c")
    columns, reference = truth
    runs = {n: bound.simd_c(columns, n, precision, repeats=1).pressure for n in (3, 6, 24)}
    assert peers.errors(runs[3], reference).rms < 500.0
    assert peers.errors(runs[24], reference).rms < 20.0
    if precision == "float64":
        early = reference._replace(pressure=reference.pressure[:, :26])
        coarse, fine = (peers.errors(runs[n][:, :26], early).rms for n in (3, 6))
        assert fine < coarse / 8.0
    plain = bound.simd_c(columns, 24, precision, bound.PLAIN, 1).pressure
    assert peers.errors(plain, reference).rms < 20.0
    assert not bound.library(precision).calls_libmvec


@needs("numba")
@pytest.mark.slow
def test_one_by_one_peers(load, truth):
    """CVODE, SciPy and CasADi (those that are there) solve the two lanes of the reference."""
    peers, single = load("ensemble_peers"), load("ensemble_peers_sundials")
    columns, reference = truth
    runs = {
        "cvode": lambda: single.cvode(columns, reference.lanes, 1e-6),
        "lsoda": lambda: single.scipy_solver(columns, reference.lanes, 1e-6),
        "rk45": lambda: single.scipy_solver(columns, reference.lanes, 1e-6, "RK45"),
        "casadi": lambda: single.casadi_solver(columns, reference.lanes, 1e-6),
        "casadi rk": lambda: single.casadi_solver(columns, reference.lanes, 4, "rk"),
    }
    for name, run in runs.items():
        try:
            found = peers.errors(run().pressure, reference, reference.lanes)
        except peers.Missing:
            continue
        assert found.rms is not None and found.rms < 300.0, name


@pytest.mark.slow
def test_diffrax_peers(load, axis, truth):
    """vmap over chunks gives lanes back in their order, on the circuit as well; Kvaerno5 solves the same problem."""
    peers, vmapped = load("ensemble_peers"), load("ensemble_peers_diffrax")
    columns, reference = truth
    found = peers.errors(vmapped.vmap_tsit5(columns, 1e-5, chunk=24, repeats=1).pressure, reference)
    assert (found.failed, found.rms < 300.0) == (0, True)
    found = peers.errors(vmapped.vmap_circuit(columns, 1e-5, repeats=1).pressure, reference)
    assert (found.failed, found.rms < 300.0) == (0, True)
    few = {name: value[[0, 41]] for name, value in columns.items()}
    run = vmapped.vmap_kvaerno5(few, 1e-5, repeats=1)
    assert peers.errors(run.pressure, reference, reference.lanes).rms < 300.0


@pytest.mark.slow
def test_line_variant(load):
    """A short ladder by vmap(diffrax) against SciPy on the same circuit; first lanes do not depend on the count."""
    peers, vmapped, line, axis = (
        load(n) for n in ("ensemble_peers", "ensemble_peers_diffrax", "line_problem", "servo_axis")
    )
    import jax

    columns = line.varied(2)
    assert all(np.array_equal(columns[path], line.varied(5)[path][:2]) for path in columns)
    reference = line.reference(columns, [1], 1e-8, segments=4)
    with jax.enable_x64(True):
        lane = vmapped.circuit_lane(line.program(4), line.OUTPUT, axis.times)
    run = vmapped.vmap_diffrax(np.stack(list(columns.values()), axis=-1), lane, 1e-6, repeats=1)
    assert peers.errors(run.pressure, reference).rms < 100.0
    assert np.ptp(reference.pressure) > 1e6
