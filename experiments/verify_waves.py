"""Rows of the verification: frequency-dependent friction, the exact distributed line, its water hammer in time."""

import numpy as np
from inverse_laplace import instantaneous_closure
from scipy.special import jn_zeros
from verify_rows import APART, FORM, THIRTY, Oracle, Row, along, check

from jaxlines.physics import distributed, weighting

PRINTED = Oracle(APART.kind, "Zielke 1968, his printed coefficients, or zeros of J_2 computed apart")
INVERSION = Oracle(APART.kind, "inverse Laplace transform by two settings of another program, which agree to 6 digits")

SETS = {
    "Trikha": weighting.TrikhaWeights(),
    "Schohl": weighting.SchohlWeights(),
    "Kagawa": weighting.KagawaWeights(),
    "Vitkovsky": weighting.VitkovskyWeights(),
    "Johnston": weighting.JohnstonWeights(),
    "Johnston 6": weighting.JohnstonWeights(6),
}
ZIELKE = {"1e-4": "26.970151875", "1e-3": "7.7050225647", "0.01": "1.6864570426", "0.02": "0.91396676965"}
ZIELKE |= {"0.1": "0.072381583360", "0.3": "0.00036618081243"}
SHORT_TIME = "0.282095 -1.250000 1.057855 0.937500 0.396696 -0.351563"
# Set, range of tau: largest error of W [%]
BANDS = {
    ("Trikha", 1e-3, 0.3): "38",
    ("Schohl", 1e-5, 0.3): "5.4",
    ("Kagawa", 1e-5, 0.3): "0.30",
    ("Vitkovsky", 1e-5, 0.1): "0.03",
    ("Vitkovsky", 0.1, 0.3): "3.9",
}
# Set: tau: error of W [%]
POINTS = {
    "Trikha": {1e-4: "-0.2", 1e-3: "-1", 1e-2: "11"},
    "Vitkovsky": {0.2: "-1.8"},
    "Johnston": {1e-4: "-0.6", 3e-3: "1.3", 0.02: "-1.1", 0.03: "-3.9", 0.05: "-8.6", 0.1: "-29"},
}
INERTIA_TOLERANCES = {"Trikha": 1e-3, "Schohl": 0.012, "Kagawa": 0.005, "Vitkovsky": 0.006, "Johnston": 0.04}
# Set: |xi^2 - exact|/|exact - 1| at omega R^2/nu = 1, 10, 100, 1e3, 1e4
IMPEDANCE_PLACES = (1, 10, 100, 1000, 10000)
IMPEDANCE = {
    "Trikha": "1e-4 0.0043 0.102 0.286 0.310",
    "Schohl": "5e-4 0.004 0.020 0.061 0.159",
    "Kagawa": "2e-4 0.0015 0.0072 0.025 0.080",
    "Vitkovsky": "2e-4 0.0018 0.0077 0.026 0.084",
    "Johnston 6": "0.002 0.014 0.015 0.078 0.24",
}
STEADY_IMPEDANCE = "0.042 0.348 0.753 0.914 0.972"

