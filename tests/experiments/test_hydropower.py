"""The waterway study: on a small plant computed here with NumPy, and on the real recording where it is."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "experiments"))

import hydropower_surge as study  # noqa: E402  # pyright: ignore[reportMissingImports]
from surge_data import MissingData, Series, read_geometry, read_series, rough_loss, surge_period  # noqa: E402  # pyright: ignore[reportMissingImports]
from surge_model import Waterway, rest_period  # noqa: E402  # pyright: ignore[reportMissingImports]

GEOMETRY = """element,order,L_m,H_drop_m,D_m,roughness_m,note
reservoir,0,,,,,h_0=46.5 m
intake1,1,81.5,9,6.3,0.1,
intake2,2,4415,7,6.3,0.5,
surge_tank,4,87,75.5,3.4,0.1,h_0=62.5 m
penstock1,5,363,233,4.7,0.0005,
fitting,6,,,4.7->3.3,,
penstock2,7,145,105,3.3,0.0005,
tailwater,11,,,,,h_0=2
"""
TUNNEL, SHAFT, PENSTOCK, LOSS, THROTTLE = 1.45e5, 12.0, 4.0e4, 25.0, 50.0


def valve(times):
    """Flow [m^3/s]: rest, an opening within 60 s, load, a stop within 60 s, standstill."""
    return 30.0 * np.clip((times - 120.0) / 60.0, 0, 1) - 30.0 * np.clip((times - 520.0) / 60.0, 0, 1)


def plant(times, noise: float = 200.0, numbers=(TUNNEL, SHAFT, PENSTOCK, LOSS, THROTTLE)) -> Series:
    """Pressure of a rigid tunnel, a constant shaft and a rigid penstock by small explicit steps, and noise [Pa]."""
    tunnel, shaft, penstock, lost, throttle = numbers
    fine, step = 20, (times[1] - times[0]) / 20
    flow, level, pressure = 0.0, 0.0, np.empty(times.size)
    for k in range(times.size * fine):
        t = k * step
        q = float(valve(t))
        if k % fine == 0:
            slope = float(valve(t + 0.5) - valve(t - 0.5))
            pressure[k // fine] = 4e6 + 9806.65 * level - penstock * slope - throttle * q * abs(q)
        flow += step * (-9806.65 * level - lost * flow * abs(flow)) / tunnel
        level += step * (flow - q) / shaft
    rng = np.random.default_rng(3)
    return Series(times, pressure + noise * rng.standard_normal(times.size), valve(times))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The drawing of a plant."""
    made = tmp_path_factory.mktemp("plant")
    (made / "waterway_geometry.csv").write_text(GEOMETRY)
    return made


def test_geometry_gives_the_rigid_column_formula(folder):
    """2 pi sqrt(L A_s/(g A_t)) by hand: 4496.5 m, 6.3 m tunnel; 3.4 m shaft, 87 m long for 75.5 m of height."""
    geometry = read_geometry(folder)
    shaft, tunnel = np.pi / 4 * 3.4**2 * 87 / 75.5, np.pi / 4 * 6.3**2
    assert geometry.rigid_column_period == pytest.approx(
        2 * np.pi * np.sqrt(4496.5 * shaft / 9.80665 / tunnel), rel=1e-9
    )
    assert geometry.rest_height == pytest.approx(62.5)
    assert geometry.tunnel_inertance == pytest.approx(1000 * 4496.5 / tunnel)
    assert rest_period(geometry.tunnel_inertance, shaft) == pytest.approx(geometry.rigid_column_period)


def test_rough_loss_against_the_moody_chart():
    """Fully rough, e/D = 0.05: f = 0.0716 (Moody, 1944); the drop of 1 m/s over one diameter is f rho/2."""
    area = np.pi / 4
    assert rough_loss(1.0, 1.0, 0.05) * area**2 == pytest.approx(0.0716 * 500.0, rel=0.005)


@pytest.mark.parametrize("decay", [0.0, 4e-3])
def test_surge_period_of_a_damped_cosine(decay):
    t = np.arange(0.0, 600.0)
    rng = np.random.default_rng(0)
    values = 5.0 + 1e-3 * t + 0.4 * np.exp(-decay * t) * np.cos(2 * np.pi * t / 83.7 + 1.0)
    period, size = surge_period(t, values + 0.02 * rng.standard_normal(t.size))
    assert period == pytest.approx(83.7, abs=0.3)
    assert size == pytest.approx(0.4, rel=0.25)
    assert np.isnan(surge_period(t[:60], values[:60])[0])


def test_surge_window_is_the_longest_standstill_after_the_fit():
    t = np.arange(0.0, 2000.0)
    flow = np.where((t > 100) & (t < 1000), 30.0, 0.3)
    window = study.surge_window(Series(t, 0 * t, flow), 500.0)
    assert (t[window].min(), t[window].max()) == (1010.0, 1810.0)
    assert not study.surge_window(Series(t, 0 * t, 0 * t + 30.0), 500.0).any()


