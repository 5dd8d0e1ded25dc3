"""Ring-downs of the rotary actuators: where each run's stroke ends, and what was measured around it.

Input: `runs.parquet` (run_id, k, Angle, PG_1, PG_2 as raw ADC counts, 1 kHz) and `runs_index.csv` of the
Virginia Tech NSI actuator data set (github.com/vtnsi/actuator_dataset, MIT). Nothing here depends on the unit.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import savgol_filter

RATE = 1000.0  # samples per second
COUNTS_PER_TURN = 16384
BEFORE, AFTER = 30, 300  # samples of the window before and after the stop


@dataclasses.dataclass(frozen=True)
class Ringdown:
    """One run around its stop: pressure of the pressurised port, and the angle rate, in counts and seconds."""

    run_id: int
    unit: str
    port: str
    pressure: np.ndarray  # counts, shape (331,)
    rate: np.ndarray  # counts of angle per second, positive in the direction of the stroke
    approach: np.ndarray  # rate of a stroke that is not stopped: smooth, constant after the stop, counts/s
    clock: np.ndarray  # time since the stop, s
    hold: float  # pressure long after the stop, counts
    speed: float  # angle rate before the stop, counts/s
    first_pressure: float  # at the start of the window, mean of five samples
    half_period: float  # first peak to first trough, s

    @property
    def times(self) -> np.ndarray:
        """Seconds from the start of the window."""
        return np.arange(self.pressure.size) / RATE


def stop_index(stroke: np.ndarray, rate: np.ndarray) -> int:
    """Sample nearest to the end stop: the rate falls through half of its approach speed after 90 % of the stroke."""
    total = stroke[-500:].mean()
    early, late = int(np.argmax(stroke > 0.6 * total)), int(np.argmax(stroke > 0.9 * total))
    half = 0.5 * (stroke[late] - stroke[early]) / max(late - early, 1) * RATE
    below = late + int(np.argmax(rate[late:] < half))
    share = (rate[below - 1] - half) / max(rate[below - 1] - rate[below], 1e-9)
    return round(below - 1 + float(np.clip(share, 0.0, 1.0)))


def approach(stroke: np.ndarray, stop: int) -> tuple[np.ndarray, float]:
    """The stroke before its stop as a parabola, whose rate bears far less noise than the measured one.

    Args: stroke: angle [counts], shape (samples,); stop: sample nearest to the stop.
    Returns: rate of the parabola at every sample of the window, held after the stop [counts/s]; when the parabola
    reaches the angle at which the shaft comes to rest [s from sample `stop`].
    """
    last, count = stop - 5, int(min(100, stop // 3))
    parabola = np.polynomial.Polynomial.fit(np.arange(-count, 1) / RATE, stroke[last - count : last + 1], 2).convert()
    rate, rest, reached = parabola.deriv(), stroke[stop + 15 : stop + 45].mean(), 5.0 / RATE
    for _ in range(4):
        reached -= (parabola(reached) - rest) / rate(reached)
    if not abs(reached - 5.0 / RATE) < 10.0 / RATE:
        raise ValueError("the stroke does not run steadily into its stop")
    times = (np.arange(stop - BEFORE, stop + AFTER + 1) - last) / RATE
    return np.asarray(rate(np.minimum(times, reached))), float(reached - 5.0 / RATE)


def read_run(run_id: int, unit: str, table: pd.DataFrame) -> Ringdown:
    """Cut one run. Raises ValueError when it does not hold a whole stroke and ring-down."""
    if not np.all(np.isfinite(table[["Angle", "PG_1", "PG_2"]].to_numpy(float))):
        raise ValueError(f"run {run_id}: samples are missing")
    ports = {name: table[name].to_numpy(float) for name in ("PG_1", "PG_2")}
    port = max(ports, key=lambda name: np.median(ports[name][-500:]))
    pressure = ports[port]
    stroke = np.unwrap(table["Angle"].to_numpy(float), period=COUNTS_PER_TURN)
    stroke = (stroke - np.median(stroke[:5])) * np.sign(np.median(stroke[-500:]) - np.median(stroke[:5]))
    rate = np.asarray(savgol_filter(stroke, 9, 1, deriv=1)) * RATE
    stop = stop_index(stroke, rate)
    first, last = stop - BEFORE, stop + AFTER + 1
    if first < 5 or last + 100 > pressure.size:
        raise ValueError(f"run {run_id}: no whole stroke and ring-down (stop at sample {stop} of {pressure.size})")
    try:
        free, reached = approach(stroke, stop)
    except ValueError as error:
        raise ValueError(f"run {run_id}: {error}") from None
    smooth = np.asarray(savgol_filter(pressure[first:last], 9, 2))
    peak = BEFORE + int(np.argmax(smooth[BEFORE : BEFORE + 60]))
    trough = peak + int(np.argmin(smooth[peak : peak + 60]))
    return Ringdown(
        run_id=run_id,
        unit=unit,
        port=port,
        pressure=pressure[first:last],
        rate=rate[first:last],
        approach=free,
        clock=np.arange(-BEFORE, AFTER + 1) / RATE - reached,
        hold=float(np.median(pressure[stop + 200 : stop + 400])),
        speed=float(np.median(rate[stop - 35 : stop - 10])),
        first_pressure=float(pressure[first - 2 : first + 3].mean()),
        half_period=float(np.clip(trough - peak, 5, 60)) / RATE,
    )


def read_all(folder: Path) -> tuple[list[Ringdown], list[str]]:
    """Every run of a folder, and what was wrong with those left out."""
    files = [folder / "runs.parquet", folder / "runs_index.csv"]
    missing = [str(file) for file in files if not file.is_file()]
    if missing:
        raise SystemExit(
            f"{' and '.join(missing)} not found: --data takes a folder with runs.parquet and runs_index.csv made from "
            "github.com/vtnsi/actuator_dataset"
        )
    units = pd.read_csv(files[1]).set_index("run_id")["unit"]
    runs, trouble = [], []
    for run_id, table in pd.read_parquet(files[0], columns=["run_id", "Angle", "PG_1", "PG_2"]).groupby("run_id"):
        try:
            runs.append(read_run(int(run_id), str(units.get(run_id, "unknown")), table))  # pyright: ignore
        except ValueError as error:
            trouble.append(str(error))
    return runs, trouble


def damped_cosine(run: Ringdown, parameters) -> np.ndarray:
    """The baseline, pressure over hold: p0 until the onset d, then p_inf + e^(-a t) (A cos w t + b sin w t).

    parameters: p_inf, ln a, f [Hz], b, onset d after the stop [s]; A makes it continuous.
    """
    level, log_decay, frequency, sine, onset = parameters
    first = run.first_pressure / run.hold
    t = run.times - BEFORE / RATE - onset
    wave = (first - level) * np.cos(2 * np.pi * frequency * t) + sine * np.sin(2 * np.pi * frequency * t)
    return np.where(t < 0, first, level + np.exp(-np.exp(log_decay) * np.maximum(t, 0.0)) * wave)


def cosine_start(run: Ringdown) -> np.ndarray:
    """Where the search for the baseline starts."""
    return np.array([1.0, np.log(40.0), 0.5 / run.half_period, 0.25, -0.002])


COSINE_SIZES = np.array([0.1, 0.3, 2.0, 0.1, 0.002])
