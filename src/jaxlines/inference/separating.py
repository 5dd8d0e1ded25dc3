"""What kind of test would tell numbers apart that a recording leaves open, in words."""

TESTS: tuple[tuple[tuple[str, ...], str], ...] = (
    (("air_fraction", "polytropic_index"), "a slow swing of pressure from atmospheric to some 50 bar shows free air"),
    (("bulk_modulus",), "a compression at high pressure, where air is squeezed away, shows the liquid"),
    (
        ("wall_modulus", "youngs_modulus", "wall_thickness"),
        "the same compression of a rigid vessel of known volume shows how much the walls give",
    ),
    (
        ("volume", "length", "inner_diameter"),
        "a measured flow into the volume, or its size by a ruler, fixes its scale",
    ),
    (("gain",), "a measured flow, or a calibrated reading beside the sensor, fixes the gain"),
    (("conductance", "leak"), "a hold at constant pressure with closed valves shows leakage alone"),
    (("offset",), "a reading at a known level, such as atmospheric pressure at rest, fixes the offset"),
    (("delay", "lag", "time_constant"), "a step that is fast against the lag, sampled faster, shows it"),
    (
        ("roughness", "viscosity", "discharge", "resistance", "loss", "area"),
        "steady flows of several sizes, laminar and turbulent, part linear from square losses",
    ),
    (("friction", "coulomb", "stribeck", "viscous"), "slow and fast strokes at one load part the kinds of friction"),
    (("mass", "inertia"), "an acceleration with measured pressure or torque shows inertia"),
    (("precharge", "gas_volume"), "a charge from below the pre-charge pressure shows where the gas begins to yield"),
    (("initial",), "a longer rest before the first change, or a measured start, fixes the start value"),
)
"""Parts of a parameter's name -> the test that shows it most directly."""


def separating_test(labels: tuple[str, ...]) -> str:
    """The tests that would tell parameters of one group apart: one that is told alone frees the others."""
    found = []
    for label in labels:
        path = label.partition(" [")[0].lower()
        word = next((text for parts, text in TESTS if any(part in path for part in parts)), None)
        if word is not None and word not in found:
            found.append(word)
    if not found:
        return "a test at another level of pressure, flow or temperature, or one more sensor, may tell"
    return "; or ".join(found)
