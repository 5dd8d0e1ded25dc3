"""Texts with units become the SI numbers of tables of units (NIST SP 811), or a clear refusal."""

import math

import pytest

from jaxlines.edge.units import base_unit, conversion, si

CASES = [
    ("12.8 mm", "m", 0.0128),
    ("12.8mm", "m", 0.0128),
    ("-1.5e-3 m", "m", -0.0015),
    ("1 in", "m", 0.0254),
    ("60 L/min", "m^3/s", 1e-3),
    ("60 l/min", "m^3/s", 1e-3),
    ("1 gpm", "m^3/s", 6.309020e-5),
    ("27.7 cSt", "m^2/s", 27.7e-6),
    ("27.7 mm^2/s", "m^2/s", 27.7e-6),
    ("1.5 GPa", "Pa", 1.5e9),
    ("1 psi", "Pa", 6894.757),
    ("1 lbf/in^2", "Pa", 6894.757),
    ("1 bar", "Pa", 1e5),
    ("100 cm^3/rev", "m^3/rad", 1e-4 / (2 * math.pi)),
    ("180 deg", "rad", math.pi),
    ("60 rpm", "rad/s", 2 * math.pi),
    ("80 Hz", "rad/s", 2 * math.pi * 80),
    ("60 rpm", "Hz", 1.0),
    ("5 Hz", "Hz", 5.0),
    ("850 kg/m³", "kg/m^3", 850.0),
    ("0.86 g/cm^3", "kg/m^3", 860.0),
    ("1 L/(min*bar)", "m^3/(s*Pa)", 1e-3 / 60 / 1e5),
    ("1 N*m/rpm", "N*m*s/rad", 30 / math.pi),
    ("20 degC", "K", 293.15),
    ("0.5 %", "1", 0.005),
    ("0.5 percent", "1", 0.005),
    ("0.25", "1", 0.25),
    (0.25, "1", 0.25),
    (3, "1", 3.0),
    ("inf GPa", "Pa", math.inf),
]


@pytest.mark.parametrize(("text", "unit", "value"), CASES)
def test_texts_of_hydraulics(text, unit, value):
    assert si(text, unit) == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2 bar_a", 2e5),
        ("2 bar_g", 2e5 + 101325.0),
        ("0 psi_g", 101325.0),
        ("14.69595 psi_a", 101325.0),
        ("3 MPa_g", 3e6 + 101325.0),
        ("-500 Pa_g", 100825.0),
        ("101.325 kPa_a", 101325.0),
    ],
)
def test_levels_count_from_zero_or_from_atmosphere(text, value):
    assert si(text, "Pa", level=True) == pytest.approx(value, rel=1e-6)


def test_gauge_counts_from_the_given_atmosphere():
    assert si("1 bar_g", "Pa", level=True, atmospheric_pressure=9e4) == pytest.approx(1.9e5)


def test_conversion_is_affine():
    factor, offset = conversion("bar_g", "Pa")
    assert (factor, offset) == (pytest.approx(1e5), pytest.approx(101325.0))


@pytest.mark.parametrize(
    ("value", "unit", "level", "message"),
    [
        ("2 bar", "Pa", True, r"'bar' does not say from where it counts: write bar_a \(absolute\) or bar_g \(gauge\)"),
        ("2 bar_g", "Pa", False, "a difference or a stiffness, neither absolute nor gauge: write bar"),
        ("2 mm_g", "m", None, "belong to pressures"),
        ("2", "Pa", None, 'has no unit: write for example "2 Pa"'),
        ("2", "Pa", True, 'write for example "2 bar_a"'),
        (2.0, "m", None, '2.0 has no unit: write it as a text such as "2.0 m"'),
        ("12.8 kg", "m", None, "unit 'kg' does not measure what is asked for, which is in m"),
        ("12.8 furlengths", "m", None, "unknown unit 'furlengths'"),
        ("12,8 mm", "m", None, "decimals take a point, not a comma"),
        ("long", "m", None, "'long' is no number with a unit"),
        ("", "m", None, "is no number with a unit"),
        ("2 * 3 m", "m", None, "unit"),
        ("1 $", "m", None, "unit"),
        ("50 cm^3", "m^3/rad", None, "differ by an angle: write rad, deg or rev"),
        ("600 1/s", "rad/s", None, "differ by an angle"),
        ("3 rad", "1", None, "differ by an angle"),
    ],
)
def test_refusals(value, unit, level, message):
    with pytest.raises(ValueError, match=message):
        si(value, unit, level=level)


@pytest.mark.parametrize("value", [None, True, ["1 m"], {"a": 1}])
def test_no_text_no_number(value):
    with pytest.raises(TypeError, match="a text with a unit"):
        si(value, "m")


@pytest.mark.parametrize(
    ("unit", "base"), [("bar_g", "Pa"), ("psi", "Pa"), ("L/min", "m^3/s"), ("%", "1"), ("rpm", "rad/s"), ("ms", "s")]
)
def test_base_units(unit, base):
    assert base_unit(unit) == base
