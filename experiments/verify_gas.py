"""Rows of the verification: accumulators and their gas."""

import numpy as np
from verify_rows import APART, FORM, PROGRAM, THIRTY, Oracle, Row, along, check

from jaxlines.physics import accumulators, nitrogen
from jaxlines.physics.component import Situation
from jaxlines.physics.fluids import Oil

COOLPROP_SOURCE = Oracle(PROGRAM, "CoolProp 8.0.0, reference equation of state of nitrogen")

# Polytropic index: gas volume [m^3] and compliance [m^3/Pa] at twice the precharge of 10 MPa, 1 litre
ACCUMULATOR = {
    1.0: ("5.000000e-4", "2.500000e-11"),
    1.2: ("5.612310e-4", "2.338463e-11"),
    1.4: ("6.095068e-4", "2.176810e-11"),
}
BWR_PRESSURES, BWR = (5, 10, 20, 30), "56.427 111.916 213.096 296.550"
# Temperature [K], pressure [MPa]: density [kg/m^3], c_v [J/(kg K)], isentropic stiffness rho a^2 [Pa]
COOLPROP = {
    (273.15, 5): ("62.6464", "757.436", "7.48454e6"),
    (273.15, 10): ("125.248", "770.105", "1.64102e7"),
    (273.15, 20): ("238.62", "789.078", "4.09059e7"),
    (273.15, 30): ("327.525", "802.733", "7.52743e7"),
    (300, 5): ("56.3445", "754.657", "7.44165e6"),
    (300, 10): ("111.725", "764.863", "1.60925e7"),
    (300, 20): ("212.537", "781.13", "3.85636e7"),
    (300, 30): ("294.781", "793.721", "6.88215e7"),
    (350, 5): ("47.6684", "752.598", "7.37825e6"),
    (350, 10): ("93.741", "760.002", "1.57017e7"),
    (350, 20): ("178.031", "772.643", "3.5996e7"),
    (350, 30): ("249.68", "783.233", "6.17359e7"),
}
COOLPROP_TOLERANCES = (0.0086, 0.024, 0.025)
BWR_LARGEST_ERROR = "0.0085"  # of the density, at 273.15 K and 30 MPa
# Density [kg/m^3], temperature [K]: p, (dp/drho)_T, (dp/dT)_v, c_v, isentropic stiffness, from the printed equation
BWR_STATES = {
    (100, 300): ("8909408.62604", "91032.6093157", "35398.3799795", "761.833508123", "14037588.2819"),
    (250, 350): ("29951864.5749", "151585.203042", "115683.762533", "765.766692833", "62363055.7848"),
}


def accumulator_rows() -> list[Row]:
    """Accumulators at twice their precharge, and full of real nitrogen."""
    rows, constant = [], Oil(1.379e9, 850.0, mass="article")
    for index, (gas, compliance) in ACCUMULATOR.items():
        case, bladder = f"1 l, 10 MPa, n {index:g}, at 20 MPa", accumulators.Accumulator("a", 1e-3, 1e7, index)
        ours = accumulators.polytropic_gas_volume(1e-3, 1e7, index, 2e7)
        rows += check("accumulators.polytropic_gas_volume", APART, [(f"gas, {case}", gas, ours)], unit="m^3")
        rows += check("accumulators.Accumulator", APART, [(f"gas, {case}", gas, bladder.gas_volume(2e7))], unit="m^3")
        ours = bladder.compliance(2e7)
        rows += check("accumulators.Accumulator", APART, [(f"dV/dp, {case}", compliance, ours)], unit="m^3/Pa")
        ours = bladder.capacity(constant, 2e7)
        rows += check(
            "accumulators.Accumulator",
            FORM,
            [(f"dm/dp, {case}", 850.0 * 1e-3 * 0.5 ** (1 / index) / (index * 2e7), ours)],
            unit="kg/Pa",
        )
    bottle = accumulators.NitrogenAccumulator("a", 1e-3, 1e7, 1e-9, 5.0, 300.0, 300.0)
    rows += check(
        "accumulators.NitrogenAccumulator",
        THIRTY,
        [("1 l, 10 MPa, 300 K: gas", "0.111916459475", bottle.gas_mass())],
        unit="kg",
    )
    squeezed = 1e-3 * 111.916459475 / 213.095595538
    pressure = bottle.gas_pressure(squeezed, 300.0)
    rows += check(
        "accumulators.NitrogenAccumulator",
        THIRTY,
        [("the same in 0.525194 l: pressure", "2.000000000e7", pressure)],
        unit="Pa",
    )
    begin = bottle.start(Situation(constant, {"node": 2e7}, {}, {}))["gas_volume"]
    return rows + check(
        "accumulators.NitrogenAccumulator", THIRTY, [("starts at 20 MPa: gas", "5.2519368e-4", begin)], unit="m^3"
    )


