"""The equations (1)-(12) of the article, by name.

Reference for all of them: "Dynamic Modeling of Fluid Transmission Lines of the DSN 70-Meter Antennas by
Using a Lumped Parameter Model", The Telecommunications and Data Acquisition Progress Report, NASA Jet
Propulsion Laboratory (equation numbers as printed there). SI units, absolute pressure. Every function
works element by element on NumPy and JAX arrays.
"""

from jaxlines.physics.fields import array_module


def pressure_change(bulk_modulus, density_change, mean_density):
    """Equation of state, eq. (1): dP = beta drho / rho_0 [Pa].

    Args: bulk_modulus beta [Pa]; density_change drho [kg/m^3]; mean_density rho_0 [kg/m^3].
    Valid for density changes small against rho_0.
    """
    return bulk_modulus * density_change / mean_density


def series_modulus(container_modulus, fluid_modulus):
    """Effective bulk modulus of a fluid in its container, eq. (2): 1/beta = 1/beta_c + 1/beta_f [Pa].

    An infinite `container_modulus` is a rigid container. Typical: 1.3e9 Pa for oil in a thick steel pipe.
    """
    return 1.0 / (1.0 / container_modulus + 1.0 / fluid_modulus)


def ideal_gas_modulus(heat_ratio, density, gas_constant, temperature):
    """Adiabatic bulk modulus of an ideal gas, eq. (3): beta_f = gamma rho_0 R theta_0 [Pa].

    Args: heat_ratio gamma [-] (1 gives the isothermal modulus, which is the pressure); density rho_0
    [kg/m^3]; gas_constant R [J/(kg K)] (air: 287.05); temperature theta_0 [K].
    Valid for small changes about the mean state. Typical: 1.419e5 Pa for air at 1 atm.
    """
    return heat_ratio * density * gas_constant * temperature


def conduit_modulus(inner_radius, wall_thickness, youngs_modulus, poissons_ratio):
    """Bulk modulus of a thick-walled circular conduit, eq. (4) [Pa].

    1/beta_c = 2/(E d) [(1 + nu)(a + d)^2 + (1 - nu) a^2] / (2 a + d)

    Args: inner_radius a [m]; wall_thickness d [m]; youngs_modulus E [Pa]; poissons_ratio nu [-].
    It is Lame's solution with no axial stress and counts the hoop strain only; a tube with capped ends
    gives the same number when nu = 1/4. Typical: 3.1e10 Pa for a 2-in schedule 160 steel pipe.
    """
    a, d = inner_radius, wall_thickness
    shape = ((1 + poissons_ratio) * (a + d) ** 2 + (1 - poissons_ratio) * a**2) / (2 * a + d)
    return youngs_modulus * d / (2.0 * shape)


def combined_modulus(volumes, moduli):
    """Effective bulk modulus of connected containers, eq. (5): V_0/beta = sum V_i/beta_i [Pa].

    Args: volumes V_i [m^3], shape (containers,); moduli beta_i [Pa], the same shape.
    """
    xp = array_module(volumes, moduli)
    volumes, moduli = xp.asarray(volumes), xp.asarray(moduli)
    return xp.sum(volumes) / xp.sum(volumes / moduli)


def pressure_rate_from_density(bulk_modulus, mean_density, density_rate):
    """Eq. (6): dP/dt = (beta/rho_0) drho/dt [Pa/s]."""
    return bulk_modulus / mean_density * density_rate


def density_rate(mean_density, volume, flow_in, flow_out, volume_rate=0.0):
    """Continuity of a control volume, eq. (7): drho/dt = (rho_0/V_0)(Q_in - Q_out - dV_0/dt) [kg/(m^3 s)]."""
    return mean_density / volume * (flow_in - flow_out - volume_rate)


def pressure_rate(bulk_modulus, volume, flow_in, flow_out):
    """Capacitance equation, eqs. (8) and (12): dP/dt = (beta/V_0)(Q_in - Q_out) [Pa/s].

    Args: bulk_modulus beta, effective [Pa]; volume V_0 [m^3]; flow_in, flow_out: sums of flows [m^3/s].
    The container's elasticity is inside beta, so that dV_0/dt is zero. Not mass-conserving where beta
    depends on pressure; the simulator's nodes use the mass balance, which reduces to this equation.
    """
    return line_constant(bulk_modulus, volume) * (flow_in - flow_out)


def line_constant(bulk_modulus, volume):
    """The constant K = beta/V_0 of eqs. (12)-(16) [N/m^5 = Pa/m^3]. Typical: 5e10 for an antenna's line."""
    return bulk_modulus / volume


def wave_speed(bulk_modulus, density):
    """Speed of pressure waves, eq. (9): c_0 = sqrt(beta/rho_0) [m/s]. Typical: 1250 m/s in a steel pipe."""
    return array_module(bulk_modulus, density).sqrt(bulk_modulus / density)


def round_trip_time(length, speed):
    """Time of a wave down the line and back, eq. (10): tau = 2 L/c_0 [s]."""
    return 2.0 * length / speed


def lumped_model_is_valid(length, speed, highest_frequency):
    """The article's condition, eq. (11): 2 L/c_0 < 1/f.

    Args: length L [m]; speed c_0 [m/s]; highest_frequency f of any oscillation in the system [Hz].
    Necessary, far from sufficient: it says only that the line is shorter than half a wavelength. See
    `jaxlines.physics.validity.lumped_impedance_error` for the error that is actually made.
    """
    return round_trip_time(length, speed) * highest_frequency < 1.0
