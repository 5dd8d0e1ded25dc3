"""Rows of the verification: steady friction, resistances, the validity of lumped lines, ladders of segments."""

import numpy as np
from scipy.optimize import brentq
from verify_rows import APART, BY_HAND, FORM, PROGRAM, Oracle, Row, along, check

from jaxlines.physics import friction, resistances, validity
from jaxlines.physics.component import Situation
from jaxlines.physics.containers import Pipe
from jaxlines.physics.distributed import ladder_matrix
from jaxlines.physics.fluids import Oil

MODELICA = Oracle(PROGRAM, "Modelica Standard Library, reference results")
REG_ROOT = Oracle(PROGRAM, "Modelica Standard Library, documentation of regRoot")
HOPSAN = Oracle(PROGRAM, "Hopsan, laminar line with a flow step")

# Reynolds number, relative roughness: Colebrook, Haaland, Churchill
FACTORS = {
    (3000, 0): ("0.0435192", "0.0443421", "0.0429747"),
    (4000, 0): ("0.0399070", "0.0404228", "0.0405897"),
    (1e4, 0): ("0.0308830", "0.0308862", "0.0310021"),
    (1e5, 0): ("0.0179898", "0.0178249", "0.0178748"),
    (1e6, 0): ("0.0116450", "0.0115868", "0.0116124"),
    (1e4, 1e-3): ("0.0323818", "0.0321749", "0.0326902"),
    (1e5, 1e-3): ("0.0221745", "0.0219662", "0.0223432"),
    (1e6, 1e-3): ("0.0199435", "0.0199412", "0.0200220"),
}
LAMINAR_FLOWS = {"1.9924570": "0.8118", "39.446623": "16.072", "79.698279": "32.472"}  # [kg/s]: drop [Pa]
STATIC_PIPE = {"2.4452608": "1e5", "2.4198643": "98020", "1.6996304": "5e4"}  # [kg/s]: drop [Pa]
STATIC_PIPE_TOLERANCE = 2e-3  # of the drop, from 1e-3 of the flow

PHASES = {0.01: ("0.17303", "0.02754"), 0.05: ("0.38537", "0.06133"), 0.10: ("0.54228", "0.08631")}
PHASES |= {0.20: ("0.75931", "0.12085"), 0.50: ("1.16556", "0.18550")}
FREQUENCIES = {0.01: "1.65", 0.05: "3.67", 0.10: "5.17", 0.20: "7.23", 0.50: "11.1"}
DELAYS = {10: "0.016", 13: "0.01", 20: "0.0041", 40: "0.0010"}
LADDER = {1: "1.414214", 2: "1.530734", 4: "1.560723", 8: "1.568274"}
LADDER_ERRORS = {1: "9.97", 2: "2.55", 4: "0.641", 8: "0.161", 16: "0.0402", 32: "0.0100"}
REG_ROOT_VALUES = {0.001: "0.009975155", 0.01: "0.084089642", 0.1: "0.315442101", 1.0: "0.999975002"}
ORIFICE = {1e3: "1.07375096e-4", 1e6: "3.39549875e-3"}


def static_pipe_drop(mass_flow: float) -> float:
    """Drop [Pa] by Colebrook: 10 m, 25.4 mm, roughness 25 um, water of 995.586 kg/m^3 and 1 mPa s."""
    velocity = mass_flow / (995.586 * np.pi / 4 * 0.0254**2)
    reynolds = friction.reynolds_number(velocity, 0.0254, 1e-3 / 995.586)
    factor = friction.colebrook_factor(reynolds, 2.5e-5 / 0.0254)
    return float(factor * 10.0 / 0.0254 * 995.586 * velocity * velocity / 2.0)


