"""Weighting functions of frequency-dependent laminar and turbulent friction, as sums of exponentials.

In unsteady pipe flow the pressure gradient of friction is the steady one and a memory of the acceleration:

    dp/dx = (8 mu/R^2) V + (4 mu/R^2) int_0^t W(tau(t - u)) dV/du du,    tau = nu t/R^2

With W(tau) = sum_i m_i exp(-n_i tau) every term is one state of a line,
dy_i/dt = -(n_i nu/R^2) y_i + m_i dV/dt, and the gradient of the memory is (4 mu/R^2) sum_i y_i.

Reference: Zielke, "Frequency-dependent friction in transient pipe flow", J. Basic Engineering 90, 1968.
"""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import numpy as np

from jaxlines.physics.fields import Number, array_module, check_fields, quantity

_ROOT_PI = np.sqrt(np.pi)
SHORT_TIME = (0.5 / _ROOT_PI, -1.25, 1.875 / _ROOT_PI, 0.9375, 0.703125 / _ROOT_PI, -0.3515625)
"""Coefficients of tau^(-1/2), tau^0, tau^(1/2), ... of Zielke's weighting function for short times."""

_ZEROS = 400
_SWITCH = 1e-4  # above it the terms left out are below exp(-150), below it the short series is good to 1e-11


def zielke_weight(tau):
    """Exact weighting function of laminar flow [-], on the host: W = sum_k exp(-j_k^2 tau), J_2(j_k) = 0.

    Args: tau = nu t/R^2 > 0 [-]. Below 1e-4 the series in sqrt(tau), see `SHORT_TIME`.
    Validity: fully developed laminar flow at the start. Within 1e-11 of the infinite sum.
    Typical values: 26.970 at tau 1e-4, 0.9140 at 0.02, 0.0724 at 0.1.
    Reference: Zielke 1968, eqs. (39) and (40); the zeros are computed, not the printed ones.
    """
    from scipy.special import jn_zeros

    tau = np.asarray(tau, dtype=float)
    root = np.sqrt(tau)
    short = sum(m * root**i for i, m in enumerate(SHORT_TIME)) / root
    exponents = jn_zeros(2, _ZEROS) ** 2
    long = np.sum(np.exp(-exponents * np.maximum(tau, _SWITCH)[..., None]), axis=-1)
    return np.where(tau < _SWITCH, short, long)


class AbstractWeighting(eqx.Module):
    """A weighting function W(tau) = sum_i m_i exp(-n_i tau), by its coefficients."""

    laminar: ClassVar[bool] = True  # whether it belongs to laminar mean flow

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def coefficients(self) -> tuple[Number, Number]:
        """(m, n), each of shape (terms,), from the slowest term to the fastest [-]."""

    def weight(self, tau):
        """W(tau) [-], tau = nu t/R^2, element by element."""
        xp = array_module(self, tau)
        return sum(m * xp.exp(-n * tau) for m, n in zip(*self.coefficients(), strict=True))

    def transform(self, w):
        """Laplace transform of W in tau [-]: sum_i m_i/(w + n_i), w = s R^2/nu, element by element."""
        return sum(m / (w + n) for m, n in zip(*self.coefficients(), strict=True))


def _leading(table, terms):
    """The slowest `terms` columns of a table of (m, n)."""
    m, n = table
    return np.array(m[:terms]), np.array(n[:terms])


def _check_terms(terms: int, low: int, high: int) -> None:
    """Raise ValueError when a number of terms is not one the set has."""
    if not isinstance(terms, int) or not low <= terms <= high:
        raise ValueError(f"terms must be a whole number {low}..{high}, got {terms!r}")


class TrikhaWeights(AbstractWeighting):
    """Trikha's three terms, the cheapest.

    Error of W: 0.2 % at tau = 1e-4, 1 % at 1e-3, +11 % at 1e-2, up to 38 % between 1e-3 and 0.3; useless below
    1e-4. Use where the decay of a few oscillations is wanted roughly.
    Reference: Trikha, "An efficient method for simulating frequency-dependent friction in transient liquid
    flow", J. Fluids Engineering 97, 1975, pp. 97-105 (coefficients unverified: quoted from memory).
    """

    def coefficients(self):
        return np.array([1.0, 8.1, 40.0]), np.array([26.4, 200.0, 8000.0])


class SchohlWeights(AbstractWeighting):
    """Schohl's five terms, fitted.

    Error of W: at most 5.4 % for tau > 1e-5 (up to 0.3).
    Reference: Schohl, "Improved approximate method for simulating frequency-dependent friction in transient
    laminar flow", J. Fluids Engineering 115, 1993 (coefficients unverified: quoted from memory).
    """

    def coefficients(self):
        return np.array([1.051, 2.358, 9.021, 29.47, 79.55]), np.array([26.65, 100.0, 669.6, 6497.0, 57990.0])


_KAGAWA = (
    (1.0, 1.16725, 2.20064, 3.92861, 6.78788, 11.6761, 20.0612, 34.4541, 59.1642, 101.590),
    (26.3744, 72.8033, 187.424, 536.626, 1570.60, 4618.13, 13601.1, 40082.5, 118153.0, 348316.0),
)


