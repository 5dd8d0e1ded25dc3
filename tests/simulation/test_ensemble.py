"""Ensembles: many lanes in step against closed forms and single simulations, whatever the chunks, failures and all."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxlines as jl

TIMES = np.linspace(0.0, 0.5, 26)
OIL = jl.Oil(1.4e9, 850.0, 30e-6, air_fraction=2e-3, polytropic_index=1.2, mass="article")


def draining() -> jl.Circuit:
    """A closed volume of oil of one modulus that leaks into a tank: p = p_T + (p0 - p_T) exp(-t K G / V)."""
    oil = jl.Oil(1.4e9, 850.0, 30e-6, air_fraction=0.0, mass="article")
    parts = {
        "vessel": jl.Line("A", jl.Vessel(1e-3)),
        "leak": jl.LaminarLeak("A", "T", conductance=5e-12),
        "tank": jl.Tank("T", 1e5),
    }
    return jl.Circuit(oil, parts)


def driven() -> jl.Circuit:
    """A servovalve, two lines with air, a motor with inertia."""
    parts = {
        "supply": jl.PressureSource("P", 2e7),
        "tank": jl.Tank("T", 3e5),
        "valve": jl.Servovalve("P", "T", "A", "B", "spool", 1e-3, 7e6, natural_frequency=150.0),
        "a": jl.Line("A", jl.Vessel(5e-3)),
        "b": jl.Line("B", jl.Vessel(5e-3)),
        "motor": jl.Motor("A", "B", "T", "shaft", 1e-4, 5e-12, 1e-12, 2.0, 1.0, 1.0),
        "inertia": jl.Inertia("shaft", 40.0),
        "gauge": jl.PressureSensor("A", reference="gauge", gain=1.01),
    }
    return jl.Circuit(OIL, parts)


COMMAND = jl.Sampled(np.linspace(0.0, 0.5, 11), 0.5 * np.sin(np.linspace(0.0, 9.0, 11)))
START = {"A.pressure": 1e7, "B.pressure": 9e6}


def varied(lanes: int) -> dict:
    """Numbers of the circuit, of the fluid, of an input and of the start."""
    draw = np.random.default_rng(3)
    return {
        "fluid.air_fraction": 10.0 ** draw.uniform(-4, -2, lanes),
        "inertia.moment_of_inertia": draw.uniform(20.0, 80.0, lanes),
        ("a.parts.0.volume", "b.parts.0.volume"): draw.uniform(3e-3, 8e-3, lanes),
        "initial.A.pressure": draw.uniform(8e6, 12e6, lanes),
        "gauge.gain": draw.uniform(0.9, 1.1, lanes),
    }


REDUCTIONS = {
    "peak": jl.Peak("A.pressure"),
    "crossing": jl.Crossing("shaft.speed", 1.0),
    "spread": jl.Custom(lambda times, a, b: jnp.max(a - b, axis=0), ("A.pressure", "B.pressure")),
}


@pytest.fixture(scope="module")
def program() -> jl.EnsembleProgram:
    return jl.prepare_ensemble(
        driven(),
        TIMES,
        varied(300),
        {"spool": COMMAND},
        initial=START,
        outputs=["A.pressure", "gauge", "valve.spool"],
        reductions=REDUCTIONS,
        tolerance=1e-4,
        audit=4,
    )


def single(circuit: jl.Circuit, values: dict, lane: int):
    """One lane by `simulate` at a tight tolerance."""
    numbers, initial = {}, dict(START)
    for key, column in values.items():
        for path in (key,) if isinstance(key, str) else key:
            if path.startswith("initial."):
                initial[path.removeprefix("initial.")] = column[lane]
            else:
                numbers[path] = column[lane]
    changed = circuit.replace(numbers)
    return jl.simulate(changed, TIMES, {"spool": COMMAND}, initial=initial, tolerance=1e-10)


def test_closed_form():
    lanes = 40
    volume, conductance = np.linspace(5e-4, 2e-3, lanes), np.geomspace(1e-14, 1e-11, lanes)
    found = jl.ensemble(
        draining(),
        TIMES,
        {"vessel.volume": volume, "leak.conductance": conductance},
        initial={"A.pressure": 2e7},
        outputs=["A.pressure"],
        reductions={
            "final": jl.Final("A.pressure"),
            "rms": jl.RootMeanSquare("A.pressure"),
            "when": jl.Crossing("A.pressure", 1.9e7, "down"),
            "low": jl.TimeQuantile("A.pressure", 0.1),
            "mean": jl.TimeMean("A.pressure"),
            "peak time": jl.TimeOfPeak("A.pressure"),
            "trough": jl.Trough("A.pressure"),
        },
        tolerance=1e-6,
        audit=2,
    )
    rate = 1.4e9 * conductance / volume
    exact = 1e5 + 1.99e7 * np.exp(-rate[:, None] * TIMES)
    assert found.usable.all() and found.description["engine"] == "explicit"
    np.testing.assert_allclose(found["A.pressure"], exact, rtol=0, atol=1e-6 * 2e7)
    np.testing.assert_allclose(found["final"], exact[:, -1], rtol=1e-5)
    np.testing.assert_allclose(found["trough"], exact.min(axis=1), rtol=1e-5)
    np.testing.assert_allclose(found["mean"], np.trapezoid(exact, TIMES) / 0.5, rtol=1e-5)
    np.testing.assert_allclose(found["rms"], np.sqrt(np.trapezoid(exact**2, TIMES) / 0.5), rtol=1e-5)
    np.testing.assert_allclose(found["low"], np.quantile(exact, 0.1, axis=1), rtol=1e-5)
    assert np.all(found["peak time"] == 0.0)
    when = -np.log((1.9e7 - 1e5) / 1.99e7) / rate
    crosses = when < 0.5
    assert crosses.any() and not crosses.all()
    np.testing.assert_allclose(found["when"][crosses], when[crosses], rtol=0, atol=5e-4)  # a chord
    assert np.isnan(found["when"][~crosses]).all()


def test_agrees_with_single_simulations(program):
    values = varied(300)
    found = program.run(values)
    assert found.usable.all() and found.statuses == {"ok": 300}
    assert found.audit is not None and found.audit.worst < 1e-4
    for lane in (0, 77, 299):
        one = single(driven(), values, lane)
        np.testing.assert_allclose(found["A.pressure"][lane], one["A.pressure"], rtol=0, atol=1e-4 * 2e7)
        np.testing.assert_allclose(found["gauge"][lane], one["gauge"], rtol=0, atol=1e-4 * 2e7)
        np.testing.assert_allclose(found["valve.spool"][lane], one["valve.spool"], rtol=0, atol=1e-4)
        np.testing.assert_allclose(found["peak"][lane], one["A.pressure"].max(), rtol=1e-4)
        np.testing.assert_allclose(found["spread"][lane], (one["A.pressure"] - one["B.pressure"]).max(), rtol=1e-3)
    assert "300 lanes" in str(found) and found.to_xarray()["A.pressure"].shape == (300, 26)


def test_chunks_and_order_do_not_matter(program):
    values = varied(300)
    first = program.run(values)
    backwards = program.run({key: column[::-1] for key, column in values.items()}, chunk=128)
    for name in ("A.pressure", "peak", "crossing"):
        np.testing.assert_array_equal(first[name], backwards[name][::-1])
    np.testing.assert_array_equal(first.error, backwards.error[::-1])


def test_failed_lanes_are_flagged_and_disturb_no_other(program):
    values = varied(300)
    good = program.run(values)
    values["fluid.air_fraction"][5] = -0.1
    values["inertia.moment_of_inertia"][17] = np.nan
    values["initial.A.pressure"][40] = -1e6
    found = program.run(values)
    bad = np.zeros(300, dtype=bool)
    bad[[5, 17, 40]] = True
    np.testing.assert_array_equal(found.usable, ~bad)
    assert found.statuses == {"ok": 297, "out_of_range": 3}
    assert np.isnan(found["A.pressure"][bad]).all() and np.isnan(found["peak"][bad]).all()
    np.testing.assert_array_equal(found["A.pressure"][~bad], good["A.pressure"][~bad])


def test_a_lane_too_stiff_for_the_steps_is_run_again_or_flagged(program):
    values = {key: column[:130].copy() for key, column in varied(300).items()}
    values["a.parts.0.volume"] = values.pop(("a.parts.0.volume", "b.parts.0.volume"))
    with pytest.raises(KeyError):
        program.run({**values, "nothing": np.ones(130)})
    values = {key: column[:130].copy() for key, column in varied(300).items()}
    volumes = values[("a.parts.0.volume", "b.parts.0.volume")]
    volumes[3], volumes[4] = 3e-5, 1e-8
    found = program.run(values)
    exact = single(driven(), values, 3)
    assert found.usable[3]
    np.testing.assert_allclose(found["A.pressure"][3], exact["A.pressure"], rtol=0, atol=3e-4 * 2e7)
    assert not found.usable[4] and found.usable[5:].all()
    assert set(found.statuses) <= {"ok", "inaccurate", "non_finite"}


def test_single_precision(program):
    found = jl.ensemble(
        driven(),
        TIMES,
        varied(300),
        {"spool": COMMAND},
        initial=START,
        outputs=["A.pressure"],
        precision="float32",
        engine="explicit",
        steps=program.steps,
        audit=0,
    )
    assert found["A.pressure"].dtype == np.float32
    exact = program.run(varied(300))["A.pressure"]
    np.testing.assert_allclose(found["A.pressure"], exact, rtol=0, atol=2e-5 * 2e7)


def test_blocks_give_the_same_as_single_numbers(program):
    """Circuits too large for an array for each number: the same field in blocks."""
    blocks = dataclasses.replace(program, program=program.program._replace(small=False))
    values = {key: column[:128] for key, column in varied(300).items()}
    found, exact = blocks.run(values), program.run(values)
    for name in ("A.pressure", "gauge", "valve.spool", "peak"):
        np.testing.assert_allclose(found[name], exact[name], rtol=1e-9, atol=1e-9 * np.abs(exact[name]).max())


def test_inputs_vary_by_lane():
    """Whole records, delays and amplitudes of inputs as numbers of lanes."""
    records = np.random.default_rng(0).uniform(-0.5, 0.5, (130, 11))
    values = {"spool.values": records, "spool.delay": np.linspace(0.0, 0.05, 130)}
    found = jl.ensemble(
        driven(), TIMES, values, {"spool": COMMAND}, initial=START, outputs=["A.pressure"], steps=16, engine="explicit",
        audit=0,
    )  # fmt: skip
    for lane in (0, 129):
        signal = jl.Sampled(COMMAND.times, records[lane], delay=values["spool.delay"][lane])
        one = jl.simulate(driven(), TIMES, {"spool": signal}, initial=START, tolerance=1e-9)
        np.testing.assert_allclose(found["A.pressure"][lane], one["A.pressure"], rtol=0, atol=2e-4 * 2e7)


def test_wrong_calls_are_refused():
    def call(values, **other):
        jl.prepare_ensemble(draining(), TIMES, values, initial={"A.pressure": 2e7}, **other)

    good = {"vessel.volume": np.array([1e-3, 2e-3])}
    with pytest.raises(KeyError, match="did you mean"):
        call({"vessel.volum": good["vessel.volume"]})
    with pytest.raises(ValueError, match="same number of lanes"):
        call(good | {"leak.conductance": np.ones(3)})
    with pytest.raises(ValueError, match="one number for each lane"):
        call({"vessel.volume": 1e-3})
    with pytest.raises(ValueError, match="varied twice"):
        call({"vessel.volume": good["vessel.volume"], "vessel.parts.0.volume": good["vessel.volume"]})
    with pytest.raises(ValueError, match="in SI"):
        call({"vessel.volume": np.array([-1.0, np.nan])})
    with pytest.raises(ValueError, match="share of each output"):
        call(good, tolerance=10.0)
    with pytest.raises(ValueError, match="engine must be"):
        call(good, engine="fast")
    with pytest.raises(ValueError, match="steady state"):
        jl.ensemble(draining(), TIMES, good, initial="steady")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"volume must have the shape \(lanes\)"):
        call({"vessel.volume": np.ones((2, 3))})
    wrong: Any
    for wrong in ([jl.Peak("A.pressure")], {"peak": jl.Peak}):
        with pytest.raises(TypeError, match="by name"):
            call(good, reductions=wrong)
    with pytest.raises(ValueError, match="percent"):
        jl.TimeQuantile("A.pressure", 95.0)
    with pytest.raises(KeyError, match="output"):
        call(good, outputs=["B.pressure"])