# 20.83 m of the antennas' 2-in pipe: length, inner diameter, density, viscosity, effective modulus
PIPE = (20.83, 2 * 0.0214249, 850.0, 27.7e-6, 1.3211e9)
ENTRIES = ("propagation_number", "characteristic_impedance", "cosh G", "Zc sinh G", "sinh G/Zc")
EXACT = {
    0.1: "0.003650675512+0.01256434334j 879465626.7-255536126.4j 0.9999277329+4.586723561e-5j "
    "6420977.889+10116883.07j -2.184270508e-16+1.428599401e-11j",
    1: "0.008344711562+0.1121900945j 785296366.7-58410430.11j 0.993747888+9.342421372e-4j "
    "13051511.15+87436472.66j -4.452683328e-14+1.425655274e-10j",
    5: "0.01730279549+0.5411439354j 757568426.0-24222855.86j 0.8572482903+0.008913405708j "
    "23715201.83+389935397.9j -2.16491209e-12+6.799933469e-10j",
    10: "0.02403285001+1.072795557j 750924096.2-16822260.37j 0.477808045+0.0211158355j "
    "23404553.42+659713715.3j -1.0922269e-11+1.170037399e-9j",
    14.96: "0.02916203811+1.598637779j 747993033.3-13644742.81j -0.02784969316+0.02915486834j "
    "13037941.64+748032183.5j -2.546557735e-11+1.336496483e-9j",
    20: "0.03355626706+2.132140662j 746216643.9-11744180.59j -0.5326244455+0.02841206223j "
    "-3384523.357+632267939.5j -4.17962571e-11+1.134423969e-9j",
    50: "0.05245820434+5.300483153j 742035236.2-7343827.897j 0.5555398935-0.04366522j "
    "15486570.34-618436423.7j 5.034503282e-11-1.122284722e-9j",
    100: "0.07376335424+10.57084402j 739926767.9-5163209.316j -0.4131965998-0.06727043861j "
    "-27228504.43-675862088.4j -3.249933544e-11-1.234983889e-9j",
}
EXACT_TOLERANCE, EXACT_FLOOR = 1e-8, 1e-9  # small real parts are differences of large numbers
# w = z^2: I0(z)/I2(z)
RATIOS = {
    1j: "1.333102167162-8.006936016914j",
    100j: "1.138378097167-0.1740614749463j",
    10000j: "1.014139446324-0.01444478712792j",
    3 + 7j: "1.720269820303-1.003998234826j",
}
HAMMER_TIMES = (0.5, 1.0, 1.5, 2.5, 3.0, 3.5, 5, 7, 9, 11, 13, 15)
HAMMER = {
    6.702481e-3: "1.068803 1.099453 1.123882 -0.660496 -0.775952 -0.839287 0.780131 -0.522023 0.525186 -0.301912 "
    "0.321674 -0.128453",
    1.00826118e-3: "1.025847 1.036859 1.045434 -0.883127 -0.928634 -0.953277 0.919617 -0.832988 0.815148 -0.736313 "
    "0.715762 -0.642153",
}


def _kind(name: str) -> str:
    """The class of a set of weights."""
    return f"weighting.{type(SETS[name]).__name__}"


def weighting_rows() -> list[Row]:
    """Zielke's function, and what the sums of exponentials make of it."""
    cases = [(f"W, tau {tau}", printed, weighting.zielke_weight(float(tau))) for tau, printed in ZIELKE.items()]
    rows = check("weighting.zielke_weight", THIRTY, cases)
    cases = along("coefficient {}", range(1, 7), SHORT_TIME, weighting.SHORT_TIME)
    rows += check("weighting.SHORT_TIME", PRINTED, cases)
    series = sum(float(m) * 0.02 ** ((i - 1) / 2) for i, m in enumerate(weighting.SHORT_TIME))
    rows += check("weighting.SHORT_TIME", PRINTED, [("the series at tau 0.02", "0.914048", series)], absolute=5e-6)
    cases = [("W, tau 0.02", "0.913967", weighting.zielke_weight(0.02))]
    rows += check("weighting.zielke_weight", PRINTED, cases)

    def error(name: str, tau):
        return 100.0 * (SETS[name].weight(tau) / weighting.zielke_weight(tau) - 1.0)

    for (name, low, high), percent in BANDS.items():
        largest = np.max(np.abs(error(name, np.geomspace(low, high, 2000))))
        case = f"largest error of W, tau {low:g} to {high:g}"
        rows += check(_kind(name), APART, [(case, percent, largest)], unit="%")
    for name, points in POINTS.items():
        cases = [(f"error of W, tau {tau:g}", percent, error(name, np.array(tau))) for tau, percent in points.items()]
        rows += check(_kind(name), APART, cases, unit="%")
    for name, tolerance in INERTIA_TOLERANCES.items():
        cases = [("sum m/n, exactly 1/12", 1 / 12, np.divide(*SETS[name].coefficients()).sum())]
        rows += check(_kind(name), FORM, cases, relative=tolerance)
    six = np.divide(*SETS["Johnston 6"].coefficients()).sum()
    rows += check("weighting.JohnstonWeights", APART, [("sum m/n, six terms", "0.07936", six)])
    return rows + impedance_error_rows() + turbulent_rows()


