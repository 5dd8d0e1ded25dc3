"""The gas of an accumulator: real nitrogen by Benedict, Webb and Rubin, or an ideal gas."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx

from jaxlines.physics.fields import Number, array_module, check_fields, quantity

MOLAR_MASS = 28.013
"""Of nitrogen [kg/kmol]."""

GAS_CONSTANT = 8314.0
"""Universal gas constant as rounded in the fit of the Benedict-Webb-Rubin coefficients [J/(kmol K)]."""

VIBRATION_TEMPERATURE = 3393.5
"""Of the nitrogen molecule [K] (unverified: quoted from memory)."""

# Benedict-Webb-Rubin coefficients of nitrogen for kPa, m^3/kmol, K; each is used times 1000 to give Pa.
_A, _A0, _B, _B0 = 2.54, 106.73, 0.002328, 0.04074
_C, _C0, _ALPHA, _GAMMA = 7.379e4, 8.164e5, 1.272e-4, 0.0053


def nitrogen_pressure(density, temperature):
    """Pressure of nitrogen [Pa] by the Benedict-Webb-Rubin equation, with d = density/M in kmol/m^3:

    p = R T d + (B0 R T - A0 - C0/T^2) d^2 + (b R T - a) d^3 + a alpha d^6 + (c d^3/T^2)(1 + g d^2) exp(-g d^2)

    Args: density [kg/m^3]; temperature T [K].
    Validity: within 0.85 % of the reference equation of state at 273..350 K and 5..30 MPa.
    Typical values: 111.9 kg/m^3 at 10 MPa and 300 K (ideal gas: 112.3).
    Reference: Cooper and Goldfrank, "B-W-R constants and new correlations", Hydrocarbon Processing 46(12), 1967, as
    tabulated in Cengel and Boles, "Thermodynamics" (coefficients unverified: quoted from memory; the densities
    that follow from them are tested).
    """
    d, t, xp = density / MOLAR_MASS, temperature, array_module(density, temperature)
    rt = 1e-3 * GAS_CONSTANT * t
    second = _B0 * rt - _A0 - _C0 / (t * t)
    tail = _C / (t * t) * (1.0 + _GAMMA * d * d) * xp.exp(-_GAMMA * d * d)
    return 1e3 * d * (rt + d * (second + d * (_B * rt - _A + tail + _A * _ALPHA * d**3)))


def nitrogen_pressure_by_density(density, temperature):
    """(dp/drho)_T of `nitrogen_pressure` [Pa m^3/kg]."""
    d, t, xp = density / MOLAR_MASS, temperature, array_module(density, temperature)
    rt, z = 1e-3 * GAS_CONSTANT * t, _GAMMA * d * d
    second = _B0 * rt - _A0 - _C0 / (t * t)
    tail = _C / (t * t) * (3.0 + 3.0 * z - 2.0 * z * z) * xp.exp(-z)
    slope = rt + d * (2.0 * second + d * (3.0 * (_B * rt - _A) + tail + 6.0 * _A * _ALPHA * d**3))
    return 1e3 / MOLAR_MASS * slope


def nitrogen_pressure_by_temperature(density, temperature):
    """(dp/dT)_v of `nitrogen_pressure` [Pa/K]."""
    d, t, xp = density / MOLAR_MASS, temperature, array_module(density, temperature)
    r, z, cube = 1e-3 * GAS_CONSTANT, _GAMMA * d * d, t * t * t
    tail = -2.0 * _C / cube * (1.0 + z) * xp.exp(-z)
    return 1e3 * d * (r + d * (_B0 * r + 2.0 * _C0 / cube + d * (_B * r + tail)))


def nitrogen_heat_capacity(density, temperature):
    """Heat capacity of nitrogen at constant volume [J/(kg K)]: ideal part and departure, with d = density/M:

    M c_v = R (5/2 + x^2 e^-x/(1 - e^-x)^2) + 6 C0 d/T^3 - (6 c/(g T^3)) (1 - (1 + g d^2/2) exp(-g d^2)),  x = T_v/T

    The departure is -T int_0^d (d2p/dT2)_d /d^2 dd of `nitrogen_pressure`, so that both belong together.

    Args: density [kg/m^3]; temperature T [K].
    Validity: within 2.4 % of the reference equation of state at 273..400 K up to 30 MPa.
    Typical values: 743 J/(kg K) at 300 K and 1 bar, 781 at 20 MPa.
    Reference: as `nitrogen_pressure`; rigid rotor and harmonic oscillator for the ideal part.
    """
    d, t, xp = density / MOLAR_MASS, temperature, array_module(density, temperature)
    decay, z = xp.exp(-VIBRATION_TEMPERATURE / t), _GAMMA * d * d
    x = VIBRATION_TEMPERATURE / t
    ideal = 1e-3 * GAS_CONSTANT * (2.5 + x * x * decay / ((1.0 - decay) * (1.0 - decay)))
    departure = 6.0 / (t * t * t) * (_C0 * d - _C / _GAMMA * (1.0 - (1.0 + 0.5 * z) * xp.exp(-z)))
    return 1e3 / MOLAR_MASS * (ideal + departure)


class AbstractGas(eqx.Module):
    """The gas of an accumulator: pressure and heat capacity as functions of density and temperature.

    A gas colder than `coldest` [K] is evaluated as at that temperature.
    """

    coldest: ClassVar[float] = 1.0

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def pressure(self, density, temperature) -> Number:
        """Pressure [Pa] at a density [kg/m^3] and temperature [K]."""

    @abstractmethod
    def pressure_by_density(self, density, temperature) -> Number:
        """(dp/drho)_T [Pa m^3/kg]."""

    @abstractmethod
    def pressure_by_temperature(self, density, temperature) -> Number:
        """(dp/dT)_v [Pa/K]."""

    @abstractmethod
    def heat_capacity(self, density, temperature) -> Number:
        """c_v [J/(kg K)]."""

    @abstractmethod
    def first_density(self, pressure, temperature) -> Number:
        """A guess of the density [kg/m^3] at a pressure [Pa] and temperature [K], to start from."""


class Nitrogen(AbstractGas):
    """Real nitrogen by the Benedict-Webb-Rubin equation; see `nitrogen_pressure`, `nitrogen_heat_capacity`."""

    coldest = 140.0  # below the critical temperature, 126 K, pressure would not rise with density

    def pressure(self, density, temperature):
        return nitrogen_pressure(density, temperature)

    def pressure_by_density(self, density, temperature):
        return nitrogen_pressure_by_density(density, temperature)

    def pressure_by_temperature(self, density, temperature):
        return nitrogen_pressure_by_temperature(density, temperature)

    def heat_capacity(self, density, temperature):
        return nitrogen_heat_capacity(density, temperature)

    def first_density(self, pressure, temperature):
        return pressure * MOLAR_MASS / (GAS_CONSTANT * temperature)


class IdealGas(AbstractGas):
    """An ideal gas: p = rho R T, c_v = R/(gamma - 1); nitrogen's numbers unless told otherwise.

    Args: gas_constant R [J/(kg K)]; heat_ratio gamma [-].
    Validity: nitrogen at 300 K: density 0.5 % high at 10 MPa, 6 % at 20 MPa, 14 % at 30 MPa.
    """

    gas_constant: Number = quantity("J/(kg*K)", low=10.0, high=1e4, default=296.8)
    heat_ratio: Number = quantity("1", low=1.01, high=1.7, default=1.4)

    def pressure(self, density, temperature):
        return density * self.gas_constant * temperature

    def pressure_by_density(self, density, temperature):
        return self.gas_constant * temperature + 0.0 * density

    def pressure_by_temperature(self, density, temperature):
        return self.gas_constant * density + 0.0 * temperature

    def heat_capacity(self, density, temperature):
        return self.gas_constant / (self.heat_ratio - 1.0) + 0.0 * (density + temperature)

    def first_density(self, pressure, temperature):
        return pressure / (self.gas_constant * temperature)


NEWTON_STEPS = 6
"""From the ideal gas to the root up to 60 MPa and at 250..450 K; derivatives converge with it."""


def density_of(gas: AbstractGas, pressure, temperature) -> Number:
    """Density of a gas [kg/m^3] at a pressure [Pa] and temperature [K], by a fixed number of Newton steps.

    The steps are differentiated with it: at the root, a step's own derivative with respect to where it starts is
    zero, so that the last one gives the derivative of the implicit function.
    """
    density = gas.first_density(pressure, temperature)
    for _ in range(NEWTON_STEPS):
        excess = gas.pressure(density, temperature) - pressure
        density = density - excess / gas.pressure_by_density(density, temperature)
    return density


def isentropic_stiffness(gas: AbstractGas, density, temperature) -> Number:
    """rho (dp/drho)_s = rho (dp/drho)_T + T (dp/dT)_v^2/(rho c_v) [Pa]: -v dp/dv of a gas without heat flow.

    Typical values: 1.4 p for an ideal diatomic gas.
    """
    slope = gas.pressure_by_temperature(density, temperature)
    adiabatic = temperature * slope * slope / (density * gas.heat_capacity(density, temperature))
    return density * gas.pressure_by_density(density, temperature) + adiabatic