class KagawaWeights(AbstractWeighting):
    """Kagawa's ten terms, of which the slowest `terms` are used: the default for laminar flow.

    Error of W with all ten: at most 0.30 % for tau in 1e-5..0.3. A term matters for times longer than
    R^2/(n nu); terms that are much faster than the input only make the equations stiff.
    Reference: Kagawa, Lee, Kitagawa and Takenaka, "High speed and accurate computing method of
    frequency-dependent friction in laminar pipe flow for characteristics method", Trans. JSME 49(447), 1983
    (coefficients unverified: quoted from memory; the error above is checked).
    """

    terms: int = eqx.field(static=True, default=10)

    def __check_init__(self):
        _check_terms(self.terms, 1, 10)

    def coefficients(self):
        return _leading(_KAGAWA, self.terms)


_VITKOVSKY = (
    (1.02700, 1.31342, 2.14832, 3.70620, 6.37762, 10.9363, 18.7309, 32.0736, 55.1523, 99.4544),
    (26.5976, 78.6005, 202.234, 540.226, 1501.07, 4267.16, 12286.9, 35639.2, 103956.0, 309336.0),
)


class VitkovskyWeights(AbstractWeighting):
    """Ten terms for laminar flow, fitted to Zielke's function; the slowest `terms` are used.

    Error of W with all ten: below 0.03 % for tau in 1e-5..0.1, 1.8 % at 0.2, 3.9 % at 0.3.
    Reference: Vitkovsky, Stephens, Bergant, Lambert and Simpson, "Efficient and accurate calculation of Zielke
    and Vardy-Brown unsteady friction in pipe transients", 9th Int. Conf. on Pressure Surges, BHR Group, 2004.
    """

    terms: int = eqx.field(static=True, default=10)

    def __check_init__(self):
        _check_terms(self.terms, 1, 10)

    def coefficients(self):
        return _leading(_VITKOVSKY, self.terms)


_VARDY_BROWN = (
    (5.03362, 6.48760, 10.7735, 19.9040, 37.4754, 70.7117, 133.460, 251.933, 476.597, 932.860),
    (4.78793, 51.0897, 210.868, 765.030, 2731.01, 9731.44, 34668.5, 123511.0, 440374.0, 1590300.0),
)


class VitkovskyTurbulentWeights(AbstractWeighting):
    """Ten terms for turbulent flow in a smooth pipe at one Reynolds number: m = A* m*, n = n* + B*.

    They approximate Vardy and Brown's W(tau) = A* exp(-B* tau)/sqrt(tau) with A* = 1/(2 sqrt(pi)) and
    B* = Re^kappa/12.86, kappa = log10(15.29/Re^0.0567).

    Args: reynolds_number of the mean flow before the transient [-]; terms: how many, from the slowest.
    Error of W against that formula: below 0.2 % for tau in 1e-6..0.1.
    Validity: smooth pipe, Re 2e3..1e8, the turbulence frozen as in the mean flow.
    Typical values: B* = 526 at Re 1e4.
    Reference: Vitkovsky et al. 2004 (see `VitkovskyWeights`) for m*, n*; Vardy and Brown, "Transient
    turbulent friction in smooth pipe flows", J. Sound and Vibration 259, 2003, for A* and B* (these
    unverified: quoted from memory).
    """

    reynolds_number: Number = quantity("1", low=2e3, high=1e8, slip="is the flow laminar?")
    terms: int = eqx.field(static=True, default=10)

    laminar = False

    def __check_init__(self):
        _check_terms(self.terms, 1, 10)

    def shear_decay(self) -> Number:
        """B* [-]: how fast turbulent mixing forgets an acceleration."""
        xp = array_module(self)
        log_reynolds = xp.log(self.reynolds_number)
        kappa = (np.log(15.29) - 0.0567 * log_reynolds) / np.log(10.0)
        return xp.exp(kappa * log_reynolds) / 12.86

    def coefficients(self):
        xp, decay = array_module(self), self.shear_decay()
        m, n = _leading(_VARDY_BROWN, self.terms)
        return xp.stack([0.5 / _ROOT_PI * k + 0.0 * decay for k in m]), xp.stack([k + decay for k in n])


class JohnstonWeights(AbstractWeighting):
    """Terms in geometric progression, as many as wanted: n_i = 4 n_(i-1), m_i = 2 m_(i-1) from the third on.

    Error of W with eight terms: -0.6 % at tau = 1e-4, +1.3 % at 3e-3, -1.1 % at 0.02, -8.6 % at 0.05, -29 %
    at 0.1, where W is small; the inertia of slow flow is 1.321 (six terms: 1.317) instead of 4/3.
    Args: terms: at least 3; about ceil(ln(R^2/(33.1 nu dt))/ln 4) of them reach down to a time dt.
    Reference: Johnston, "Efficient methods for numerical modeling of laminar friction in fluid lines",
    J. Dynamic Systems, Measurement and Control 128, 2006, pp. 829-834.
    """

    terms: int = eqx.field(static=True, default=8)

    def __check_init__(self):
        _check_terms(self.terms, 3, 30)

    def coefficients(self):
        later = 2.5200 * 2.0 ** np.arange(self.terms - 1)
        return np.concatenate([[1.4064], later]), 33.104 * 4.0 ** np.arange(self.terms)
