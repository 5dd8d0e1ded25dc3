"""The verification of the physics: it runs, its page is the one in docs, and wrong numbers are noticed."""

import importlib
import json
from pathlib import Path

import pytest

from jaxlines.physics import article, containers, friction, nitrogen, published_moduli, solubility, weighting

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "reference"


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "experiments"))
    return importlib.import_module("verify_physics")


def run(script, folder: Path, *options: str) -> tuple[int, dict]:
    code = script.main(["--out", str(folder), *options])
    return code, json.loads((folder / "results.json").read_text())


def test_every_number_agrees_and_the_page_is_the_one_in_docs(script, tmp_path, capsys):
    """When it fails: python experiments/verify_physics.py --out out/verify_physics --docs"""
    code, results = run(script, tmp_path)
    assert (code, results["without_a_row"]) == (0, [])
    assert capsys.readouterr().out.strip().splitlines()[-1] == results["finding"]
    rows = results["rows"]
    assert len(rows) > 700 and all(row["passes"] and row["error"] <= row["tolerance"] for row in rows)
    exact = [row for row in rows if row["formula"].startswith("distributed.") and "j" in row["expected"]]
    assert sum(row["tolerance"] == 1e-8 for row in exact) == 8 * 5
    assert (tmp_path / "physics.md").read_text() == (ROOT / "docs" / "physics.md").read_text()


def test_rows_name_what_can_be_found(script):
    for rows in script.all_rows().values():
        for row in rows:
            module, *names = row.formula.split(".")
            thing = importlib.import_module(f"jaxlines.physics.{module}")
            for name in names:
                thing = getattr(thing, name)
            assert row.kind in ("independent arithmetic", "closed form", "other program", "published chart")


WRONG_ORACLES = [
    ("verify_fluids", "WALTHER", "471.1904 115.7019 41.3428 19.0371 6.4829", "viscosity.walther_viscosity"),
    ("verify_gas", "BWR_LARGEST_ERROR", "0.0084", "nitrogen.Nitrogen"),
    ("verify_lines", "REG_ROOT_VALUES", {0.01: "0.084089652"}, "resistances.regularised_root"),
    ("verify_waves", "STEADY_IMPEDANCE", "0.042 0.348 0.755 0.914 0.972", "distributed.bessel_ratio"),
]


@pytest.mark.parametrize(("module", "name", "value", "formula"), WRONG_ORACLES)
def test_a_wrong_oracle_is_noticed(script, tmp_path, monkeypatch, capsys, module, name, value, formula):
    monkeypatch.setattr(importlib.import_module(module), name, value)
    code, results = run(script, tmp_path)
    assert code == 1 and f"MISSED: {formula} (" in capsys.readouterr().out.splitlines()[-1]
    assert {row["formula"] for row in results["rows"] if not row["passes"]} <= {formula, "viscosity.Walther"}
    assert "**FAIL**" in (tmp_path / "physics.md").read_text()


WRONG_CONSTANTS = [
    (friction, "LAMINAR", 64.01, "friction.laminar_factor"),
    (nitrogen, "_B0", 0.0407401, "nitrogen.nitrogen_pressure"),
    (solubility, "ATMOSPHERE", 1e5, "solubility.linear_undissolved"),
    (containers, "series_modulus", lambda wall, fluid: fluid, "containers.capacity"),
    (published_moduli, "gas_modulus", lambda p, n: p, "published_moduli.cho_modulus"),
    (weighting, "_KAGAWA", ((1.0,) * 10, weighting._KAGAWA[1]), "weighting.KagawaWeights"),
]


@pytest.mark.parametrize(("module", "name", "value", "formula"), WRONG_CONSTANTS)
def test_a_wrong_constant_of_the_package_is_noticed(script, monkeypatch, module, name, value, formula):
    monkeypatch.setattr(module, name, value)
    assert formula in {row.formula for rows in script.all_rows().values() for row in rows if not row.passes}


def test_a_formula_without_a_row_is_noticed(script, tmp_path, monkeypatch, capsys):
    def new_formula(x):
        return x

    new_formula.__module__ = article.__name__
    monkeypatch.setattr(article, "new_formula", new_formula, raising=False)
    code, results = run(script, tmp_path)
    assert code == 1 and results["without_a_row"] == ["article.new_formula"]
    assert "WITHOUT A ROW: article.new_formula" in capsys.readouterr().out.splitlines()[-1]


def test_option_docs_writes_the_page_without_the_rows_of_files(script, tmp_path, monkeypatch):
    monkeypatch.setattr(script, "DOCS", tmp_path / "docs.md")
    assert run(script, tmp_path, "--docs")[0] == 0
    assert (tmp_path / "docs.md").read_text() == (tmp_path / "physics.md").read_text()
    assert (
        "`darcy_friction_factors.json` (friction factors by the fluids package)" in (tmp_path / "docs.md").read_text()
    )


def test_reference_files(script, tmp_path):
    if not all(list(DATA.rglob(name)) for name in script.FILES):
        pytest.skip("the reference tables of bulk moduli and friction factors are not beside the project")
    code, results = run(script, tmp_path, "--data", str(DATA))
    assert code == 0 and results["skipped"] == []
    topics = [row["topic"] for row in results["rows"]]
    assert topics.count("From effective_bulk_modulus.json") == 28
    assert topics.count("From darcy_friction_factors.json") == 66
    assert "## Skipped" not in (tmp_path / "physics.md").read_text()


def test_where_published_moduli_differ(script):
    """At p0 Yu's law lacks the volume of the gas: K/(1 + R (K/(n p0) - 1)) against K (1 + R)/(1 + R K/(n p0))."""
    module = importlib.import_module("verify_published")
    assert set(module.REASONS) == set(published_moduli.PUBLISHED)
    found = {(case.name, case.polytropic_index, case.air_fraction): case.differences for case in script.differences()}
    assert len(found) == 10 * 2 * 3
    softening = 1.5e9 / (1.4 * 101325.0) * 0.05 / 0.95
    yu = (1.0 + softening) / (1.0 + softening - 0.05 / 0.95) * 0.95 - 1.0
    assert found["Yu 1994 (c1 = 0)", 1.4, 0.05][0] == pytest.approx(yu, rel=1e-9)
    assert found["MapleSim", 1.0, 0.01] == pytest.approx(found["SimHydraulics", 1.0, 0.01], abs=1e-12)
    for name in ("Cho 2002", "Yudell 2017", "Wood", "Simscape isothermal liquid"):
        assert found[name, 1.4, 0.05] == pytest.approx([0.0] * 7, abs=1e-12)
    assert found["Wylie 1984 (isothermal)", 1.0, 0.05] == pytest.approx([0.0] * 7, abs=1e-12)


def test_tolerances(script):
    rows = importlib.import_module("verify_rows")
    assert rows.half_digit("1.250") == pytest.approx(0.00051) and rows.half_digit("4.14116e10") == pytest.approx(51000)

    def one(expected, ours, **options):
        return rows.check("f", rows.APART, [("case", expected, ours)], **options)[0]

    assert one("1.250", 1.2504).passes and not one("1.250", 1.2506).passes
    assert one("1.250", 1.2504).tolerance == pytest.approx(0.00051 / 1.25)
    assert one("0", 0.4).passes and one("0", 0.4).absolute
    assert not one("1.0", float("nan")).passes
    assert one(2.0, 2.0 + 1e-11).passes and not one(2.0, 2.0 + 1e-10).passes
    small = one("1000.0+0.001j", 1000.0 + 0.0011j, relative=1e-3)
    assert small.error == pytest.approx(0.1) and not small.passes