def nitrogen_rows() -> list[Row]:
    """Real nitrogen by its own equation, evaluated elsewhere."""
    gas, given = nitrogen.Nitrogen(), np.array(BWR_PRESSURES) * 1e6
    cases = along("300 K, {} MPa", BWR_PRESSURES, BWR, nitrogen.density_of(gas, given, 300.0))
    rows = check("nitrogen.density_of", APART, cases, unit="kg/m^3")
    units = ("Pa", "Pa m^3/kg", "Pa/K", "J/(kg K)", "Pa")
    for state, printed in BWR_STATES.items():
        ours = {
            "nitrogen_pressure": nitrogen.nitrogen_pressure(*state),
            "nitrogen_pressure_by_density": nitrogen.nitrogen_pressure_by_density(*state),
            "nitrogen_pressure_by_temperature": nitrogen.nitrogen_pressure_by_temperature(*state),
            "nitrogen_heat_capacity": nitrogen.nitrogen_heat_capacity(*state),
            "isentropic_stiffness": nitrogen.isentropic_stiffness(gas, *state),
        }
        case = f"{state[0]} kg/m^3, {state[1]} K"
        for (name, x), expected, unit in zip(ours.items(), printed, units, strict=True):
            rows += check(f"nitrogen.{name}", THIRTY, [(case, expected, x)], unit=unit)
    return rows + coolprop_rows() + ideal_gas_rows()


def coolprop_rows() -> list[Row]:
    """Real nitrogen against a reference equation of state; heat capacity and stiffness at the density of that."""
    gas, rows, found = nitrogen.Nitrogen(), [], []
    for (temperature, megapascal), printed in COOLPROP.items():
        state, density = (float(printed[0]), temperature), nitrogen.density_of(gas, megapascal * 1e6, temperature)
        found.append(density / state[0] - 1.0)
        ours = {
            "density_of": (density, "kg/m^3"),
            "nitrogen_heat_capacity": (gas.heat_capacity(*state), "J/(kg K)"),
            "isentropic_stiffness": (nitrogen.isentropic_stiffness(gas, *state), "Pa"),
        }
        case = f"{temperature:g} K, {megapascal} MPa"
        for (name, (x, unit)), expected, tolerance in zip(ours.items(), printed, COOLPROP_TOLERANCES, strict=True):
            rows += check(f"nitrogen.{name}", COOLPROP_SOURCE, [(case, expected, x)], unit=unit, relative=tolerance)
    cases = [("largest error of the density, 273..350 K, 5..30 MPa", BWR_LARGEST_ERROR, np.max(np.abs(found)))]
    return rows + check("nitrogen.Nitrogen", COOLPROP_SOURCE, cases)


def ideal_gas_rows() -> list[Row]:
    """Nitrogen as an ideal gas."""
    ideal = nitrogen.IdealGas()
    cases = [("c_v = R/(gamma - 1)", 742.0, ideal.heat_capacity(12.0, 300.0))]
    rows = check("nitrogen.IdealGas", FORM, cases, unit="J/(kg K)")
    cases = [("10 MPa, 300 K", 1e7 / (296.8 * 300.0), nitrogen.density_of(ideal, 1e7, 300.0))]
    rows += check("nitrogen.IdealGas", FORM, cases, unit="kg/m^3")
    stiffness = nitrogen.isentropic_stiffness(ideal, 12.0, 300.0)
    cases = [("stiffness gamma p, 12 kg/m^3, 300 K", 1.4 * 12.0 * 296.8 * 300.0, stiffness)]
    return rows + check("nitrogen.IdealGas", FORM, cases, unit="Pa")


TOPICS = {
    "Accumulators": accumulator_rows,
    "Gas of accumulators": nitrogen_rows,
}
