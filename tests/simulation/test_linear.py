"""Linearised circuits against closed forms: RLC, valve and motor, a ladder of segments, the distributed line."""

import jax
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.catalogue.dsn70m_drive import axis_drive
from jaxlines.physics.controllers import PIController, SampledController
from jaxlines.simulation.frequency import closed_end, input_impedance, line_matrix, transfer_impedance
from jaxlines.simulation.linear import linearise
from jaxlines.simulation.steady import steady_state

BETA = 1.379e9
OIL = jl.Oil(BETA, 850.0, 27.7e-6, mass="article")


def test_inertia_resistance_and_capacitance():
    """w_0 = 1/sqrt(I C), zeta = (R/2) sqrt(C/I), and the response to the supply."""
    inertance, resistance, compliance = 1e7, 3e8, 1e-3 / BETA
    column = jl.FluidInertia("P", "A", inertance, resistance)
    parts = {"supply": jl.PressureSource("P", "supply"), "column": column, "line": jl.Line("A", jl.Vessel(1e-3))}
    linear = linearise(jl.Circuit(OIL, parts), {"supply": 6e6}, outputs=["A.pressure", "column.volume_flow"])
    w, z = 1 / np.sqrt(inertance * compliance), 0.5 * resistance * np.sqrt(compliance / inertance)
    (mode,) = linear.modes()
    assert mode.natural_frequency == pytest.approx(w, rel=1e-10)
    assert mode.damping_ratio == pytest.approx(z, rel=1e-10)
    assert mode.frequency == pytest.approx(w / (2 * np.pi), rel=1e-10)
    assert set(mode.states) == {"A.pressure", "column.volume_flow"}
    np.testing.assert_allclose(linear.a, [[0, 1 / compliance], [-1 / inertance, -resistance / inertance]], rtol=1e-12)
    np.testing.assert_allclose(linear.b, [[0], [1 / inertance]], rtol=1e-12)
    f = np.array([0.0, 5.0, w / (2 * np.pi), 100.0])
    s = 2j * np.pi * f
    closed = 1 / (1 + s * resistance * compliance + s * s * inertance * compliance)
    np.testing.assert_allclose(linear.frequency_response(f, "A.pressure", "supply"), closed, rtol=1e-9)
    np.testing.assert_allclose(linear.frequency_response(f)[:, 1, 0], closed * s * compliance, rtol=1e-9)
    assert linear.is_stable() and linear.at["A.pressure"] == pytest.approx(6e6, rel=1e-12)


def valve_and_motor(spool, viscous=0.0, leakage=0.0):
    """A servovalve, two lines of 1 litre and a motor on an inertia."""
    valve = jl.Servovalve("P", "T", "A", "B", "spool", 1e-3, underlap=1e-6, transition=1.0)
    motor = jl.Motor("A", "B", "T", "shaft", 1e-4, leakage, 0.0, viscous)
    parts = {
        "supply": jl.PressureSource("P", 20e6),
        "tank": jl.Tank("T", 1e6),
        "valve": valve,
        "line_a": jl.Line("A", jl.Vessel(1e-3)),
        "line_b": jl.Line("B", jl.Vessel(1e-3)),
        "motor": motor,
        "inertia": jl.Inertia("shaft", 40.0),
    }
    return jl.Circuit(OIL, parts), {"spool": spool}


def test_hydraulic_natural_frequency_and_damping():
    """w_h = sqrt(4 beta D^2/(V_t J)), delta_h = (K_ce/D) sqrt(beta J/V_t), K_c = Q/(2 (p_s - p_L))."""
    displacement, inertia, total, leakage = 1e-4, 40.0, 2e-3, 2e-12
    linear = linearise(*valve_and_motor(0.2, leakage=leakage))
    speed = linear.at["shaft.speed"]
    load = linear.at["A.pressure"] - linear.at["B.pressure"]
    coefficient = (displacement * speed + leakage * load) / (2 * (19e6 - load)) + leakage
    (mode,) = [m for m in linear.modes() if "shaft.speed" in m.states]
    natural = np.sqrt(4 * BETA * displacement**2 / (total * inertia))
    assert speed > 1.0
    assert mode.natural_frequency == pytest.approx(natural, rel=1e-5)
    assert mode.damping_ratio == pytest.approx(coefficient / displacement * np.sqrt(BETA * inertia / total), rel=1e-5)


