"""Bulk moduli of oil with air as other programs and papers give them, to repeat and compare their results.

All take the same arguments, whatever the source uses: absolute pressure p [Pa], modulus of the air-free liquid
[Pa] (constant), fraction of free air alpha in the MIXTURE at p0 = 101325 Pa [-], polytropic index n [-]. What
the source itself counts (gauge pressure, air per volume of LIQUID R = alpha/(1 - alpha), air at the pressure
p) is said with each. All describe air that does not dissolve. For models to be simulated see `Oil`, of which the
default is Cho's.
"""

from jaxlines.physics.air import gas_modulus, gas_volume
from jaxlines.physics.fields import ATMOSPHERE, array_module


def _air_per_liquid(air_fraction):
    """R [-] of alpha [-]."""
    return air_fraction / (1.0 - air_fraction)


def _liquid_volume(p, liquid_modulus):
    """exp(-(p - p0)/K_l) [-]."""
    return array_module(p, liquid_modulus).exp(-(p - ATMOSPHERE) / liquid_modulus)


def gas_fraction_at(p, liquid_modulus, air_fraction, polytropic_index):
    """Volume of gas per volume of mixture AT the pressure p [-], of free air and a liquid of constant modulus."""
    gas = _air_per_liquid(air_fraction) * gas_volume(p, polytropic_index)
    return gas / (gas + _liquid_volume(p, liquid_modulus))


def cho_modulus(p, liquid_modulus, air_fraction, polytropic_index):
    """Modulus of oil with free air [Pa]: K = (v_l + R g)/(v_l/K_l + R g/(n p)), g = (p0/p)^(1/n).

    v_l = exp(-(p - p0)/K_l). Source: absolute pressure, alpha of the mixture at p0. Consistent with a density.
    Reference: Cho, Lee and Oh, "Estimation technique of air content in automatic transmission fluid by measuring
        effective bulk modulus", Int. J. Automotive Technology 3(2), 2002.
    """
    gas = _air_per_liquid(air_fraction) * gas_volume(p, polytropic_index)
    liquid = _liquid_volume(p, liquid_modulus)
    return (liquid + gas) / (liquid / liquid_modulus + gas / gas_modulus(p, polytropic_index))


def yudell_modulus(p, liquid_modulus, air_fraction, polytropic_index):
    """Cho's modulus as Yudell (2017) arranges it [Pa]: K_l (x + R)/(x + R K_l/(n p)), equal to Cho's.

    x = (p/p0)^(1/n) exp((p0 - p)/K_l). Source: absolute pressure, air per volume of liquid.
    Reference: file deadVCap.m of novaTehnika's public model of a wave energy converter.
    """
    ratio = _air_per_liquid(air_fraction)
    x = _liquid_volume(p, liquid_modulus) / gas_volume(p, polytropic_index)
    return liquid_modulus * (x + ratio) / (x + ratio * liquid_modulus / gas_modulus(p, polytropic_index))


def simplified_isothermal_modulus(p, liquid_modulus, air_fraction, polytropic_index=1.0):
    """K = K_l/(1 + K_l R p0/p^2) [Pa]; the polytropic index has no effect.

    Source: absolute pressure, air per volume of liquid. Neglects the volume of the gas: at low pressure with
    much air it is too soft by the factor 1 + R p0/p.
    Reference: novaTehnika's public model of a wave energy converter.
    """
    return liquid_modulus / (1.0 + liquid_modulus * _air_per_liquid(air_fraction) * ATMOSPHERE / (p * p))


def reuss_modulus(liquid_modulus, second_modulus, second_fraction):
    """Modulus of two phases in series [Pa]: 1/K = (1 - x)/K_l + x/K_g, x the volume fraction at the pressure.

    Args: liquid_modulus K_l, second_modulus K_g [Pa]; second_fraction x [-].
    Exact for phases under the same pressure. Reference: Wood, "A Textbook of Sound", 1930; Reuss 1929
        (unverified: quoted from memory).
    """
    return 1.0 / ((1.0 - second_fraction) / liquid_modulus + second_fraction / second_modulus)


def wood_modulus(p, liquid_modulus, air_fraction, polytropic_index):
    """Modulus by `reuss_modulus` with the gas fraction at p and K_g = n p [Pa]; equal to Cho's.

    Source: absolute pressure, gas fraction of the mixture AT p.
    """
    gas = gas_fraction_at(p, liquid_modulus, air_fraction, polytropic_index)
    return reuss_modulus(liquid_modulus, gas_modulus(p, polytropic_index), gas)


def merritt_series_modulus(liquid_modulus, bubble_modulus, gas_fraction):
    """Merritt's modulus without the container [Pa]: 1/K = 1/K_l + (V_g/V_t)/K_g.

    Args: liquid_modulus K_l, bubble_modulus K_g = n p [Pa]; gas_fraction V_g/V_t AT the pressure [-] (taking
        that at p0 is a common mistake). For the container see `article.series_modulus`.
    Reference: Merritt, "Hydraulic Control Systems", 1967, eq. 2-13 (unverified: quoted from memory).
    """
    return 1.0 / (1.0 / liquid_modulus + gas_fraction / bubble_modulus)


def merritt_modulus(p, liquid_modulus, air_fraction, polytropic_index):
    """Merritt's modulus with the gas fraction at p and K_g = n p [Pa]; without the factor 1 - x of `wood_modulus`.

    Source: absolute pressure, gas fraction of the mixture AT p.
    """
    gas = gas_fraction_at(p, liquid_modulus, air_fraction, polytropic_index)
    return merritt_series_modulus(liquid_modulus, gas_modulus(p, polytropic_index), gas)