def impedance_error_rows() -> list[Row]:
    """Error of xi^2 = 1 + 8/w + 4 sum m/(w + n), relative to what friction adds to 1."""
    w, rows = 1j * np.array(IMPEDANCE_PLACES), []
    exact, steady = distributed.bessel_ratio(np.sqrt(w)), 1.0 + 8.0 / w
    case = "error of the impedance{}, omega R^2/nu {{}}"
    for name, printed in IMPEDANCE.items():
        ours = np.abs(steady + 4.0 * SETS[name].transform(w) - exact) / np.abs(exact - 1.0)
        terms = ", six terms" if name == "Johnston 6" else ""
        rows += check(_kind(name), APART, along(case.format(terms), IMPEDANCE_PLACES, printed, ours))
    ours = np.abs(steady - exact) / np.abs(exact - 1.0)
    cases = along(case.format(" of steady friction"), IMPEDANCE_PLACES, STEADY_IMPEDANCE, ours)
    return rows + check("distributed.bessel_ratio", APART, cases, absolute=1e-3)


def turbulent_rows() -> list[Row]:
    """Vardy and Brown's function by ten terms."""
    weights, tau = weighting.VitkovskyTurbulentWeights(1e4), np.geomspace(1e-6, 1e-2, 400)
    rows = check("weighting.VitkovskyTurbulentWeights", APART, [("B*, Re 1e4", "526.2", weights.shear_decay())])
    m, n = weights.coefficients()
    bare = sum(k * np.exp(-(x - weights.shear_decay()) * tau) for k, x in zip(m, n, strict=True))
    largest = np.max(np.abs(bare * 2.0 * np.sqrt(np.pi * tau) - 1.0))
    cases = [("sum m* exp(-n* tau) sqrt(tau) less 1, largest, tau 1e-6 to 1e-2", 0.0, largest)]
    return rows + check("weighting.VitkovskyTurbulentWeights", FORM, cases, absolute=2e-3)


def line_rows() -> list[Row]:
    """The exact line at eight frequencies, and what leads to it."""
    rows = []
    for frequency, printed in EXACT.items():
        s = 2j * np.pi * frequency
        matrix = distributed.transmission_matrix(s, *PIPE)
        ours = [distributed.propagation_number(s, *PIPE), distributed.characteristic_impedance(s, *PIPE[1:])]
        ours += [matrix[0, 0], matrix[0, 1], matrix[1, 0]]
        for name, text, x in zip(ENTRIES, printed.split(), ours, strict=True):
            inside = "sinh" in name or "cosh" in name
            formula = "distributed.transmission_matrix" if inside else f"distributed.{name}"
            case = f"{name}, {frequency} Hz" if inside else f"{frequency} Hz"
            rows += check(formula, THIRTY, [(case, text, x)], relative=EXACT_TOLERANCE, floor=EXACT_FLOOR)
    gain = abs(1.0 / distributed.transmission_matrix(2j * np.pi * 14.96, *PIPE)[0, 0])
    rows += check("distributed.transmission_matrix", THIRTY, [("|1/cosh G|, 14.96 Hz", "24.802279", gain)])
    number = distributed.dissipation_number(PIPE[0], PIPE[1], np.sqrt(PIPE[4] / PIPE[2]), PIPE[3])
    rows += check("distributed.dissipation_number", APART, [("2-in pipe, 20.83 m", "1.00826118e-3", number)])
    number = distributed.dissipation_number(36.09, 0.0254, 1324.36, 39.67e-6)
    rows += check("distributed.dissipation_number", APART, [("Holmboe's rig", "6.702481e-3", number)])
    lossless = distributed.characteristic_impedance(1j, *PIPE[1:], friction="none").real
    cases = [("rho c/A, without friction", "734834993.05", lossless)]
    rows += check("distributed.characteristic_impedance", APART, cases, unit="Pa s/m^3")
    rig = (0.0254, 878.4, 39.67e-6, 878.4 * 1324.36**2)
    blow = distributed.characteristic_impedance(1j, *rig, friction="none").real * np.pi / 4 * 0.0254**2 * 0.128
    cases = [("Joukowsky's rho c V0 of Holmboe's rig", "148904.68", blow)]
    return rows + check("distributed.characteristic_impedance", APART, cases, unit="Pa") + impedance_rows()