def test_viscous_friction_adds_to_the_damping():
    """At the null, with B: w^2 = w_h^2 (1 + K_ce B/D^2), 2 zeta w = 4 beta K_ce/V_t + B/J."""
    displacement, inertia, total, leakage, viscous = 1e-4, 40.0, 2e-3, 2e-12, 300.0
    linear = linearise(*valve_and_motor(0.0, viscous, leakage), at={"A.pressure": 10.5e6, "B.pressure": 10.5e6})
    (mode,) = [m for m in linear.modes() if m.damping_ratio < 1 and "shaft.speed" in m.states]
    null = 0.5e-6 * 1e-3 / np.sqrt(3.5e6) / (2 * np.sqrt(9.5e6))  # slope of each of the four lands with pressure
    coefficient = leakage + null
    w2 = 4 * BETA / (total * inertia) * (displacement**2 + coefficient * viscous)
    assert mode.natural_frequency == pytest.approx(np.sqrt(w2), rel=1e-6)
    decay = 4 * BETA * coefficient / total + viscous / inertia
    assert 2 * mode.damping_ratio * mode.natural_frequency == pytest.approx(decay, rel=1e-6)


def closed_line(segments, friction=None):
    """A pipe that a flow source feeds at one end, closed at the other, at rest at 5 MPa."""
    pipe, oil = jl.Pipe(12.0, 0.012, 0.016), jl.Oil(1.4e9, 850.0, 30e-6, 0.002)
    line = jl.Line("A", pipe, to="B", segments=segments, weights=friction)
    circuit = jl.Circuit(oil, {"piston": jl.FlowSource("A", "flow"), "line": line})
    rest = {"A.pressure": 5e6, "B.pressure": 5e6}
    return linearise(circuit, {"flow": 0.0}, at=rest, outputs=["A.pressure", "B.pressure"]), pipe, oil


@pytest.mark.parametrize("weights", [None, jl.KagawaWeights(4)])
def test_a_line_in_segments_is_its_ladder(weights):
    linear, pipe, oil = closed_line(5, weights)
    f = np.array([0.5, 10.0, 26.0, 90.0])
    matrix = line_matrix(pipe, oil, 5e6, f, segments=5, friction=weights or "steady")
    near, far = linear.frequency_response(f)[..., 0].T
    np.testing.assert_allclose(near, input_impedance(matrix, closed_end()), rtol=1e-8)
    np.testing.assert_allclose(far, transfer_impedance(matrix, closed_end()), rtol=1e-8)


def test_many_segments_come_to_the_distributed_line():
    f, errors = np.array([4.0, 14.0]), []
    for segments in (10, 20):
        linear, pipe, oil = closed_line(segments, jl.KagawaWeights(10))
        matrix = line_matrix(pipe, oil, 5e6, f, friction=jl.KagawaWeights(10))
        exact = transfer_impedance(matrix, closed_end())
        far = linear.frequency_response(f, "B.pressure", "flow")
        errors.append(np.max(np.abs(far - exact) / np.abs(exact)))
    assert errors[1] < 0.003
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.15)


