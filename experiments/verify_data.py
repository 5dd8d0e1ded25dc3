"""Rows of the verification that need files of reference numbers, which are not part of the project."""

import json
from pathlib import Path

import numpy as np
from verify_published import MATHWORKS
from verify_rows import APART, PROGRAM, Oracle, Row, check

from jaxlines.physics import friction, published_moduli as published

FILES = {
    "effective_bulk_modulus.json": "bulk moduli of oil with air by the laws of MathWorks' hydraulic blocks",
    "darcy_friction_factors.json": "friction factors by the fluids package",
}
"""Name of each file -> what is in it."""
FLUIDS = Oracle(PROGRAM, "fluids package 1.3.1")
EXACT = 1e-12  # the files hold all digits


def modulus_rows(table: dict) -> list[Row]:
    """The legacy law over gauge pressure; density and modulus of the isothermal liquid over absolute pressure."""
    legacy = table["simscape_hydraulics_isothermal_E(p_gauge)"]
    air, rows = legacy["alpha"] / (1.0 + legacy["alpha"]), []
    for name in ("simhydraulics_modulus", "maplesim_modulus"):
        law = getattr(published, name)
        cases = [
            (f"{float(p):g} Pa gauge", float(k), law(legacy["pa"] + float(p), legacy["El"], air, legacy["n"]))
            for p, k in legacy["values"].items()
        ]
        rows += check(f"published_moduli.{name}", MATHWORKS, cases, unit="Pa", relative=EXACT)
    liquid = table["simscape_isothermal_liquid_const_air"]
    given, densities = (liquid["betaL"], liquid["alpha0"], liquid["n"]), (liquid["rhoL0"], liquid["rhog0"])
    values = {float(p): numbers for p, numbers in liquid["values(p_abs):[rho_mix,beta_mix]"].items()}
    name = "published_moduli.simscape_isothermal_liquid"
    found = {p: published.simscape_isothermal_liquid_density(p, *given, densities) for p in values}
    cases = [(f"{p:g} Pa", float(rho), found[p]) for p, (rho, _) in values.items()]
    rows += check(f"{name}_density", APART, cases, unit="kg/m^3", relative=EXACT)
    moduli = {p: published.simscape_isothermal_liquid_modulus(p, *given) for p in values}
    cases = [(f"{p:g} Pa", float(k), moduli[p]) for p, (_, k) in values.items()]
    return rows + check(f"{name}_modulus", APART, cases, unit="Pa", relative=EXACT)


def friction_rows(table: dict) -> list[Row]:
    """Three factors at roughness 1e-4, and the blended laws outside of the transition."""
    rows = []
    for name in ("Haaland", "Colebrook", "Churchill"):
        law = getattr(friction, f"{name.lower()}_factor")
        cases = [
            (f"Re {case['Re']:g}, e/D 1e-4", float(case[f"{name}_1e-4"]), law(float(case["Re"]), 1e-4))
            for case in table["cases"]
        ]
        rows += check(f"friction.{law.__name__}", FLUIDS, cases, relative=EXACT)
    laws = {
        "friction.HaalandFriction": (friction.HaalandFriction(), 0.015),
        "friction.ChurchillFriction": (friction.ChurchillFriction(), 0.02),
    }
    for roughness in ("0", "0.0001", "0.001"):
        for formula, (law, tolerance) in laws.items():
            cases = [
                (
                    f"f, Re {case['Re']:g}, e/D {roughness}",
                    float(case[f"auto_eD{roughness}"]),
                    law.factor_times_reynolds(np.float64(case["Re"]), float(roughness)) / case["Re"],
                )
                for case in table["cases"]
                if case["Re"] <= 1000 or case["Re"] >= 4000
            ]
            rows += check(formula, FLUIDS, cases, relative=tolerance)
    return rows


def data_rows(folder: Path | None) -> tuple[dict[str, list[Row]], list[str]]:
    """Topic -> rows of the files found in a folder or below it, and the names of the files that were not."""
    readers = dict(zip(FILES, (modulus_rows, friction_rows), strict=True))
    topics, missing = {}, []
    for name, reader in readers.items():
        found = sorted(folder.rglob(name)) if folder else []
        if found:
            topics[f"From {name}"] = reader(json.loads(found[0].read_text(encoding="utf-8")))
        else:
            missing.append(name)
    return topics, missing
