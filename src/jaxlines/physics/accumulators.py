"""Accumulators: oil against a cushion of gas, polytropic, or real gas that exchanges heat with its wall."""

import jax.numpy as jnp

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, array_module, port, quantity
from jaxlines.physics.fluids import Oil
from jaxlines.physics.nitrogen import AbstractGas, Nitrogen, density_of, isentropic_stiffness


def polytropic_gas_volume(volume, precharge_pressure, polytropic_index, p):
    """Volume of the gas of an accumulator [m^3]: V_g = V_0 (p_pre/p)^(1/n).

    Args: volume V_0 of the whole accumulator [m^3]; precharge_pressure p_pre [Pa]; polytropic_index n [-]: 1
        isothermal (slow) to 1.4 adiabatic (fast); p [Pa]. All pressures absolute.
    Validity: p >= p_pre, ideal gas (real nitrogen above 20 MPa is 6 % off and more).
    Typical values: n 1.2..1.4.
    Reference: ideal gas law; with a polytropic index, Merritt, "Hydraulic Control Systems", 1967.
    """
    xp = array_module(volume, precharge_pressure, polytropic_index, p)
    return volume * xp.exp(-xp.log(p / precharge_pressure) / polytropic_index)


def _softplus(x, width):
    """max(x, 0) made smooth: w ln(1 + exp(x/w))."""
    return width * array_module(x, width).logaddexp(x / width, 0.0)


def _density_slope(fluid: Oil, p):
    """drho/dp of the oil [kg/(m^3 Pa)], its air at equilibrium; zero where its density is constant."""
    return 0.0 * p if fluid.mass == "article" else fluid.density_at(p) / fluid.mixture_modulus(p)


class Accumulator(AbstractComponent):
    """A gas-loaded accumulator as a capacity at its node: polytropic gas, no inlet resistance.

    Oil volume V_o(p) = V_0 - V_0 (p_pre/p_e)^(1/n), dm/dp = rho dV_o/dp + V_o drho/dp,
    with p_e = p_pre + w ln(1 + exp((p - p_pre)/w)), a smooth max(p, p_pre), w = switch_width p_pre.

    Args: node; volume V_0, empty of oil [m^3]; precharge_pressure p_pre, ABSOLUTE [Pa]; polytropic_index n [-]: 1
        isothermal (slow) to 1.4 adiabatic (fast); switch_width: where the gas takes over, share of p_pre [-].
    Validity: ideal gas (error of the gas volume 6 % at 20 MPa); below the precharge it is empty and adds almost no
        capacity, so that its node needs another one (a `Line`). The smooth switch changes the capacity by less than
        1e-6 of itself at twice the precharge.
    Typical values: n 1.2..1.4; precharge 0.6..0.9 of the lowest working pressure (unverified: quoted from memory).
    Reference: see `polytropic_gas_volume`.
    """

    node: str = port()
    volume: Number = quantity("m^3", low=1e-8, high=1e4, slip="was it given in litres?")
    precharge_pressure: Number = quantity(
        "Pa", low=5e4, high=1e8, slip="it is an absolute pressure in Pa; was it given in bar?", level=True
    )
    polytropic_index: Number = quantity("1", low=0.9, high=1.8, default=1.2)
    switch_width: Number = quantity("1", low=1e-3, high=0.05, slip="was it given in percent or Pa?", default=0.02)

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution(capacity={"node": self.capacity(at.fluid, at.potential["node"])})

    def _compressing(self, p):
        """p_e [Pa], and how much of a change of pressure reaches the gas [-]."""
        width = self.switch_width * self.precharge_pressure
        beyond = p - self.precharge_pressure
        share = 0.5 * (1.0 + array_module(self, p).tanh(0.5 * beyond / width))
        return self.precharge_pressure + _softplus(beyond, width), share

    def gas_volume(self, p) -> Number:
        """V_g [m^3] at absolute pressure p [Pa]."""
        pressure, _ = self._compressing(p)
        return polytropic_gas_volume(self.volume, self.precharge_pressure, self.polytropic_index, pressure)

    def oil_volume(self, p) -> Number:
        """V_o [m^3] at absolute pressure p [Pa]."""
        return self.volume - self.gas_volume(p)

    def compliance(self, p) -> Number:
        """C = dV_o/dp [m^3/Pa] at absolute pressure p [Pa]."""
        pressure, share = self._compressing(p)
        return self.gas_volume(p) / (self.polytropic_index * pressure) * share

    def oil_mass(self, fluid: Oil, p) -> Number:
        """rho V_o [kg] at absolute pressure p [Pa]."""
        return fluid.density_at(p) * self.oil_volume(p)

    def capacity(self, fluid: Oil, p) -> Number:
        """dm/dp = rho dV_o/dp + V_o drho/dp [kg/Pa] at absolute pressure p [Pa]."""
        return fluid.density_at(p) * self.compliance(p) + self.oil_volume(p) * _density_slope(fluid, p)


_DENSEST_GAS = 1000.0
# Density [kg/m^3] beyond which the gas is evaluated as there. Only a rejected trial step of the solver can get that
# far; the limit keeps it finite so that it can be rejected.