def test_sensors_and_inputs_that_pass_straight_through():
    parts = {
        "supply": jl.PressureSource("P", "supply"),
        "leak": jl.LaminarLeak("P", "A", 1e-11),
        "line": jl.Line("A", jl.Vessel(1e-3)),
        "drain": jl.LaminarLeak("A", "T", 3e-11),
        "tank": jl.Tank("T"),
        "gauge": jl.PressureSensor("P", gain=2.0, reference="gauge"),
        "meter": jl.FlowSensor("drain.a"),
    }
    linear = linearise(jl.Circuit(OIL, parts), {"supply": jl.Sampled([0.0, 1.0], [4e6, 8e6])}, time=0.25)
    assert linear.outputs == ("gauge", "meter") and linear.inputs == ("supply",)
    assert linear.at["gauge"] == pytest.approx(2.0 * (5e6 - 101325.0), rel=1e-12)
    np.testing.assert_allclose(linear.d, [[2.0], [0.0]], atol=1e-25)
    assert linear.frequency_response(0.0, "meter", "supply") == pytest.approx(0.75e-11, rel=1e-9)
    assert linear.eigenvalues() == pytest.approx([-4e-11 * BETA / 1e-3], rel=1e-9)


def test_a_closed_loop():
    """J s^2 + (B + k_p) s + k_i: an inertia with damping under a proportional-integral controller."""
    parts = {
        "inertia": jl.Inertia("shaft", 2.0),
        "damper": jl.RotaryDamper("shaft", 4.0),
        "drive": jl.LoadTorque("shaft", "loop"),
        "loop": PIController("shaft.speed", "demand", 10.0, 300.0),
    }
    linear = linearise(jl.Circuit(OIL, parts), {"demand": 1.0}, outputs=["shaft.speed"])
    (mode,) = linear.modes()
    assert mode.natural_frequency == pytest.approx(np.sqrt(150.0), rel=1e-9)
    assert mode.damping_ratio == pytest.approx(14.0 / (2 * np.sqrt(600.0)), rel=1e-9)
    s = 2j * np.pi * 3.0
    closed = (10.0 * s + 300.0) / (2.0 * s * s + 14.0 * s + 300.0)
    assert linear.frequency_response(3.0, "shaft.speed", "demand") == pytest.approx(closed, rel=1e-9)


def test_the_drive_at_speed():
    circuit = axis_drive("azimuth")
    steady = steady_state(circuit, {"spool": 0.5})
    linear = linearise(circuit, {"spool": 0.5}, at=steady)
    assert linear.is_stable() and linear.residual < 1e-6
    spool = [m for m in linear.modes() if "servovalve.spool" in m.states]
    assert spool[0].natural_frequency == pytest.approx(250.0, rel=1e-9)
    assert spool[0].damping_ratio == pytest.approx(0.7, rel=1e-9)
    up, down = (steady_state(circuit, {"spool": 0.5 + h}).initial["shaft.speed"] for h in (1e-4, -1e-4))
    slope = linear.frequency_response(0.0, "shaft.speed", "spool")
    assert np.real(slope) == pytest.approx((up - down) / 2e-4, rel=1e-6)
    assert "damping 0.7 (servovalve.spool" in str(linear)


def test_wrong_calls():
    circuit, inputs = valve_and_motor(0.0)
    with pytest.raises(KeyError, match=r"no output is called 'C\.pressure'"):
        linearise(circuit, inputs, at={}, outputs=["C.pressure"])
    with pytest.raises(KeyError, match="no input is called 'spoool'; did you mean spool"):
        linearise(circuit, inputs, at={}, input_names=["spoool"])
    parts: dict = {"inertia": jl.Inertia("shaft", 2.0), "drive": jl.LoadTorque("shaft", "loop")}
    loop = SampledController("shaft.speed", 0.02, 1.5, 10.0)
    with pytest.raises(ValueError, match="'loop' is sampled, so that the circuit has no linear differential"):
        linearise(jl.Circuit(OIL, {**parts, "loop": loop}), at={})
    with jax.enable_x64(True), pytest.raises(TypeError, match="outside of code that JAX traces"):
        jax.grad(lambda j: linearise(circuit.replace({"inertia.moment_of_inertia": j}), inputs).a[0, 0])(40.0)
