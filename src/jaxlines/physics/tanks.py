"""Water systems: open tanks and surge shafts, in which gravity is what stores."""

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import GRAVITY, Number, port, quantity
from jaxlines.physics.fluids import Oil
from jaxlines.physics.resistances import orifice_flow


def gravity_capacity(area) -> Number:
    """dm/dp = A/g of a tank with a free surface [kg/Pa]: p = p_atm + rho g z and m = rho A z, whatever the density.

    Args: area A of the free surface [m^2].
    Validity: vertical walls, water at rest (its inertia belongs to a `FluidInertia` or a `Line`).
    Reference: hydrostatics; Wylie and Streeter, "Fluid Transients in Systems", 1993 (surge tanks; chapter unverified:
        quoted from memory).
    """
    return area / GRAVITY


def depth_of_water(fluid: Oil, p) -> Number:
    """Depth of an open tank with absolute pressure p [Pa] at its foot: (p - p_atm)/(rho(p_atm) g) [m]."""
    return (p - fluid.atmospheric_pressure) / (fluid.density_at(fluid.atmospheric_pressure) * GRAVITY)


def foot_pressure(fluid: Oil, depth) -> Number:
    """Absolute pressure at the foot of an open tank that is so deep [m]: p_atm + rho(p_atm) g z [Pa]."""
    return fluid.atmospheric_pressure + fluid.density_at(fluid.atmospheric_pressure) * GRAVITY * depth


def _area():
    """Field: area of a free surface [m^2]."""
    return quantity("m^2", low=1e-8, high=1e10, slip="was it given in cm^2?")


def _bottom():
    """Field: elevation of the foot [m]."""
    return quantity("m", low=-1e4, high=1e4, default=0.0)


class OpenTank(AbstractComponent):
    """A tank with a free surface at atmospheric pressure, or an open shaft without throttle: a capacity at its foot.

    dm/dp = A/g, level z = bottom + (p - p_atm)/(rho g). A `LevelSensor` with the same `bottom` shows the level.

    Args: node: at its foot; area A of the free surface [m^2]; bottom: elevation of the foot above datum [m], which
        only the level counts from (heights between nodes belong to the elevation of a `Line`).
    Validity: vertical walls; never empty (the pressure at the foot would fall below atmosphere) and never overflowing.
    Typical values: laboratory 0.01..1 m^2, surge shafts of power stations 10..1000 m^2 (unverified: from memory).
    Reference: see `gravity_capacity`.
    """

    node: str = port()
    area: Number = _area()
    bottom: Number = _bottom()

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution(capacity={"node": gravity_capacity(self.area) + 0.0 * at.potential["node"]})

    def level(self, fluid: Oil, p) -> Number:
        """Elevation of the free surface above datum [m] when the foot has the absolute pressure p [Pa]."""
        return self.bottom + depth_of_water(fluid, p)

    def pressure_at(self, fluid: Oil, level) -> Number:
        """Absolute pressure at the foot [Pa] when the free surface has this elevation above datum [m]."""
        return foot_pressure(fluid, level - self.bottom)


class SurgeShaft(AbstractComponent):
    """A shaft with a free surface behind a throttle: its level is a state.

    Q = C_d A_t sqrt(2 (p - p_foot)/rho), smooth through zero, p_foot = p_atm + rho g (z - bottom), z' = m'/(rho A).

    Args: node: below the throttle (it needs a capacity of its own); area A of the free surface [m^2]; throttle_area
        A_t [m^2]; discharge_coefficient C_d [-]; transition: laminar below this pressure difference [Pa]; bottom:
        elevation of the foot above datum [m]. Without a throttle use an `OpenTank`.
    Starts at the level that balances the node's pressure.
    Validity: as `OpenTank`; the same throttle in both directions.
    Typical values: throttle 5..30 % of the tunnel's section (unverified: quoted from memory).
    Reference: see `gravity_capacity` and `orifice_flow`.
    """

    node: str = port()
    area: Number = _area()
    throttle_area: Number = quantity("m^2", low=0.0, high=1e4, slip="was it given in cm^2?")
    discharge_coefficient: Number = quantity("1", low=0.01, high=2.0, default=0.62)
    transition: Number = quantity("Pa", low=1e-3, high=1e7, default=10.0)
    bottom: Number = _bottom()

    states = (State("level", "m", 1.0),)

    def start(self, at: Situation) -> dict:
        return {"level": self.bottom + depth_of_water(at.fluid, at.potential["node"])}

    def evaluate(self, at: Situation) -> Contribution:
        fluid, p = at.fluid, at.potential["node"]
        foot = foot_pressure(fluid, at.state["level"] - self.bottom)
        density = fluid.density_at(0.5 * (p + foot))
        throttle = (self.throttle_area, self.discharge_coefficient, density)
        mass = density * orifice_flow(*throttle, p, foot, self.transition)
        rising = mass / (fluid.density_at(fluid.atmospheric_pressure) * self.area)
        return Contribution(flow={"node": -mass}, rate={"level": rising})