def test_the_circuit_is_the_rigid_column_in_small_steps(folder):
    """Both by the drawing's numbers, stop and surge included: within 0.05 bar rms of swings of 2 bar."""
    geometry, times = read_geometry(folder), np.arange(0.0, 900.0, 2.0)
    inertance = geometry.tunnel_inertance + geometry.shaft_inertance
    numbers = (inertance, geometry.shaft_area, geometry.penstock_inertance, geometry.tunnel_loss, 55.0)
    series = plant(times, 0.0, numbers)
    way = Waterway(geometry, series)
    channels = way.recording().channels
    inputs = {name: study.jl.Sampled(times, channels[name], "cubic") for name in ("flow", "flow_rate")}
    start = {"junction.pressure": way.rest_pressure, "tunnel.volume_flow": 0.0}
    shown = np.asarray(study.jl.simulate(way.circuit, times, inputs, initial=start, tolerance=1e-6)["gauge"])
    assert np.ptp(series.pressure) > 2e5
    assert np.sqrt(np.mean((shown - series.pressure) ** 2)) < 5e3


@pytest.mark.slow
def test_a_fit_of_the_start_foretells_stop_and_surge(folder, monkeypatch):
    """Start 30 % from the truth in the shaft: numbers are found, and stop and surge period predicted."""
    monkeypatch.setattr(study, "FITTED_UNTIL", 500.0)
    whole = plant(np.arange(0.0, 1000.0, 2.0))
    way = Waterway(read_geometry(folder), whole.until(500.0))
    fit = way.fit("constant shaft")
    assert fit.status in ("converged", "at_bound"), fit.message
    truth = 2 * np.pi * np.sqrt(TUNNEL * SHAFT / 9806.65)
    assert study.periods(fit, way)["fitted_s"] == pytest.approx(truth, rel=0.02)
    assert abs(study.periods(fit, way)["rigid_column_s"] / truth - 1) > 0.03
    assert fit.parameters["shaft.area"].value == pytest.approx(SHAFT, rel=0.05)
    assert fit.parameters["tunnel.quadratic_resistance"].value == pytest.approx(LOSS, rel=0.2)
    told = study.foretell(whole, study.simulated(fit, way, whole))
    assert told["validation_rmse_bar"] < 0.02
    assert abs(told["surge_period_relative_error"]) < 0.02
    assert told["surge_period_measured_s"] == pytest.approx(truth, rel=0.03)


def test_structures_that_do_not_help_are_named():
    scores = {"a": {"all": 0.05}, "b": {"all": 0.04}, "c": {"all": 0.06}, "d": {"all": 0.059}}
    assert study.not_wanted(scores) == ["c", "d"]


def test_the_figure_shows_structures_and_periods(tmp_path):
    """Also where part of the file was not fitted."""
    series = plant(np.arange(0.0, 800.0, 2.0))
    scores = {
        "a": {"opening": 0.06, "after it": 0.05, "all": 0.055},
        "b": {"opening": 0.1, "after it": 0.1, "all": 0.1},
    }
    names = ("fitted_s", "seen_at_rest_s", "rigid_column_s", "rigid_column_with_shaft_inertia_s")
    results = {"left_out_rmse_bar": scores, "structure": "a", "targets": study.TARGETS}
    results |= {"period": dict(zip(names, (88.0, 88.3, 78.0, 80.0), strict=True))}
    results |= {"surge_period_measured_s": 90.0, "surge_period_predicted_s": 89.0}
    name = study.draw(tmp_path, results, series, series.pressure + 1e3, 500.0)
    assert (tmp_path / name).stat().st_size > 20_000


def test_missing_data_says_where_to_get_them(tmp_path, folder):
    with pytest.raises(MissingData, match="OpenHPL"):
        read_geometry(tmp_path)
    with pytest.raises(MissingData, match="start_1hz"):
        read_series(folder)


def test_gaps_and_repeated_rows_are_dropped(tmp_path):
    table = pd.DataFrame(
        {"t_s": [0, 2, 1, 1], "p_turbine_in_bar": [40, 41, np.nan, 42], "turbine_flow_m3s": [0, 1, 2, 3.0]}
    )
    table.to_csv(tmp_path / "full_1hz.csv", index=False)
    series = read_series(tmp_path)
    assert series.times.tolist() == [0, 1, 2]
    assert series.pressure.tolist() == [40e5, 42e5, 41e5]


@pytest.mark.slow
def test_the_real_start(tmp_path):
    """The whole study; it names its targets itself."""
    data = os.environ.get("JAXLINES_HYDROPOWER_DATA")
    if not data:
        pytest.skip("JAXLINES_HYDROPOWER_DATA does not name a folder with the plant's recording")
    command = [sys.executable, ROOT / "experiments" / "hydropower_surge.py", "--data", data, "--out", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads((tmp_path / "results.json").read_text())["passed"]