def wylie_modulus(p, liquid_modulus, air_fraction, polytropic_index=1.0):
    """Modulus rho a^2 of Wylie's wave speed in a rigid pipe [Pa]: K = K_l/(1 + x (K_l/K_g - 1)), K_g = p.

    The gas is isothermal whatever polytropic index is given. Source: absolute pressure, gas fraction x AT p.
    Reference: Wylie, "Simulation of vaporous and gaseous cavitation", J. Fluids Engineering 106, 1984
        (unverified: quoted from memory).
    """
    gas = gas_fraction_at(p, liquid_modulus, air_fraction, 1.0)
    return liquid_modulus / (1.0 + gas * (liquid_modulus / p - 1.0))


def simhydraulics_modulus(p, liquid_modulus, air_fraction, polytropic_index):
    """Modulus of SimHydraulics and Simscape's former hydraulic blocks [Pa].

    K = K_l (1 + a (p_a/(p_a + p_g))^(1/n))/(1 + a p_a^(1/n) K_l/(n (p_a + p_g)^((n + 1)/n)))

    Source: GAUGE pressure p_g, air per volume of LIQUID a. The liquid's volume is held at 1.
    Reference: MathWorks, SimHydraulics, block "Hydraulic Fluid".
    """
    gas = _air_per_liquid(air_fraction) * gas_volume(p, polytropic_index)
    return liquid_modulus * (1.0 + gas) / (1.0 + gas * liquid_modulus / gas_modulus(p, polytropic_index))


def maplesim_modulus(p, liquid_modulus, air_fraction, polytropic_index):
    """Modulus of MapleSim's hydraulics library [Pa], equal to `simhydraulics_modulus`.

    K = (1 + a/g)/(1/K_l + a/(n g b p_atm)),  b = 1 + p_g/p_atm,  g = b^(1/n)

    Source: GAUGE pressure p_g, air per volume of LIQUID a; defaults a 0.005, n 1.4.
    Reference: Maplesoft, MapleSim help, hydraulics (layout of the formula garbled in the copy read).
    """
    air, b = _air_per_liquid(air_fraction), p / ATMOSPHERE
    g = array_module(p, polytropic_index).exp(array_module(p).log(b) / polytropic_index)
    return (1.0 + air / g) / (1.0 / liquid_modulus + air / (polytropic_index * g * b * ATMOSPHERE))


def simscape_isothermal_liquid_density(p, liquid_modulus, air_fraction, polytropic_index, densities):
    """Density of Simscape's isothermal liquid with constant entrained air [kg/m^3].

    rho = (rho_l0 + R rho_g0)/(R (p0/p)^(1/n) + rho_l0/rho_l),  rho_l = rho_l0 exp((p - p0)/K_l)

    Args: as for all; densities (rho_l0, rho_g0) of liquid and gas at p0 [kg/m^3].
    Source: absolute pressure, alpha of the mixture; defaults 0.005, n 1, 998.21 and 1.225 kg/m^3. The formula is
        the model that MathWorks describes in words; the printed equations could not be read.
    Reference: MathWorks, Simscape, "Isothermal Liquid Modeling Options".
    """
    liquid_density, gas_density = densities
    ratio = _air_per_liquid(air_fraction)
    volume = ratio * gas_volume(p, polytropic_index) + _liquid_volume(p, liquid_modulus)
    return (liquid_density + ratio * gas_density) / volume


def simscape_isothermal_liquid_modulus(p, liquid_modulus, air_fraction, polytropic_index):
    """Modulus rho dp/drho of `simscape_isothermal_liquid_density` [Pa], which is Cho's. Same source."""
    return cho_modulus(p, liquid_modulus, air_fraction, polytropic_index)


def yu_modulus(p, liquid_modulus, air_fraction, polytropic_index):
    """Modulus of Yu, Chen and Lu without dissolution (c_1 = 0) [Pa]: K_l/(1 + R g (K_l/(n p) - 1)).

    g = (p0/p)^(1/n). Source: GAUGE pressure, an atmosphere of 1e5 Pa (here 101325 Pa), air per volume of liquid.
    The term with c_1 for dissolution is left out: its sign and unit could not be confirmed.
    Reference: Yu, Chen and Lu, "The variation of oil effective bulk modulus with pressure in hydraulic systems",
        J. Dynamic Systems, Measurement, and Control 116, 1994 (unverified: quoted from memory).
    """
    gas = _air_per_liquid(air_fraction) * gas_volume(p, polytropic_index)
    return liquid_modulus / (1.0 + gas * (liquid_modulus / gas_modulus(p, polytropic_index) - 1.0))


PUBLISHED = {
    "Cho 2002": cho_modulus,
    "Yudell 2017": yudell_modulus,
    "Wood": wood_modulus,
    "Merritt 1967": merritt_modulus,
    "Wylie 1984 (isothermal)": wylie_modulus,
    "SimHydraulics": simhydraulics_modulus,
    "MapleSim": maplesim_modulus,
    "Simscape isothermal liquid": simscape_isothermal_liquid_modulus,
    "Yu 1994 (c1 = 0)": yu_modulus,
    "novaTehnika (simplified isothermal)": simplified_isothermal_modulus,
}
"""Name -> modulus [Pa] of (p [Pa absolute], liquid_modulus [Pa], air_fraction [-], polytropic_index [-])."""
