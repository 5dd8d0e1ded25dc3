"""What a container full of fluid stores: its capacity, and what its slow states release into its node."""

from typing import Any, NamedTuple

from jaxlines.physics.containers import capacity, delayed_strain_rate, volume_at
from jaxlines.physics.fluids import Oil


class Stored(NamedTuple):
    """Capacity dm/dp [kg/Pa], apparent mass flow out of slow states into the node [kg/s], rates of those states."""

    capacity: Any
    release: Any
    rates: dict[str, Any]


def stored(container: Any, fluid: Oil, p, strain=None, undissolved=None, share: Any = 1.0) -> Stored:
    """The mass balance of a share of a container whose mass m = rho(p, theta) V(p, eps) has slow states.

    dm/dp p' = sum of mass flows - (dm/deps) eps' - (dm/dtheta) theta', with dm/deps = m for the delayed strain of a
    visco-elastic wall and dm/dtheta = -m (dv/dtheta)/v for the undissolved fraction of the air; so mass is conserved.

    Args: container: an `AbstractContainer`; p absolute [Pa]; strain: delayed strain of the wall eps [-], None without
        one; undissolved: fraction of the air that is not dissolved theta [-], None when the fluid's air has no
        kinetics; share of the container [-].
    """
    given = 0.0 if strain is None else strain
    mass = share * fluid.density_at(p, undissolved) * volume_at(container, fluid, p, given)
    release, rates = 0.0 * mass, {}
    if strain is not None:
        rates["delayed_strain"] = delayed_strain_rate(container, fluid, p, strain)
        release = release - mass * rates["delayed_strain"]
    if undissolved is not None:
        rates["undissolved_air"] = fluid.undissolved_rate(p, undissolved)
        swelling = fluid.gas_volume(p) / fluid.specific_volume(p, undissolved)
        release = release + mass * swelling * rates["undissolved_air"]
    return Stored(share * capacity(container, fluid, p, given, undissolved), release, rates)


def resting_strain(container: Any, fluid: Oil, p):
    """The delayed strain [-] of a wall that has long been at a pressure [Pa]."""
    return (p - fluid.atmospheric_pressure) * container.delayed_compliance()
