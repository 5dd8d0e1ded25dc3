"""The circuit of a waterway with a surge shaft, what of it is free, and how structures of it are compared.

    lake - tunnel (inertance, loss) - junction with shaft - penstock (inertance, loss) - turbine: measured flow

The prediction is conditional on the measured flow. The shaft's own column of water is counted with the tunnel's.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from surge_data import DENSITY, GRAVITY, Geometry, Series

import jaxlines as jl
from jaxlines.inference.distributions import LogNormal, Normal
from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, driven, port, quantity

REST_NOISE, RUN_NOISE = 600.0, 1e4
"""Weights of the pressure at rest and with the turbine running [Pa]: four times what a good model leaves over, some 150
and 2500 Pa, since neighbouring residuals are alike over some 15 s; so that geometry keeps its say."""
NUMERICS = {"interpolation": "cubic", "tolerance": 1e-5, "max_steps": 200_000}


class TaperedShaft(AbstractComponent):
    """A surge shaft whose area changes with level: dm/dp = A(z)/g, A = A_0 exp(s (z - z_0)).

    Args: node: at its foot; area A_0 at rest [m^2]; taper s [1/m]; rest_pressure at the foot at level z_0 [Pa].
    Validity: water level inside the shaft; hydrostatic. Reference: `jaxlines.OpenTank`, which is s = 0.
    """

    node: str = port()
    area: Number = quantity("m^2", low=0.1, high=1e4)
    taper: Number = quantity("1/m", low=-1.0, high=1.0)
    rest_pressure: Number = quantity("Pa", low=0.0, high=1e8)

    def evaluate(self, at: Situation) -> Contribution:
        risen = (at.potential["node"] - self.rest_pressure) / (DENSITY * GRAVITY)
        return Contribution(capacity={"node": self.area * jnp.exp(self.taper * risen) / GRAVITY})


class RigidPenstock(AbstractComponent):
    """A rigid column of water whose outflow is measured, and the gauge at its lower end.

    Q = Q_m (|Q_m|/Q_n)^k with Q_m = reading - zero;   p = p_node - I dQ/dt - R_2 Q|Q|;   tau y' = p - y

    Args: node: at its upper end; reading of the flow meter [m^3/s] and its rate [m^3/s^2]; inertance I [Pa s^2/m^3];
        quadratic_resistance R_2, losses and the velocity head at the gauge together [Pa s^2/m^6]; zero: reading at rest
        [m^3/s]; nominal Q_n, where the meter is right [m^3/s]; exponent k, 0 for a true meter [-]; lag tau of the gauge
        [s]. The state `gauge` is y, without the height between both ends.
    Validity: events slower than the wave time 4 L/c of the penstock (1.7 s for 508 m): its water hammer is left out.
    Reference: `jaxlines.FluidInertia`, with the flow given in place of the pressure.
    """

    node: str = port()
    reading: Number = driven("m^3/s", low=-1e3, high=1e3)
    rate: Number = driven("m^3/s^2", low=-1e3, high=1e3)
    inertance: Number = quantity("Pa*s^2/m^3", low=1e-3, high=1e15)
    quadratic_resistance: Number = quantity("Pa*s^2/m^6", low=0.0, high=1e12)
    zero: Number = quantity("m^3/s", low=-10.0, high=10.0)
    nominal: Number = quantity("m^3/s", low=1e-3, high=1e3)
    exponent: Number = quantity("1", low=-0.5, high=0.5)
    lag: Number = quantity("s", low=1e-3, high=1e3)

    states = (State("gauge", "Pa", 1e4),)

    def _outflow(self, at: Situation):
        """True flow, and pressure at the lower end."""
        flow = at.given["reading"] - self.zero
        share = jnp.sqrt((flow / self.nominal) ** 2 + 1e-6)
        bent = jnp.exp(self.exponent * jnp.log(share))
        true = flow * bent
        lost = self.quadratic_resistance * true * abs(true)
        return true, at.potential["node"] - lost - self.inertance * (1.0 + self.exponent) * bent * at.given["rate"]

    def start(self, at: Situation) -> dict:
        return {"gauge": self._outflow(at)[1]}

    def evaluate(self, at: Situation) -> Contribution:
        true, pressure = self._outflow(at)
        mass = at.fluid.density_at(at.potential["node"]) * true
        return Contribution({"node": -mass}, {}, {"gauge": (pressure - at.state["gauge"]) / self.lag})


def circuit(geometry: Geometry, series: Series) -> jl.Circuit:
    """The waterway with numbers of its drawing; pressures are counted from the foot of the shaft."""
    water = jl.Oil(bulk_modulus=2.1e9, density=DENSITY, kinematic_viscosity=1.5e-6, mass="article")
    rest = water.atmospheric_pressure + DENSITY * GRAVITY * geometry.rest_height
    inertance, top = geometry.tunnel_inertance + geometry.shaft_inertance, float(series.flow.max())
    return jl.Circuit(
        water,
        {
            "lake": jl.Tank("intake", rest),
            "tunnel": jl.FluidInertia("intake", "junction", inertance, 0.0, geometry.tunnel_loss),
            "shaft": TaperedShaft("junction", geometry.shaft_area, 0.0, rest),
            "penstock": RigidPenstock(
                "junction", "flow", "flow_rate", geometry.penstock_inertance, 55.0, resting_flow(series), top, 0.0, 0.3
            ),
            "gauge": jl.StateSensor("penstock.gauge", offset=float(series.pressure[series.resting].mean() - rest)),
        },
    )


def resting_flow(series: Series) -> float:
    """What the flow meter shows at rest [m^3/s]."""
    return float(np.median(series.flow[series.resting]))


def common(geometry: Geometry, offset: float, rest: float) -> list[jl.Free]:
    """What is free in every structure. Priors: inertances by the drawing within 5 and 10 %, the shaft within 20 %."""
    inertance = geometry.tunnel_inertance + geometry.shaft_inertance
    penstock, area = geometry.penstock_inertance, geometry.shaft_area

    def about(path, middle, spread):
        ends = (0.2 * middle, 5.0 * middle)
        return jl.Free(path, ends, middle, transform="log", prior=LogNormal(middle, spread))

    return [
        about("tunnel.inertance", inertance, 0.05),
        about("penstock.inertance", penstock, 0.1),
        about("shaft.area", area, 0.2),
        jl.Free("tunnel.quadratic_resistance", (1.0, 500.0), 25.0, transform="log"),
        jl.Free("penstock.quadratic_resistance", (1.0, 500.0), 55.0, transform="log"),
        jl.Free("gauge.offset", (offset - 3e5, offset + 3e5), offset),
        jl.Free("initial.tunnel.volume_flow", (-1.0, 1.0), 0.0),
        jl.Free("initial.junction.pressure", (rest - 5e4, rest + 5e4), rest),
    ]


TAPER = jl.Free("shaft.taper", (-0.1, 0.1), 0.01, prior=Normal(0.0, 0.03))
EXPONENT = jl.Free("penstock.exponent", (-0.4, 0.4), 0.0, prior=Normal(0.0, 0.1))
LAG = jl.Free("penstock.lag", (0.2, 10.0), 1.0, transform="log", prior=LogNormal(1.0, 0.5))
DELAY = jl.Free(("flow.delay", "flow_rate.delay"), (-10.0, 10.0), 0.0, prior=Normal(0.0, 1.0))
STRUCTURES = {
    "constant shaft": [],
    "tapered shaft": [TAPER],
    "tapered shaft, meter exponent": [TAPER, EXPONENT],
    "tapered shaft, meter exponent, lag and delay": [TAPER, EXPONENT, LAG, DELAY],
}


@dataclasses.dataclass(frozen=True)
class Waterway:
    """Circuit, recording and start values of a series; `free_of` says what is free in a structure."""

    geometry: Geometry
    series: Series

    @property
    def circuit(self) -> jl.Circuit:
        """See `circuit`."""
        return circuit(self.geometry, self.series)

    @property
    def rest_pressure(self) -> float:
        """Absolute pressure at the foot of the shaft at rest [Pa]."""
        return float(jl.Oil(1e9, DENSITY).atmospheric_pressure + DENSITY * GRAVITY * self.geometry.rest_height)

    def free_of(self, structure: str) -> list[jl.Free]:
        """Free parameters of a structure."""
        gauge = float(self.series.pressure[self.series.resting].mean()) - self.rest_pressure
        return [*common(self.geometry, gauge, self.rest_pressure), *STRUCTURES[structure]]

    def recording(self, used=None) -> jl.Recording:
        """The series as a recording, with noise levels; `used`: samples of the pressure that a fit may see."""
        series = self.series
        noise = np.where(series.resting, REST_NOISE, RUN_NOISE)
        mask = {} if used is None else {"gauge": used}
        channels = {"gauge": series.pressure, "flow": series.flow, "flow_rate": np.gradient(series.flow, series.times)}
        return jl.Recording(series.times, channels, mask, "plant", noise={"gauge": noise})

    def fit(self, structure: str, used=None):
        """Fit a structure."""
        recording, free = self.recording(used), self.free_of(structure)
        return jl.fit(self.circuit, recording, free=free, check=False, **NUMERICS)


def rest_period(inertance, area):
    """Period of small surges at rest [s]: 2 pi sqrt(I A_0/(rho g)), I of tunnel and shaft [Pa s^2/m^3]."""
    return 2.0 * np.pi * np.sqrt(inertance * area / (DENSITY * GRAVITY))
