"""Circuits: what is refused when one is built, and the table that it prints."""

import jax
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.catalogue.dsn70m_drive import axis_drive

OIL = jl.Oil(1.379e9, 850.0)
VOLUME: dict = {"line": jl.Line("A", jl.Vessel(1e-3))}


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"leak": jl.LaminarLeak("A", "B", 1e-12)},
            r"hydraulic node 'B' has no capacity, so that its pressure is undetermined: attach a Line .a Vessel is a "
            r"plain volume., or a PressureSource, or correct the name; attached to it: leak\.b",
        ),
        (
            {"load": jl.LoadTorque("shaft", 1.0)},
            r"rotational node 'shaft' has no capacity.* attach an Inertia, .* attached to it: load\.shaft",
        ),
        (
            {"motor": jl.Motor("A", "A", "case", "shaft", 1e-4), "inertia": jl.Inertia("shaft", 1.0)},
            r"hydraulic node 'case' .* attached to it: motor\.case",
        ),
        (
            {"pipe": jl.Line("A", jl.Pipe(1.0, 0.01, 0.02), to="end", model="T", segments=3)},
            r"hydraulic node 'end' .* attached to it: pipe\.to",
        ),
    ],
)
def test_a_port_attached_to_nothing_else_is_refused(parts, message):
    with pytest.raises(ValueError, match=message):
        jl.Circuit(OIL, VOLUME | parts)


@pytest.mark.parametrize(
    "parts",
    [
        {"other": jl.Line("B", jl.Vessel(1e-3))},
        {"pipe": jl.Line("A", jl.Pipe(1.0, 0.01, 0.02), to="end")},  # a closed end, its segments not yet chosen
        {"tank": jl.Tank("T")},
        {"inertia": jl.Inertia("shaft", 1.0)},
        {"gas": jl.Accumulator("G", 1e-3, 5e6)},
    ],
)
def test_a_dead_end_that_stores_is_legal(parts):
    jl.Circuit(OIL, VOLUME | parts)


def test_a_negative_share_of_a_wall_is_refused():
    with pytest.raises(ValueError, match=r"effective_modulus must not exceed the fluid's.*were they swapped"):
        jl.Line.from_effective_modulus("A", 1e-3, 1.5e9, 1.379e9)


def test_the_table_of_a_circuit():
    rows = str(axis_drive("azimuth")).splitlines()
    assert rows[0].split() == ["name", "type", "nodes", "numbers"]
    cells = {row.split()[0]: " ".join(row.split()) for row in rows}
    assert cells["fluid"].startswith("fluid Oil bulk_modulus 1.37895e+09 Pa, density 850 kg/m^3")
    assert cells["supply"] == "supply PressureSource P_S pressure 2.07e+07 Pa"
    assert cells["drain"] == "drain Tank P_D"  # its pressure is the default
    assert "supply=P_S tank=P_R a=A b=B command <- spool, rated_flow 0.001 m^3/s" in cells["servovalve"]
    assert (
        "parts [Vessel(volume 0.0270976 m^3, wall_modulus 1.97221e+10 Pa)], path_length 20.83 m" in cells["control_1"]
    )
    assert set(axis_drive("azimuth").components) < set(cells)
    assert max(map(len, rows)) < 180


def test_the_table_shows_signals_tables_and_what_is_not_there():
    signal = jl.Sampled([0.0, 1.0, 2.0], [0.0, 2e-5, 1e-5])
    circuit = jl.Circuit(OIL, VOLUME | {"pump": jl.FlowSource("A", signal), "gauge": jl.PressureSensor("A")})
    shown = " ".join(str(circuit).split())
    assert (
        "pump FlowSource A flow Sampled(times 3 values 0..2, values 3 values 0..2e-05, method linear, delay 0 s"
        in shown
    )
    assert "gauge PressureSensor node A" in shown
    texts = []

    def look(volume):
        texts.append(str(circuit.replace({"line.volume": volume})))
        return volume

    jax.jit(look)(np.float32(1e-3))
    assert "volume traced" in texts[0]
    assert "volume" in str(jax.eval_shape(lambda: circuit))