def impedance_rows() -> list[Row]:
    """I0/I2, series impedance and shunt admittance."""
    cases = [(f"z^2 = {w:g}", text, distributed.bessel_ratio(np.sqrt(w))) for w, text in RATIOS.items()]
    rows = check("distributed.bessel_ratio", THIRTY, cases, relative=1e-11)
    cases = [(f"over w = {w:g}", text, distributed.womersley_impedance(w) / w) for w, text in RATIOS.items()]
    rows += check("distributed.womersley_impedance", THIRTY, cases, relative=1e-11)
    z, exponents = 2.0 + 1.0j, jn_zeros(2, 1000) ** 2
    tail = 1.0 / (np.pi**2 * 1001.25)  # the rest of the sum by its integral
    poles = complex(1.0 + 8.0 / z**2 + 4.0 * (np.sum(1.0 / (z**2 + exponents)) + tail))
    cases = [
        (
            "1 + 8/z^2 + 4 sum 1/(z^2 + j_k^2), z = 2+1j",
            f"{poles.real:.7f}{poles.imag:+.7f}j",
            distributed.bessel_ratio(z),
        )
    ]
    rows += check("distributed.bessel_ratio", FORM, cases, relative=1e-6)
    cases = [("slow flow: 8", 8.0, distributed.womersley_impedance(0.0).real)]
    cases += [
        (
            "fast flow: w + 2 sqrt(w) over w = 1e10, real part",
            1.0 + 2e-5,
            distributed.womersley_impedance(1e10).real / 1e10,
        )
    ]
    rows += check("distributed.womersley_impedance", FORM, cases, relative=1e-9)
    area = np.pi / 4 * PIPE[1] ** 2
    inertance, s = PIPE[2] * PIPE[0] / area, 1e-4j
    resistance = 128.0 * PIPE[2] * PIPE[3] * PIPE[0] / (np.pi * PIPE[1] ** 4)
    cases = [
        ("at rest: Hagen and Poiseuille's R", float(resistance), distributed.series_impedance(0.0, *PIPE[:4]).real)
    ]
    rows += check("distributed.series_impedance", FORM, cases, unit="Pa s/m^3")
    slow = distributed.series_impedance(s, *PIPE[:4]).imag / s.imag / inertance
    rows += check(
        "distributed.series_impedance", FORM, [("inertia of slow flow over rho L/A", 4 / 3, slow)], relative=1e-6
    )
    ours = distributed.shunt_admittance(2j, PIPE[0], PIPE[1], PIPE[4]).imag
    cases = [("omega A L/K at 2 rad/s", float(2.0 * area * PIPE[0] / PIPE[4]), ours)]
    return rows + check("distributed.shunt_admittance", FORM, cases, unit="m^3/(s Pa)")


def hammer_rows() -> list[Row]:
    """Pressure at a valve that closes at once, by the inverse Laplace transform of the exact line."""
    rows = []
    for number, printed in HAMMER.items():
        ours = instantaneous_closure(np.array(HAMMER_TIMES), number)
        cases = along(f"p/(rho c V0), Dn {number:g}, t c/L {{}}", HAMMER_TIMES, printed, ours)
        rows += check("distributed.bessel_ratio", INVERSION, cases, absolute=1e-6, floor=1e-7)
    return rows


TOPICS = {
    "Frequency-dependent friction": weighting_rows,
    "Exact distributed line": line_rows,
    "Water hammer of the exact line": hammer_rows,
}
