"""Moduli of other programs and papers against tabulated values, and what they have in common."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxlines.physics import published_moduli as published
from jaxlines.physics.air import LegacySimscapeAir
from jaxlines.physics.article import series_modulus
from jaxlines.physics.fluids import GAS_DENSITY, Oil

P0 = 101325.0
PSI = 6894.757293168
PRESSURES = np.array([0.101325, 0.2, 0.5, 1, 2, 5, 10, 20, 35]) * 1e6
ALPHA = 0.005 / 1.005  # of the mixture, where air per liquid is 0.005
# liquid 1.5 GPa, air per liquid 0.005, n 1.4 [MPa]
SIMHYDRAULICS = "27.9836 86.0749 339.4514 734.5441 1138.6044 1407.3725 1470.6373 1491.0124 1496.5928"
YU = "27.8469 85.8260 339.0320 734.1790 1138.4414 1407.3456 1470.6318 1491.0114 1496.5925"
# liquid 1.5 GPa, alpha 0.01, n 1.4
CHO = "14.0539 44.0091 189.9346 483.1872 913.7208 1323.5051 1441.4837 1481.7177 1492.9723"
TABLES = Path(__file__).parents[2] / "../shared/reference/bulk_modulus/effective_bulk_modulus.json"


def numbers(text: str) -> np.ndarray:
    return np.array([float(word) for word in text.split()]) * 1e6


@pytest.mark.parametrize(
    ("name", "alpha", "expected"),
    [
        ("SimHydraulics", ALPHA, SIMHYDRAULICS),
        ("MapleSim", ALPHA, SIMHYDRAULICS),
        ("Yu 1994 (c1 = 0)", ALPHA, YU),
        ("Cho 2002", 0.01, CHO),
        ("Yudell 2017", 0.01, CHO),
        ("Simscape isothermal liquid", 0.01, CHO),
        ("Wood", 0.01, CHO),
    ],
)
def test_tabulated_moduli(name, alpha, expected):
    seen = published.PUBLISHED[name](PRESSURES, 1.5e9, alpha, 1.4)
    np.testing.assert_allclose(seen, numbers(expected), rtol=0, atol=51)


def test_legacy_law_of_an_oil():
    oil = Oil(1.5e9, 850.0, air_fraction=ALPHA, polytropic_index=1.4, air=LegacySimscapeAir(), mass="article")
    np.testing.assert_allclose(oil.mixture_modulus(PRESSURES), numbers(SIMHYDRAULICS), rtol=0, atol=51)


@pytest.fixture(scope="module")
def tables():
    if not TABLES.exists():
        pytest.skip("reference tables of bulk moduli are not here")
    return json.loads(TABLES.read_text())


def test_table_of_the_former_hydraulic_blocks(tables):
    table = tables["simscape_hydraulics_isothermal_E(p_gauge)"]
    p = table["pa"] + np.array([float(gauge) for gauge in table["values"]])
    expected = np.array(list(table["values"].values()))
    alpha = table["alpha"] / (1 + table["alpha"])
    np.testing.assert_allclose(published.simhydraulics_modulus(p, table["El"], alpha, table["n"]), expected, rtol=1e-12)
    np.testing.assert_allclose(published.maplesim_modulus(p, table["El"], alpha, table["n"]), expected, rtol=1e-12)
    oil = Oil(
        table["El"], 850.0, air_fraction=alpha, polytropic_index=table["n"], air=LegacySimscapeAir(), mass="article"
    )
    np.testing.assert_allclose(oil.mixture_modulus(p), expected, rtol=1e-12)


def test_table_of_the_isothermal_liquid(tables):
    table = tables["simscape_isothermal_liquid_const_air"]
    p = np.array([float(key) for key in table["values(p_abs):[rho_mix,beta_mix]"]])
    density, modulus = np.array(list(table["values(p_abs):[rho_mix,beta_mix]"].values())).T
    given = p, table["betaL"], table["alpha0"], table["n"]
    densities = table["rhoL0"], table["rhog0"]
    seen = published.simscape_isothermal_liquid_density(*given, densities)
    np.testing.assert_allclose(seen, density, rtol=1e-13)
    np.testing.assert_allclose(published.simscape_isothermal_liquid_modulus(*given), modulus, rtol=1e-12)
    oil = Oil(table["betaL"], table["rhoL0"], air_fraction=table["alpha0"], polytropic_index=table["n"])
    np.testing.assert_allclose(oil.mixture_modulus(p), modulus, rtol=1e-12)
    ratio = table["alpha0"] / (1 - table["alpha0"])
    heavier = (table["rhoL0"] + ratio * table["rhog0"]) / (
        table["rhoL0"] + ratio * GAS_DENSITY
    )  # another density of air
    np.testing.assert_allclose(oil.density_at(p) * heavier, density, rtol=1e-13)


def test_textbook_example_of_merritt():
    """D/t = 10, steel, 1 % bubbles at the pressure, liquid 250,000 psi: 41,096 and 53,708 psi."""
    for bubbles, expected in ((500 * PSI, 41096), (700 * PSI, 53708)):
        fluid = published.merritt_series_modulus(250e3 * PSI, bubbles, 0.01)
        assert series_modulus(30e6 * PSI / 10, fluid) / PSI == pytest.approx(expected, abs=0.51)


@settings(max_examples=100, deadline=None)
@given(
    p=st.floats(2e3, 5e7),
    alpha=st.floats(0, 0.3),
    index=st.floats(1.0, 1.4),
    K=st.floats(1e9, 3e9),
)
def test_which_are_equal(p, alpha, index, K):
    reference = published.cho_modulus(p, K, alpha, index)
    assert 0 < reference <= K * (1 + 1e-12)
    for name in ("Yudell 2017", "Wood", "Simscape isothermal liquid"):
        assert published.PUBLISHED[name](p, K, alpha, index) == pytest.approx(reference, rel=1e-12)
    oil = Oil(K, 850.0, air_fraction=alpha, polytropic_index=index)
    assert oil.mixture_modulus(p) == pytest.approx(reference, rel=1e-12)
    assert published.maplesim_modulus(p, K, alpha, index) == pytest.approx(
        published.simhydraulics_modulus(p, K, alpha, index), rel=1e-12
    )
    isothermal = published.cho_modulus(p, K, alpha, 1.0)
    assert published.wylie_modulus(p, K, alpha, index) == pytest.approx(isothermal, rel=1e-12)
    # Merritt counts the liquid as if it filled the whole volume: softer by less than p/K
    merritt = published.merritt_modulus(p, K, alpha, index)
    assert (1 - index * p / K) * reference <= merritt <= reference * (1 + 1e-12)


@settings(max_examples=50, deadline=None)
@given(p=st.floats(1e5, 5e7), index=st.floats(1.0, 1.4))
def test_all_agree_on_little_air(p, index):
    """To 1 % for one part in a million, all but the isothermal ones for every index, those for index 1."""
    for name, modulus in published.PUBLISHED.items():
        n = 1.0 if "isothermal)" in name else index
        assert modulus(p, 1.5e9, 1e-6, n) == pytest.approx(published.cho_modulus(p, 1.5e9, 1e-6, n), rel=0.01)
        assert modulus(p, 1.5e9, 0.0, n) == pytest.approx(1.5e9, rel=1e-14)


def test_simplified_law_is_too_soft_by_the_volume_of_the_gas():
    for p in (1e5, 1e6):
        r = 0.01 / 0.99 * P0 / p
        simplified = published.simplified_isothermal_modulus(p, 1.5e9, 0.01)
        assert published.cho_modulus(p, 1.5e9, 0.01, 1.0) / simplified == pytest.approx(1 + r, rel=1e-3)


def test_gas_fraction():
    assert published.gas_fraction_at(P0, 1.5e9, 0.01, 1.2) == pytest.approx(0.01, rel=1e-14)