def friction_rows() -> list[Row]:
    """Friction factors and the laws made of them."""
    laws, rows = (friction.colebrook_factor, friction.haaland_factor, friction.churchill_factor), []
    for law, column in zip(laws, range(3), strict=True):
        cases = [(f"Re {re:g}, e/D {e:g}", printed[column], law(re, e)) for (re, e), printed in FACTORS.items()]
        rows += check(f"friction.{law.__name__}", APART, cases)
    cases = [("Re 1000, smooth", "0.0640000", friction.churchill_factor(1000.0, 0.0))]
    cases += [("Re 2000, smooth", "0.0320433", friction.churchill_factor(2000.0, 0.0))]
    rows += check("friction.churchill_factor", APART, cases)
    objects = {"Haaland": (friction.HaalandFriction(), 1), "Churchill": (friction.ChurchillFriction(), 2)}
    for name, (law, column) in objects.items():
        turbulent = [(key, printed[column]) for key, printed in FACTORS.items() if key[0] >= 4000]
        cases = [(f"f, Re {re:g}, e/D {e:g}", k, law.factor_times_reynolds(re, e) / re) for (re, e), k in turbulent]
        rows += check(f"friction.{name}Friction", APART, cases)
        rows += check(f"friction.{name}Friction", FORM, [("f Re at rest", 64.0, law.factor_times_reynolds(0.0, 0.0))])
    rows += check("friction.laminar_factor", BY_HAND, [("Re 1000", 0.064, friction.laminar_factor(1000.0))])
    cases = [
        ("Adamkowski's rig: 0.94 m/s, 16 mm, 0.9493 mm^2/s", "15843", friction.reynolds_number(0.94, 0.016, 9.493e-7))
    ]
    cases += [
        ("Holmboe's rig: 0.128 m/s, 25.4 mm, 39.67 mm^2/s", "82", friction.reynolds_number(0.128, 0.0254, 39.67e-6))
    ]
    rows += check("friction.reynolds_number", APART, cases)
    cases = [("K 1.5, 850 kg/m^3, -2 m/s", -2550.0, friction.minor_loss_drop(1.5, 850.0, -2.0))]
    return rows + check("friction.minor_loss_drop", BY_HAND, cases, unit="Pa") + drop_rows()


def drop_rows() -> list[Row]:
    """Pressure drops of pipes against other programs."""
    law, velocity = friction.LaminarFriction(), 1e-4 / (np.pi / 4 * 0.01**2)
    ours = 10.0 * law.gradient(velocity, 0.01, 870.0, 0.03 / 870.0)
    rows = check(
        "friction.LaminarFriction", BY_HAND, [("10 m, 10 mm, 0.03 Pa s, 1e-4 m^3/s", "122231", ours)], unit="Pa"
    )
    rows += check(
        "friction.LaminarFriction",
        HOPSAN,
        [("10 m, 10 mm, 0.03 Pa s, 1e-4 m^3/s, steady state", "122233", ours)],
        unit="Pa",
        relative=2e-5,
    )
    steady = 36.09 * law.gradient(0.128, 0.0254, 878.4, 39.67e-6)
    rows += check(
        "friction.LaminarFriction", APART, [("Holmboe's rig: 36.09 m, 0.128 m/s", "7984.2", steady)], unit="Pa"
    )
    oil = Oil(1.4e9, 1000.0, 1e-6, mass="article")
    resistance = Pipe(1.0, 0.1, 0.11).laminar_resistance(oil)
    cases = [
        (f"1 m, 0.1 m, 1 mPa s, {flow} kg/s", drop, resistance * float(flow) / 1000.0)
        for flow, drop in LAMINAR_FLOWS.items()
    ]
    rows += check("containers.Pipe.laminar_resistance", MODELICA, cases, unit="Pa", relative=1e-7)
    cases = [
        (f"10 m, 25.4 mm, rough 25 um, water, {flow} kg/s", drop, static_pipe_drop(float(flow)))
        for flow, drop in STATIC_PIPE.items()
    ]
    rows += check("friction.colebrook_factor", MODELICA, cases, unit="Pa", relative=STATIC_PIPE_TOLERANCE)
    cases = [("10 m, 25.4 mm, rough 25 um, water, 2.4450551 kg/s", "1e5", static_pipe_drop(2.4450551))]
    return rows + check("friction.colebrook_factor", APART, cases, unit="Pa", relative=1e-6)


def volume_flow(part, drop: float, **given) -> float:
    """Flow [m^3/s] through a component between two nodes, with oil of 850 kg/m^3 and 25.5 mPa s."""
    oil = Oil(1.4e9, 850.0, 30e-6, mass="article")
    at = Situation(oil, {"a": np.float64(1e5 + drop), "b": np.float64(1e5)}, {}, given)
    return float(part.evaluate(at).flow["b"]) / 850.0