class NitrogenAccumulator(AbstractComponent):
    """A gas-loaded accumulator with real gas, heat exchange with the wall, and a laminar inlet.

    Inlet   m' = rho G (p_node - p_g), fading out with the last oil
    Oil     m = rho(p_g) (V_0 - V_g), so that V_g' = -(m'/rho - V_o (drho/dp) p_g'/rho); V_g' = -G (p_node - p_g)
            with constant density
    Gas     T' = (T_w - T)/tau - (T/c_v) (dp/dT)_v v',  p_g = p(m_g/V_g, T),  m_g = V_0 rho_g(p_pre, T_pre)

    Args: node; volume V_0, empty of oil [m^3]; precharge_pressure p_pre, ABSOLUTE, at precharge_temperature T_pre [K];
        conductance G of the inlet [m^3/(s Pa)]; thermal_time_constant tau of the gas [s] (infinite: adiabatic);
        wall_temperature T_w [K]; fade: share of V_0 and of p_pre over which the outflow fades out [-]; gas.
    Starts at the wall's temperature, in equilibrium with the node's pressure; empty below the precharge.
    Validity: uniform gas of one time constant (in truth it depends on the state), wall of constant temperature; no
        inertia of the oil, no friction of a piston. Nitrogen below 140 K is evaluated as at 140 K. Oil volume stays
        >= 0. Adds no capacity to its node, which needs a `Line`; stiff beside a small one (`jaxlines.implicit()`).
    Typical values: tau 1..30 s for bladders, tens of seconds for pistons, G 1e-8 (tau unverified: quoted from memory).
    Reference: Pourmovahed and Otis, "An experimental thermal time-constant correlation for hydraulic accumulators",
        ASME J. Dyn. Syst. Meas. Control 112, 1990 (equation derived from the energy balance; paper not seen).
    """

    node: str = port()
    volume: Number = quantity("m^3", low=1e-8, high=1e4, slip="was it given in litres?")
    precharge_pressure: Number = quantity(
        "Pa", low=5e4, high=6e7, slip="it is an absolute pressure in Pa; was it given in bar?", level=True
    )
    conductance: Number = quantity("m^3/(s*Pa)", low=0.0, high=1e-3, slip="was it given in L/(min bar)?")
    thermal_time_constant: Number = quantity("s", low=1e-6, slip="it is positive; infinite means adiabatic")
    wall_temperature: Number = quantity("K", low=200.0, high=450.0, slip="was it given in Celsius?", default=293.15)
    precharge_temperature: Number = quantity("K", low=200.0, high=450.0, slip="was it in Celsius?", default=293.15)
    fade: Number = quantity("1", low=1e-4, high=0.1, slip="was it given in percent?", default=0.01)
    gas: AbstractGas = Nitrogen()

    states = (State("gas_volume", "m^3", 1e-3), State("gas_temperature", "K", 100.0))

    def gas_mass(self) -> Number:
        """m_g of the precharge [kg]."""
        return self.volume * density_of(self.gas, self.precharge_pressure, self.precharge_temperature)

    def gas_pressure(self, gas_volume, gas_temperature) -> Number:
        """p_g [Pa] of the gas at a volume [m^3] and temperature [K]."""
        return self.gas.pressure(*self._gas_state(gas_volume, gas_temperature, self.gas_mass()))

    def oil_mass(self, fluid: Oil, gas_volume, gas_temperature) -> Number:
        """rho(p_g) V_o [kg] in a state of the gas."""
        return fluid.density_at(self.gas_pressure(gas_volume, gas_temperature)) * (self.volume - gas_volume)

    def start(self, at: Situation) -> dict:
        p = at.potential["node"]
        filled = self.gas_mass() / density_of(self.gas, p, self.wall_temperature)
        return {"gas_volume": jnp.minimum(filled, self.volume), "gas_temperature": self.wall_temperature + 0.0 * p}

    def evaluate(self, at: Situation) -> Contribution:
        oil, gas_mass = self.volume - at.state["gas_volume"], self.gas_mass()
        density, temperature = self._gas_state(at.state["gas_volume"], at.state["gas_temperature"], gas_mass)
        pressure, p = self.gas.pressure(density, temperature), at.potential["node"]
        mass = at.fluid.mass_flow(self._inlet_flow(p - pressure, oil), p, pressure)

        # With p_g' = -k V_g' + (dp/dT)_v (T_w - T)/tau, the mass balance of the oil is linear in V_g'.
        cooling = (self.wall_temperature - temperature) / self.thermal_time_constant
        by_temperature = self.gas.pressure_by_temperature(density, temperature)
        stiffness = isentropic_stiffness(self.gas, density, temperature) * density / gas_mass
        swelling = oil * _density_slope(at.fluid, pressure)
        rate = (swelling * by_temperature * cooling - mass) / (at.fluid.density_at(pressure) + swelling * stiffness)

        heating = temperature * by_temperature / (self.gas.heat_capacity(density, temperature) * gas_mass)
        rates = {"gas_volume": rate, "gas_temperature": cooling - heating * rate}
        return Contribution(flow={"node": -mass}, rate=rates)

    def _gas_state(self, gas_volume, gas_temperature, gas_mass):
        """Density [kg/m^3] and temperature [K] of the gas."""
        xp = array_module(self, gas_volume, gas_temperature)
        return gas_mass / xp.maximum(gas_volume, gas_mass / _DENSEST_GAS), xp.maximum(gas_temperature, self.gas.coldest)

    def _inlet_flow(self, drop, oil):
        """Volume flow in [m^3/s]: G dp, of which the outflow fades out with the last oil."""
        inward = _softplus(drop, self.fade * self.precharge_pressure)
        left = jnp.tanh(oil / (self.fade * self.volume))
        return self.conductance * (inward + left * (drop - inward))
