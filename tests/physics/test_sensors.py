"""Sensors: what they read, in which unit, and the state of their lag."""

import jax
import numpy as np
import pytest

import jaxlines as jl
from jaxlines.physics.component import State
from jaxlines.physics.fields import check_fields
from jaxlines.physics.sensors import (
    AbstractSensor,
    AngleSensor,
    DifferentialPressureSensor,
    FlowSensor,
    LevelSensor,
    PositionSensor,
    PressureSensor,
    SpeedSensor,
    StateSensor,
    VelocitySensor,
)

OIL = jl.Oil(1e9, 850.0, mass="article", atmospheric_pressure=1e5)
# Sensor, what it reads, a value of it, and what it then shows with gain 2 and offset 3 (by hand).
SENSORS = {
    "absolute": (PressureSensor("A", 2.0, 3.0), "A.pressure", 5e5, 1e6 + 3),
    "gauge": (PressureSensor("A", 2.0, 3.0, reference="gauge"), "A.pressure", 5e5, 8e5 + 3),
    "differential": (DifferentialPressureSensor("A", "B", 2.0, 3.0), "A.pressure", 4e5, 8e5 + 3),
    "level": (LevelSensor("A", 10.0, 2.0, 3.0), "A.pressure", 1e5 + 850 * 9.80665 * 4.0, 2 * 14.0 + 3),
    "flow": (FlowSensor("valve.a", 2.0, 3.0), "valve.a.flow", 1e-3, 3.002),
    "speed": (SpeedSensor("shaft", 2.0, 3.0), "shaft.speed", 7.0, 17.0),
    "velocity": (VelocitySensor("rod", 2.0, 3.0), "rod.velocity", 7.0, 17.0),
    "position": (PositionSensor("cylinder.position", 2.0, 3.0), "cylinder.position", 0.2, 3.4),
    "angle": (AngleSensor("motor.angle", 2.0, 3.0), "motor.angle", 0.2, 3.4),
    "state": (StateSensor("valve.spool", 2.0, 3.0), "valve.spool", 0.2, 3.4),
}


@pytest.mark.parametrize("name", SENSORS)
def test_reading(name):
    sensor, read, value, shown = SENSORS[name]
    assert sensor.quantity_read() == read
    assert sensor.quantity_subtracted() == ("B.pressure" if name == "differential" else None)
    assert float(sensor.read(value, OIL)) == pytest.approx(shown, rel=1e-12)
    step = float(sensor.read(value + 1.0, OIL)) - float(sensor.read(value, OIL))
    assert float(sensor.slope(OIL)) == pytest.approx(step, rel=1e-6)
    assert sensor.unit("Pa") == ("m" if name == "level" else "Pa")


def test_every_sensor_is_tested_and_holds_arrays():
    known, left = set(), [AbstractSensor]
    while left:
        subclasses = left.pop().__subclasses__()
        left += subclasses
        known |= {kind for kind in subclasses if kind.__module__ == "jaxlines.physics.sensors"}
    assert known == {type(sensor) for sensor, *_ in SENSORS.values()}
    for sensor, *_ in SENSORS.values():
        check_fields(sensor)
        assert all(isinstance(leaf, np.ndarray) and leaf.dtype == np.float64 for leaf in jax.tree.leaves(sensor))


@pytest.mark.parametrize("name", SENSORS)
def test_a_lag_is_a_state_where_there_is_one(name):
    sensor = SENSORS[name][0]
    assert sensor.lag_states("Pa", 1e6) == () and float(sensor.delay) == 0.0
    slow = PressureSensor("A", lag=0.2, delay=0.1)
    assert slow.lag_states("Pa", 1e6) == (State("reading", "Pa", 1e6),)
    assert float(slow.lag_rate(5e5, 3e5)) == pytest.approx(1e6)


def test_a_lag_that_is_being_fitted_is_a_state():
    with jax.enable_x64(True):

        def states(lag):
            assert len(PressureSensor("A", lag=lag).lag_states("Pa", 1e6)) == 1
            return lag

        jax.jit(states)(0.0)


def test_the_lag_follows_a_step():
    """y = u (1 - e^(-t/tau)), by the rate it states."""
    sensor, shown, step = VelocitySensor("rod", lag=0.05), 0.0, 1e-5
    for _ in range(10000):
        shown += step * float(sensor.lag_rate(2.0, shown))
    assert shown == pytest.approx(2.0 * (1 - np.exp(-2.0)), rel=1e-3)


def test_sensors_in_a_circuit():
    """What a sensor shows of a run is gain and offset of what it reads."""
    parts = {
        "pump": jl.FlowSource("A", 1e-5),
        "line": jl.Line("A", jl.Vessel(1e-3)),
        "leak": jl.LaminarLeak("A", "T", 1e-11),
    }
    parts |= {"tank": jl.Tank("T", 1e5), "gauge": PressureSensor("A", 1.1, 200.0, reference="gauge")}
    parts |= {"flow": FlowSensor("leak.a", 0.5, 1e-6), "any": StateSensor("A.pressure", 1e-5)}
    sim = jl.simulate(jl.Circuit(OIL, parts), np.linspace(0, 0.1, 11), outputs=["A.pressure", "gauge", "flow", "any"])
    p = sim["A.pressure"]
    assert p[-1] > p[0] + 5e5
    np.testing.assert_allclose(sim["gauge"], 1.1 * (p - 1e5) + 200.0, rtol=1e-12)
    np.testing.assert_allclose(sim["flow"], 0.5e-11 * (p - 1e5) + 1e-6, rtol=1e-12)
    np.testing.assert_allclose(sim["any"], 1e-5 * p, rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PressureSensor("A", reference="relative"), 'reference must be "absolute" or "gauge"'),
        (lambda: PressureSensor("A", lag=-1.0), "lag must be .* got -1 s: was it given in ms"),
        (lambda: FlowSensor("a.b", delay=1e5), "delay must be .* got 100000 s: was it given in ms"),
    ],
)
def test_wrong_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
