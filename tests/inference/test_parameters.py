"""Free and known parameters: coordinates, slopes, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import jaxlines as jl

PARAMETERS = [
    jl.Free("a", (-2.0, 5.0)),
    jl.Free("a", (1e-6, 1e3), transform="log"),
    jl.Free("a", (-2.0, 5.0), transform="logit"),
]


@given(share=st.floats(0.01, 0.99), which=st.integers(0, 2))
@settings(deadline=None)
def test_coordinates_invert_and_slopes_are_their_derivatives(share, which):
    free = PARAMETERS[which]
    low, high = free.coordinate_bounds()
    coordinate = low + share * (high - low)
    value = float(free.to_value(coordinate))
    assert free.bounds[0] <= value <= free.bounds[1]
    assert float(free.to_coordinate(value)) == pytest.approx(coordinate, abs=1e-6 * (high - low))
    step = 1e-4
    difference = (float(free.to_value(coordinate + step)) - float(free.to_value(coordinate - step))) / (2 * step)
    assert float(free.slope(value)) == pytest.approx(difference, rel=1e-4, abs=1e-10)


@pytest.mark.parametrize("free", PARAMETERS)
def test_bounds_are_reached(free):
    ends = [float(free.to_value(end)) for end in free.coordinate_bounds()]
    np.testing.assert_allclose(ends, free.bounds, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bounds": (2.0, 1.0)}, "finite and increasing, got 2..1"),
        ({"bounds": (0.0, np.inf)}, "finite and increasing"),
        ({"bounds": (0.0, 1.0), "transform": "log"}, "log transform needs positive bounds"),
        ({"bounds": (0.0, 1.0), "start": 7.0}, r"start 7 is outside its bounds 0\.\.1: other units"),
        ({"bounds": (0.0, 1.0), "transform": "sqrt"}, "transform must be one of identity, log, logit"),
        ({"bounds": (0.0, 1.0), "transform": "logit", "start": 1.0}, "cannot start on a bound"),
    ],
)
def test_wrong_free_parameters_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        jl.Free("fluid.air_fraction", **arguments)


def test_wrong_known_is_refused():
    with pytest.raises(ValueError, match=r"standard uncertainty must be positive, got -1"):
        jl.Known("line.volume", -1.0)


def test_recordings_refuse_what_cannot_be_a_recording():
    times = np.arange(5.0)
    with pytest.raises(ValueError, match=r"at sample 2 it goes from 1 s to 1 s"):
        jl.Recording(np.array([0.0, 1.0, 1.0, 2.0]), {})
    with pytest.raises(ValueError, match=r"channel 'p' has shape"):
        jl.Recording(times, {"p": np.zeros(4)})
    with pytest.raises(ValueError, match=r"two or more times"):
        jl.Recording(np.zeros(1), {})
    with pytest.raises(ValueError, match=r"not finite at sample 1"):
        jl.Recording(np.array([0.0, np.nan, 2.0]), {})


def test_missing_samples_are_masked_and_windows_keep_it():
    values = np.array([1.0, np.nan, 3.0, 4.0, 5.0])
    recording = jl.Recording(np.arange(5.0), {"p": values}, mask={"p": np.array([True, True, True, False, True])})
    assert recording.mask["p"].tolist() == [True, False, True, False, True]
    part = recording.window(1.0, 3.0)
    assert part.times.tolist() == [1.0, 2.0, 3.0]
    assert part.mask["p"].tolist() == [False, True, False]
