"""A small study and its recording, written into a folder for tests of the edge."""

import numpy as np
import pandas as pd

STUDY = """
title = "Control line, bench test"
[fluid]
bulk_modulus = "1.5 GPa"
density = "850 kg/m^3"
air_fraction = "0.5 %"
[circuit.line]
type = "Line"
node = "A"
path_length = "20.83 m"
parts = [
  { type = "Pipe", length = "20.83 m", inner_diameter = "42.85 mm", outer_diameter = "60.32 mm", poissons_ratio=0.25 },
  { type = "Vessel", volume = "0.5 L" },
]
[circuit.valve]
type = "FlowSource"
node = "A"
flow = { input = "flow" }
[circuit.leak]
type = "LaminarLeak"
a = "A"
b = "tank"
conductance = "6e-6 L/(min*bar)"
[circuit.reservoir]
type = "Tank"
node = "tank"
[circuit.gauge]
type = "PressureSensor"
node = "A"
reference = "gauge"
[initial]
"A.pressure" = "2 bar_g"
[recording]
file = "line.csv"
time = "t [s]"
channels = { "A.pressure" = "p_line [bar_g]", flow = "q_valve [L/min]" }
noise = { "A.pressure" = "0.1 bar" }
[[fit.free]]
path = "fluid.bulk_modulus"
bounds = ["0.6 GPa", "2.5 GPa"]
start = "2.2 GPa"
transform = "log"
[[fit.free]]
path = "initial.A.pressure"
bounds = ["1 bar_a", "5 bar_a"]
[[fit.known]]
path = "line.parts.0.length"
sd = "0.05 m"
[fit]
derived = ["line.effective_bulk_modulus"]
[simulate]
stop = "2 s"
samples = 50
outputs = ["A.pressure", "gauge"]
[simulate.inputs]
flow = { step = { before = "0 L/min", after = "10 L/min", time = "500 ms" } }
"""


def write_study(folder, *changes: tuple[str, str]):
    """The study with pieces of its text replaced, and a recording next to it; the path of the study.

    The recording is a straight pressure rise with noise of a fixed seed: it need not come from the model.
    """
    text = STUDY
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    times = np.arange(200) * 0.02
    flow = np.where((times > 0.5) & (times < 2.5), 6.0, 0.0) + 1e-3 * np.sin(50 * times)
    pressure = 2.0 + np.cumsum(flow) * 0.02 * 6.4 + 0.1 * np.random.default_rng(7).standard_normal(200)
    table = pd.DataFrame({"t [s]": times, "p_line [bar_g]": pressure, "q_valve [L/min]": flow})
    table.to_csv(folder / "line.csv", index=False)
    path = folder / "study.toml"
    path.write_text(text)
    return path