def resistance_rows() -> list[Row]:
    """Orifice, fitting and leaks."""
    cases = [
        (f"x {x:g}, transition 0.01", printed, resistances.regularised_root(x, 0.01))
        for x, printed in REG_ROOT_VALUES.items()
    ]
    rows = check("resistances.regularised_root", APART, cases)
    below = {0.01: "0.16", 0.1: "0.0025", 1.0: "0.000025"}
    cases = [
        (f"below the root, x {x:g}, transition 0.01", k, 1.0 - resistances.regularised_root(x, 0.01) / np.sqrt(x))
        for x, k in below.items()
    ]
    rows += check("resistances.regularised_root", REG_ROOT, cases)
    case = "C_d 0.7, 1 cm^2, 850 kg/m^3, transition 0.3178266 Pa, {:g} Pa"
    ours = {p: resistances.orifice_flow(1e-4, 0.7, 850.0, p, 0.0, 0.3178266) for p in ORIFICE}
    cases = [(case.format(p), k, ours[p]) for p, k in ORIFICE.items()]
    rows += check("resistances.orifice_flow", APART, cases, unit="m^3/s")
    orifice = resistances.Orifice("a", "b", 1e-4, 0.7, 0.3178266)
    cases = [(case.format(p), k, volume_flow(orifice, p, area=1e-4)) for p, k in ORIFICE.items()]
    rows += check("resistances.Orifice", APART, cases, unit="m^3/s")
    diameter = np.sqrt(4.0 * 20e-6 / np.pi)
    turning = resistances.transition_pressure(9.3, 860.0, 30e-6, 0.61, diameter)
    cases = [("Re_cr 9.3, C_d 0.61, 20 mm^2, 860 kg/m^3, 30 mm^2/s", "7.948032", turning)]
    rows += check("resistances.transition_pressure", APART, cases, unit="Pa")
    root = resistances.two_regime_root
    flow = resistances.orifice_flow(20e-6, 0.61, 860.0, 1e4, 0.0, 7.948032, root)
    rows += check(
        "resistances.two_regime_root", APART, [("the same, flow at 10 kPa", "5.883362e-5", flow)], unit="m^3/s"
    )
    cases = [("half the transition of 4: (3 - 1/2)/2", 1.25, root(2.0, 4.0)), ("at -4", -2.0, root(-4.0, 4.0))]
    rows += check("resistances.two_regime_root", FORM, cases)
    rated = resistances.rated_orifice_flow(1e-3, 7e6, 850.0, 3400.0, 7e6, 0.0, 1.0)
    cases = [("rated point, fourfold density: half the flow", 5e-4, rated)]
    return rows + check("resistances.rated_orifice_flow", FORM, cases, unit="m^3/s") + leak_rows()


def leak_rows() -> list[Row]:
    """Fittings, gaps, and the smooth clips of valves."""
    fitting, case = resistances.MinorLoss("a", "b", 1.5, 1e-4, 1e-3), "K 1.5, 1 cm^2, 850 kg/m^3, 2550 Pa: 2 m/s"
    ours = resistances.minor_loss_flow(1.5, 1e-4, 850.0, 2550.0, 0.0, 1e-3)
    rows = check("resistances.minor_loss_flow", BY_HAND, [(case, 2e-4, ours)], unit="m^3/s")
    rows += check("resistances.MinorLoss", BY_HAND, [(case, 2e-4, volume_flow(fitting, 2550.0))], unit="m^3/s")
    case, gap = "20 mm, 10 um, 10 mm, 25.5 mPa s, 10 MPa, {}", (0.02, 1e-5, 0.01)
    for name, eccentricity, factor in (("centred", 0.0, 1.0), ("touching", 1.0, 2.5)):
        expected = float(factor * np.pi * 0.02 * 1e-15 * 1e7 / (12.0 * 0.0255 * 0.01))
        ours = resistances.annular_leak_flow(*gap, eccentricity, 0.0255, 1e7)
        rows += check("resistances.annular_leak_flow", BY_HAND, [(case.format(name), expected, ours)], unit="m^3/s")
        ours = volume_flow(resistances.AnnularLeak("a", "b", *gap, eccentricity), 1e7)
        rows += check("resistances.AnnularLeak", BY_HAND, [(case.format(name), expected, ours)], unit="m^3/s")
    leak = resistances.LaminarLeak("a", "b", 1e-11)
    cases = [("1e-11 m^3/(s Pa), 19.9 MPa", 1.99e-4, volume_flow(leak, 19.9e6))]
    rows += check("resistances.LaminarLeak", BY_HAND, cases, unit="m^3/s")
    cases = [
        (f"{x:g}, width 0.2", y, resistances.soft_positive(x, 0.2)) for x, y in ((0.0, 0.0375), (0.2, 0.2), (-0.2, 0))
    ]
    rows += check("resistances.soft_positive", FORM, cases)
    cases = [(f"{x:g}, width 0.1", y, resistances.soft_clip(x, 0.1)) for x, y in ((0.5, 0.5), (1.5, 1.0), (-0.5, 0))]
    return rows + check("resistances.soft_clip", FORM, cases)


