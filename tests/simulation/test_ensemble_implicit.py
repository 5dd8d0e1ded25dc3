"""The implicit engine of ensembles: steps graded in time for all lanes, against an adaptive implicit solver."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

import jaxlines as jl

TIMES = np.linspace(0.0, 0.4, 5)
OPENING = jl.Sampled(TIMES, 2e-6 * np.array([0.3, 1.0, 0.2, 0.8, 0.5]))
START = {"A.pressure": 1e7, "B.pressure": 1e7}
FACTORS = np.array([1.0, 0.8, 1.1])


def two_volumes(volume: float = 1e-6) -> jl.Circuit:
    """A valve feeds a volume that leaks into a larger one, which drains; fast where the first is small."""
    oil = jl.Oil(1.29e9, 850.0, 30e-6, air_fraction=0.003, polytropic_index=1.2)
    parts = {
        "supply": jl.PressureSource("P", 20e6),
        "tank": jl.Tank("T", 1e5),
        "valve": jl.Orifice("P", "A", "area"),
        "a": jl.Line("A", jl.Vessel(volume)),
        "between": jl.LaminarLeak("A", "B", 1e-10),
        "b": jl.Line("B", jl.Vessel(max(volume, 1e-4))),
        "leak": jl.LaminarLeak("B", "T", 1e-11),
    }
    return jl.Circuit(oil, parts)


def varied(lanes: int = 3) -> dict:
    """A modulus, and the records of the input, which differ from lane to lane."""
    factors = np.resize(FACTORS, lanes)
    return {"fluid.bulk_modulus": 1.29e9 * factors, "area.values": factors[:, None] * OPENING.values}


def prepare(circuit: jl.Circuit, values: dict, **options) -> jl.EnsembleProgram:
    options = {"tolerance": 1e-4, "audit": 0, "initial": START, "outputs": ["A.pressure", "B.pressure"], **options}
    return jl.prepare_ensemble(circuit, TIMES, values, {"area": OPENING}, **options)


@pytest.fixture(scope="module")
def program() -> jl.EnsembleProgram:
    """Engine and steps chosen by the pilot."""
    return prepare(two_volumes(), varied())


def test_stiff_lanes_against_an_adaptive_solver(program):
    assert program.description["engine"] == "implicit"
    lengths = np.diff(program.description["steps"])
    assert len(lengths) < 400 and lengths.max() > 50.0 * lengths.min()
    found = program.run(varied())
    assert found.usable.all() and f"{len(lengths)} graded steps" in str(found)
    for lane in (0, 1):
        circuit = two_volumes().replace({"fluid.bulk_modulus": 1.29e9 * FACTORS[lane]})
        signal = jl.Sampled(TIMES, FACTORS[lane] * OPENING.values)
        one = jl.simulate(circuit, TIMES, {"area": signal}, initial=START, tolerance=1e-9, solver=jl.implicit())
        for name in ("A.pressure", "B.pressure"):
            np.testing.assert_allclose(found[name][lane], one[name], rtol=0, atol=1e-4 * 1.5e7)


def test_soft_lanes_take_the_explicit_engine():
    assert prepare(two_volumes(2e-2), varied()).description["engine"] == "explicit"


def test_chunks_do_not_matter(program):
    first, second = program.run(varied(300), chunk=128), program.run(varied(300), chunk=384)
    for name in ("A.pressure", "B.pressure"):
        np.testing.assert_array_equal(first[name], second[name])
        np.testing.assert_array_equal(first[name][:3], first[name][297:])
    np.testing.assert_array_equal(first.error, second.error)


def test_a_plan_is_made_again_from_its_record(program):
    record = json.loads(json.dumps(program.description))
    again = prepare(two_volumes(), varied(), engine=record["engine"], steps=record["steps"])
    assert again.description == program.description
    np.testing.assert_array_equal(again.grid, program.grid)
    with pytest.raises(ValueError, match="of another run"):
        prepare(two_volumes(), varied(), engine="implicit", steps=[0.0, 0.1, 0.4])
    with pytest.raises(ValueError, match="boundaries of all steps"):
        prepare(two_volumes(), varied(), engine="explicit", steps=record["steps"])


def test_more_steps_cut_every_step(program):
    values = varied()
    finer = dataclasses.replace(program, steps=4)
    found, exact = program.run(values), finer.run(values)
    assert np.all(exact.error < 0.1 * found.error)
    np.testing.assert_allclose(found["A.pressure"], exact["A.pressure"], rtol=1e-4)


@pytest.mark.slow
def test_gradients_against_differences(program):
    def objective(times, outputs):
        return jnp.sum(outputs["A.pressure"] ** 2, axis=0)

    values = varied()
    found = jl.ensemble_gradient(program, objective, values, chunk=128)
    moved = {}
    for name, key in (("modulus", "fluid.bulk_modulus"), ("opening", "area.values")):
        shown = []
        for sign in (1.0, -1.0):
            changed = {k: v.copy() for k, v in values.items()}
            place = (slice(None), 2) if name == "opening" else slice(None)
            changed[key][place] *= 1.0 + sign * 1e-4
            shown.append(np.sum(program.run(changed)["A.pressure"] ** 2, axis=1))
        moved[name] = (shown[0] - shown[1]) / 2e-4
    np.testing.assert_allclose(
        found.gradient["fluid.bulk_modulus"] * values["fluid.bulk_modulus"], moved["modulus"], rtol=1e-3
    )
    np.testing.assert_allclose(
        found.gradient["area.values"][:, 2] * values["area.values"][:, 2], moved["opening"], rtol=1e-4
    )


@pytest.mark.slow
def test_slopes_against_differences(program):
    values = {"fluid.bulk_modulus": 1.29e9 * FACTORS}
    alike = prepare(two_volumes(), values, engine="implicit", steps=program.description["steps"])
    slopes = jl.ensemble_jacobian(alike, values, chunk=128).slopes["B.pressure"]["fluid.bulk_modulus"]
    up, down = (alike.run({"fluid.bulk_modulus": share * values["fluid.bulk_modulus"]}) for share in (1.001, 0.999))
    moved = (up["B.pressure"] - down["B.pressure"]) / 0.002
    expected = values["fluid.bulk_modulus"][:, None] * slopes
    assert np.abs(moved).max() > 1e4
    np.testing.assert_allclose(expected, moved, rtol=1e-3, atol=1e-4 * np.abs(moved).max())
