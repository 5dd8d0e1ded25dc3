"""Circuits as text: what is written builds a circuit with equal numbers and structure, for every public class."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

import jaxlines as jl
from jaxlines.catalogue.dsn70m_drive import axis_drive
from jaxlines.edge.building import StudyError, _kinds
from jaxlines.edge.circuit_text import circuit_from_toml, circuit_to_toml
from jaxlines.physics.component import AbstractComponent
from jaxlines.physics.controllers import PIController, PIDController, SampledController
from jaxlines.physics.fields import AbstractSignal, ports_of
from jaxlines.physics.sensors import AbstractSensor
from tests.physics.test_components import OILS, PARTS

OIL = jl.Oil(1.379e9, 850.0)
SIGNALS = [
    jl.Constant(0.25),
    jl.Step(0.1, 0.3, 0.05),
    jl.Sine(0.2, 0.1, 3.0, 0.7),
    jl.Sampled([0.0, 0.1, 0.7], [0.1, 0.3, 0.2], "cubic", delay=0.01),
]
CONTROLLERS = {
    "pi": PIController("a.pressure", "demand", 2.0, 3.0, -1.0, 1.0),
    "pid": PIDController("gauge", jl.Sine(0.0, 1.0), 2.0, 3.0, 0.1),
    "sampled": SampledController("a.pressure", 0.05, 0.5, 2.0, high=4.0),
}


def same(circuit: jl.Circuit, fluid=None) -> str:
    """Write a circuit, build it again, and require that they are equal; returns the text."""
    text = circuit_to_toml(circuit)
    again = circuit_from_toml(text)
    assert jax.tree.structure(again) == jax.tree.structure(circuit), text
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(circuit), strict=True):
        assert np.asarray(ours).dtype == np.asarray(theirs).dtype
        np.testing.assert_array_equal(ours, theirs)
    assert list(again.components) == list(circuit.components)
    assert circuit_to_toml(again) == text
    return text


def surrounded(part) -> dict:
    """A component with what its nodes need to be legal."""
    around = {}
    for node, domain in {getattr(part, port): domain for port, domain in ports_of(part).items()}.items():
        made = {"rotational": jl.Inertia, "translational": jl.Mass}.get(domain)
        around[f"at {node}"] = made(node, 1.0) if made else jl.Line(node, jl.Vessel(1e-3))
    return around | {"part": part}


@pytest.mark.parametrize("name", [*PARTS, *CONTROLLERS])
def test_every_component(name):
    same(jl.Circuit(OIL, surrounded((PARTS | CONTROLLERS)[name])))


def test_every_public_component_is_among_them():
    public = set(_kinds(AbstractComponent).values())
    assert public == {type(part) for part in (PARTS | CONTROLLERS).values()}


@pytest.mark.parametrize("name", OILS)
def test_fluids_with_their_laws(name):
    text = same(jl.Circuit(OILS[name], surrounded(PARTS["leak"])))
    assert ('mass = "article"' in text) == (OILS[name].mass == "article")


def test_a_fluid_with_everything_else():
    other = jl.Oil(
        1.6e9,
        870.0,
        liquid=jl.Tait(),
        viscosity=jl.Vogel(900.0, 170.0),
        air=jl.DissolvingAir(jl.HenrySolubility()),
        air_fraction=0.02,
        temperature=330.0,
        vapour_pressure=50.0,
        atmospheric_pressure=9.4e4,
    )
    text = same(jl.Circuit(other, surrounded(PARTS["leak"])))
    assert 'atmospheric_pressure = "94000.0 Pa_a"' in text


@pytest.mark.parametrize("signal", SIGNALS, ids=lambda s: type(s).__name__)
def test_signals(signal):
    assert {type(s) for s in SIGNALS} == set(_kinds(AbstractSignal).values())
    parts: dict = {"supply": jl.PressureSource("P", signal), "orifice": jl.Orifice("P", "T", signal)}
    same(jl.Circuit(OIL, {**parts, "tank": jl.Tank("T", signal)}))


def test_sensors_and_names():
    named = {}
    for i, kind in enumerate(_kinds(AbstractSensor).values()):
        needed = [f.name for f in dataclasses.fields(kind) if f.default is dataclasses.MISSING]
        named[f"sensor \N{NUMERO SIGN} {i}"] = kind(**dict.fromkeys(needed, "A"))
    assert len(named) >= 5
    gauge = jl.PressureSensor("A", gain=1.01, offset=-250.0, reference="gauge")
    text = same(jl.Circuit(OIL, surrounded(PARTS["leak"]) | named | {'say "p"': gauge, "tank-2": jl.Tank("T2")}))
    assert '[circuit."say \\"p\\""]' in text and "[circuit.tank-2]" in text


def test_the_drive_reads_as_a_study():
    text = same(axis_drive("elevation"))
    assert '[circuit.servovalve]\ntype = "Servovalve"\nsupply = "P_S"\ntank = "P_R"\na = "A"\nb = "B"' in text
    assert 'command = { input = "spool" }' in text
    assert 'pressure = "20700000.0 Pa_a"' in text
    assert "opening" not in text  # has its default


@given(st.floats(1e-9, 0.1), st.floats(1e5, 1e15), st.floats(0.0, 1e3), st.floats(1e3, 1e8))
def test_numbers_come_back_bit_by_bit(volume, modulus, length, pressure):
    line = jl.Line("A", [jl.Vessel(volume, modulus), jl.Vessel(1e-3)], length)
    same(jl.Circuit(OIL, {"line": line, "source": jl.PressureSource("A", pressure)}))


def test_what_cannot_be_written_or_read():
    circuit = jl.Circuit(OIL, {"line": jl.Line("A", jl.Vessel(1e-3))})
    with pytest.raises(TypeError, match=r"circuit\.line\.parts\.0\.volume is traced by JAX"):
        jax.jit(lambda v: circuit_to_toml(circuit.replace({"line.volume": v})) and v)(1e-3)
    with pytest.raises(StudyError, match="not valid TOML"):
        circuit_from_toml("[fluid\n")
    with pytest.raises(StudyError, match=r"circuit\.line: unknown key 'nod', did you mean 'node'"):
        circuit_from_toml(circuit_to_toml(circuit).replace("node = ", "nod = "))
    with pytest.raises(StudyError, match="'bulk_modulus' is missing"):
        circuit_from_toml("")
    assert eqx.tree_equal(circuit_from_toml(circuit_to_toml(circuit) + '\n[simulate]\nstop = "1 s"\n'), circuit)
