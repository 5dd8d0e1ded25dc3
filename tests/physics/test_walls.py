"""Wall moduli against tabulated numbers, textbook forms, limits and Lame's stresses."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from jaxlines import Pipe
from jaxlines.physics.walls import RESTRAINTS, modulus_from_expansion, thick_wall_modulus, thin_wall_modulus

INCH, YOUNG, NU = 0.0254, 2.0684e11, 0.25

# Schedule 160 pipes: inner, outer diameter [in]; K_c [Pa] with joints, anchored upstream, throughout; thin wall.
PIPES = {
    "1": (0.815, 1.315, 4.14116e10, 4.41692e10, 4.27460e10, 6.3448e10),
    "1.5": (1.338, 1.900, 3.21423e10, 3.48026e10, 3.34196e10, 4.3439e10),
    "2": (1.687, 2.375, 3.14660e10, 3.41080e10, 3.27338e10, 4.2177e10),
}
bores = st.floats(1e-3, 1.0)
shares = st.floats(1e-3, 2.0)  # wall thickness per bore
poisson = st.floats(0.0, 0.5)


@pytest.mark.parametrize("size", PIPES)
def test_tabulated_moduli(size):
    inner, outer, joints, upstream, throughout, thin = PIPES[size]
    wall = 0.5 * (outer - inner) * INCH
    for restraint, expected in zip(RESTRAINTS, (joints, upstream, throughout, joints), strict=True):  # 1 - 4 nu = 0
        assert thick_wall_modulus(0.5 * inner * INCH, wall, YOUNG, NU, restraint) == pytest.approx(expected, rel=2e-6)
        pipe = Pipe(1.0, inner * INCH, outer * INCH, YOUNG, NU, restraint=restraint)
        assert pipe.container_modulus() == pytest.approx(expected, rel=2e-6)
    assert thin_wall_modulus(inner * INCH, wall, YOUNG, NU) == pytest.approx(thin, rel=2e-5)
    assert Pipe(1.0, inner * INCH, outer * INCH, YOUNG, NU, wall="thin").container_modulus() == pytest.approx(
        thin, rel=2e-5
    )


@settings(max_examples=50, deadline=None)
@given(bores, shares, poisson)
def test_textbook_form_of_the_thick_wall(bore, share, nu):
    """1/K_c = (D/(E e)) c_1, c_1 = (2 e/D)(1 + nu) + (D/(D + e)) {1 | 1 - nu/2 | 1 - nu^2} (Wylie and Streeter)."""
    wall = share * bore
    for restraint, zeta in zip(RESTRAINTS, (1.0, 1 - nu / 2, 1 - nu * nu), strict=False):
        c = 2 * share * (1 + nu) + zeta / (1 + share)
        modulus = thick_wall_modulus(0.5 * bore, wall, YOUNG, nu, restraint)
        assert modulus == pytest.approx(YOUNG * share / c, rel=1e-11)


@settings(max_examples=50, deadline=None)
@given(bores, shares, poisson)
def test_capped_tube_has_lames_strains(bore, share, nu):
    """Hoop and axial strain at the bore from sigma_r = -p, sigma_th = p h, sigma_z = p q."""
    inner, outer = 0.5 * bore, (0.5 + share) * bore
    h = (outer**2 + inner**2) / (outer**2 - inner**2)
    q = inner**2 / (outer**2 - inner**2)
    hoop, axial = (h - nu * (q - 1)) / YOUNG, (q - nu * (h - 1)) / YOUNG
    modulus = thick_wall_modulus(inner, outer - inner, YOUNG, nu, "capped")
    assert modulus == pytest.approx(1 / (2 * hoop + axial), rel=1e-8)


@pytest.mark.parametrize("restraint", RESTRAINTS)
def test_thin_wall_is_the_limit_of_the_thick_one(restraint):
    for share, tolerance in ((1e-2, 4e-2), (1e-4, 4e-4)):
        thick = thick_wall_modulus(0.5, share, YOUNG, 0.3, restraint)
        thin = thin_wall_modulus(1.0, share, YOUNG, 0.3, restraint)
        assert thick < thin
        assert thick == pytest.approx(thin, rel=tolerance)


@settings(max_examples=50, deadline=None)
@given(st.floats(4e-3, 0.1), st.floats(1e-7, 0.9), st.floats(1e5, 5e7))
def test_hose_expands_as_its_data_sheet_says(bore, share, pressure):
    area = np.pi / 4 * bore**2
    modulus = modulus_from_expansion(area, share * area, pressure)
    assert area * np.expm1(pressure / modulus) == pytest.approx(share * area, rel=1e-9)
    if share < 1e-3:
        assert modulus == pytest.approx(pressure / share, rel=1e-3)


def test_wrong_walls_are_refused():
    with pytest.raises(ValueError, match=r"restraint must be one of expansion_joints, .* got 'anchored'"):
        thick_wall_modulus(0.01, 0.002, YOUNG, NU, "anchored")
    with pytest.raises(ValueError, match=r"restraint must be one of expansion_joints, .* got 'free'"):
        thin_wall_modulus(0.01, 0.002, YOUNG, NU, "free")
    with pytest.raises(ValueError, match=r"expansion must be .* got 2 m\^3/m: was it given in cm.3/m"):
        modulus_from_expansion(5e-4, 2.0, 1e7)
    with pytest.raises(ValueError, match=r"expansion must be .* got 0 m"):
        modulus_from_expansion(5e-4, 0.0, 1e7)
    with pytest.raises(ValueError, match=r"pressure must be .* got 100 Pa: was it given in bar or MPa"):
        modulus_from_expansion(5e-4, 2e-6, 100.0)
