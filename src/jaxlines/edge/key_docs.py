"""What each key of a study file is, where its table has no class of physics behind it."""

KEY_DOCS = {
    "title": "how results call the study; the file's name by default",
    "fluid": "the oil of the circuit",
    "circuit": "components and sensors by name; each says its type and the nodes that it is attached to",
    "initial": 'start values by name, such as "A.pressure" = "3 bar_a" or "measured"; rest at 1 atm by default',
    "recording": "the file of measurements and what its columns are",
    "fit": "what is estimated",
    "simulate": "times, inputs and outputs of a simulation",
    "numerics": "how trajectories are computed",
    "recording.file": "the recording (.csv, .txt, .parquet, .mat, .h5, .tdms, .mf4, ...); relative to the study",
    "recording.time": (
        'the time column with its unit, "t [s]" or ["t", "ms"]; ["t", "timestamp"] for time stamps, ["#", "1 ms"] for '
        'row numbers; a third word "every 10 ms" asks for another step, low-pass filtered before'
    ),
    "recording.channels": (
        'name of an output or input of the circuit = column with its unit: "p [bar_g]" or ["p", "bar_g"]; '
        '["u", "40 bar_g"] where one in the file means that much; ["V", "mL", "rate"] for a rate of change'
    ),
    "recording.noise": 'standard deviation of channels, such as "0.1 bar"; estimated from the residuals otherwise',
    "recording.window": 'start and end of the part to use, such as ["0.5 s", "3 s"]',
    "fit.free": "the parameters to estimate, one table each",
    "fit.known": "numbers held fixed whose standard uncertainty is carried into the result",
    "fit.derived": 'derived numbers to report with uncertainty, such as "line.effective_bulk_modulus"',
    "fit.starts": "number of searches from points spread over the bounds; the best is kept",
    "fit.seed": "seed of those points",
    "fit.free.path": 'the number, such as "fluid.bulk_modulus", or several that share one value',
    "fit.free.bounds": "lowest and highest value, with unit",
    "fit.free.start": "where the search starts; the number of the file by default, the middle where that is outside",
    "fit.free.transform": 'coordinate of the search: "log" for numbers known to an order of magnitude, "logit" '
    "for numbers that must stay inside their bounds",
    "fit.free.name": "how results call it; its path by default",
    "fit.known.path": "the number",
    "fit.known.sd": "its standard uncertainty, with unit",
    "simulate.stop": "end of the simulation",
    "simulate.start": "its beginning",
    "simulate.samples": "number of times, evenly spaced",
    "simulate.outputs": "what is written and shown; all node potentials and sensors by default",
    "simulate.inputs": "the inputs: a number with unit or a signal, such as { step = { ... } }",
    "numerics.solver": '"explicit" for smooth circuits, "implicit" for stiff ones (small volumes, end stops)',
    "numerics.tolerance": "relative tolerance of the adaptive step",
    "numerics.max_steps": "steps after which a simulation is given up",
    "numerics.precision": "float64, or float32 for speed where six digits will do",
}