def validity_rows() -> list[Row]:
    """How far a line may be lumped."""
    ratio, speed, length = validity.lumped_impedance_ratio, 1246.6897345, 20.83
    cases = [
        (f"error 1 - kL cot kL at kL {phase}", f"{e:.2f}", 1.0 - ratio(float(phase)))
        for e, (phase, _) in PHASES.items()
    ]
    rows = check("validity.lumped_impedance_ratio", APART, cases, relative=1e-4)
    cases = [("20.83 m, 1246.69 m/s, 20 Hz", "-1.227", ratio(2 * np.pi * 20.0 * length / speed))]
    rows += check("validity.lumped_impedance_ratio", APART, cases)
    cases = [("20.83 m, 1246.69 m/s, 20 Hz", "2.227", validity.lumped_impedance_error(length, speed, 20.0))]
    rows += check("validity.lumped_impedance_error", APART, cases)
    found = {e: validity.frequency_of_error(1.0, 1.0, e) for e in PHASES}
    cases = [(f"kL of error {e:g}", printed[0], 2 * np.pi * found[e]) for e, printed in PHASES.items()]
    cases += [(f"L/lambda of error {e:g}", printed[1], found[e]) for e, printed in PHASES.items()]
    rows += check("validity.frequency_of_error", APART, cases)
    cases = [
        (f"error {e:g}, 20.83 m, 1246.69 m/s", k, validity.frequency_of_error(length, speed, e))
        for e, k in FREQUENCIES.items()
    ]
    rows += check("validity.frequency_of_error", APART, cases, unit="Hz")
    cases = [("20.83 m, 1246.69 m/s", "14.96267", validity.quarter_wave_frequency(length, speed))]
    rows += check("validity.quarter_wave_frequency", APART, cases, unit="Hz")
    cases = [(f"{n} segments per wavelength", k, validity.ladder_delay_error(float(n))) for n, k in DELAYS.items()]
    return rows + check("validity.ladder_delay_error", APART, cases)


def ladder_rows() -> list[Row]:
    """First frequency of a lossless ladder that is closed at one end and open at the other."""
    pipe = (20.83, 0.0428498, 850.0, 27.7e-6, 1.3211e9)
    period = pipe[0] / np.sqrt(pipe[4] / pipe[2])

    def phase(segments: int, model: str) -> float:
        def cosh(x):
            return ladder_matrix(1j * x / period, segments, *pipe, "none", model)[0, 0].real  # pyright: ignore[reportArgumentType]

        return float(brentq(cosh, 0.9, 1.7, xtol=1e-13))  # pyright: ignore[reportArgumentType]

    rows = []
    for model in ("pi", "T"):
        phases, case = {n: phase(n, model) for n in LADDER_ERRORS}, f"{model}, {{}} segments"
        cases = along(f"omega L/c, {case}", LADDER, " ".join(LADDER.values()), [phases[n] for n in LADDER])
        rows += check("distributed.ladder_matrix", APART, cases)
        below = [100.0 * (1.0 - x / (np.pi / 2)) for x in phases.values()]
        cases = along(f"below the exact frequency, {case}", LADDER_ERRORS, " ".join(LADDER_ERRORS.values()), below)
        rows += check("distributed.ladder_matrix", APART, cases, unit="%")
    return rows


TOPICS = {
    "Steady friction": friction_rows,
    "Orifices, fittings and leaks": resistance_rows,
    "Validity of a lumped line": validity_rows,
    "Ladders of segments": ladder_rows,
}
