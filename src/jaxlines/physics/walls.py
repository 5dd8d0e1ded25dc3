"""Bulk moduli K_c = V dp/dV of circular walls, by axial restraint, thickness and data sheet.

A wall in series with the fluid, or a liner in series with what carries it, is `article.series_modulus`.
"""

from jaxlines.physics.article import conduit_modulus
from jaxlines.physics.fields import array_module, check_range, is_concrete

RESTRAINTS = ("expansion_joints", "upstream", "throughout", "capped")
"""How a conduit is held along its axis: free to slide at joints (no axial stress), anchored at its upstream end
only (axial stress of a closed end), anchored throughout (no axial strain), closed ends free to grow in length."""


def check_restraint(restraint: str) -> None:
    """Raise ValueError for a restraint that is not known."""
    if restraint not in RESTRAINTS:
        raise ValueError(f"restraint must be one of {', '.join(RESTRAINTS)}, got {restraint!r}")


def thick_wall_modulus(inner_radius, wall_thickness, youngs_modulus, poissons_ratio, restraint="expansion_joints"):
    """Bulk modulus of a thick-walled circular conduit [Pa].

    1/K_c = (2/E)(h + nu) + (q/E) {0 | -2 nu | -4 nu^2 | 1 - 4 nu},
    h = (r_o^2 + r_i^2)/(r_o^2 - r_i^2), q = r_i^2/(r_o^2 - r_i^2)

    for expansion joints (eq. (4) of the article), anchored upstream, anchored throughout, capped.

    Args: inner_radius r_i, wall_thickness [m]; youngs_modulus E [Pa]; poissons_ratio nu [-]; restraint, see
        `RESTRAINTS`. "capped" counts the growth in length, so that it is the modulus of the whole volume; the
        others count the hoop strain, as a travelling wave sees it.
    Validity: elastic, homogeneous wall, any thickness, small strains, no motion of the wall's mass.
    Typical values: 3e10..5e10 Pa for schedule 160 steel pipes.
    Reference: Lame's solution; Wylie and Streeter, "Fluid Transients in Systems", 1993, ch. 3 (the case names).
    """
    check_restraint(restraint)
    free = conduit_modulus(inner_radius, wall_thickness, youngs_modulus, poissons_ratio)
    area_ratio = inner_radius**2 / (wall_thickness * (2.0 * inner_radius + wall_thickness))
    axial = {
        "expansion_joints": 0.0,
        "upstream": -2.0 * poissons_ratio,
        "throughout": -4.0 * poissons_ratio**2,
        "capped": 1.0 - 4.0 * poissons_ratio,
    }
    return 1.0 / (1.0 / free + axial[restraint] * area_ratio / youngs_modulus)


def thin_wall_modulus(inner_diameter, wall_thickness, youngs_modulus, poissons_ratio, restraint="expansion_joints"):
    """Bulk modulus of a thin-walled circular conduit [Pa]: 1/K_c = zeta D/(E e).

    zeta = 1 | 1 - nu/2 | 1 - nu^2 | 5/4 - nu for expansion joints, anchored upstream, anchored throughout, capped
    (the limits of `thick_wall_modulus`).

    Args: inner_diameter D, wall_thickness e [m]; youngs_modulus E [Pa]; poissons_ratio nu [-]; restraint, see
        `RESTRAINTS`.
    Validity: D/e above about 25 (unverified: quoted from memory); for schedule 160 pipes (D/e about 4) it is 34 to
        53 % too stiff.
    Typical values: 8.9e9 Pa for a copper tube of 22.1 mm bore and 1.63 mm wall (E 1.2e11 Pa).
    Reference: Wylie and Streeter, "Fluid Transients in Systems", 1993, ch. 3.
    """
    check_restraint(restraint)
    zeta = {
        "expansion_joints": 1.0,
        "upstream": 1.0 - 0.5 * poissons_ratio,
        "throughout": 1.0 - poissons_ratio**2,
        "capped": 1.25 - poissons_ratio,
    }
    return youngs_modulus * wall_thickness / (zeta[restraint] * inner_diameter)


def modulus_from_expansion(area, expansion, pressure):
    """Bulk modulus of a hose's wall from its volumetric expansion [Pa]: K_c = p/ln(1 + dV/A).

    It is the constant modulus K_c = V dp/dV by which the volume grows from A to A + dV per metre; for small
    expansions A p/dV.

    Args: area A of the bore [m^2]; expansion dV, growth of volume per metre of hose [m^3/m] (data sheets:
        1 cm^3/m = 1e-6); pressure p above atmosphere at which it was measured [Pa].
    Raises: ValueError when a concrete expansion is zero or exceeds the bore, or the pressure is no hydraulic one.
    Validity: the mean over 0..p; braided hoses stiffen with pressure, and are stiffer in fast events than in the
        static test of data sheets.
    Typical values: 5e7..1e9 Pa (unverified: quoted from memory).
    Reference: definition of the modulus.
    """
    if is_concrete(area) and is_concrete(expansion):
        limits = {"unit": "m^3/m", "low": 1e-12, "high": area, "slip": "was it given in cm^3/m?"}
        check_range("expansion", expansion, limits)
    check_range("pressure", pressure, {"unit": "Pa", "low": 1e4, "high": 1e9, "slip": "was it given in bar or MPa?"})
    return pressure / array_module(area, expansion, pressure).log1p(expansion / area)
