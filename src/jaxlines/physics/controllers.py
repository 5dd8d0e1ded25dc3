"""Controllers: what closes a loop between what is measured and what is driven, continuous or sampled.

A driven field that has the name of a controller, such as `Servovalve(..., command="rate_loop")`, follows its output.
A controller reads potentials of nodes, states of components, or sensors ("shaft.speed", "valve.spool", "gauge"); not
flows, which would depend on its output at the same instant.
"""

import dataclasses
from abc import abstractmethod

import equinox as eqx
import numpy as np

from jaxlines.physics.component import AbstractComponent, Contribution, Situation, State
from jaxlines.physics.fields import Number, array_module, driven, is_concrete, quantity


def read_name():
    """Field: the name of a quantity or a sensor that a controller reads; its value is `at.given[field]`."""
    return eqx.field(static=True, metadata={"reads": True})


def reads_of(module) -> dict[str, str]:
    """Field -> the quantity or sensor that it names, for everything that a controller reads."""
    return {f.name: getattr(module, f.name) for f in dataclasses.fields(module) if f.metadata.get("reads")}


class AbstractController(AbstractComponent):
    """Gives an output that follows from its states, from what it reads and from its driven fields."""

    @abstractmethod
    def output(self, at: Situation) -> Number:
        """The output in a situation, element by element."""


class AbstractSampledController(AbstractController):
    """A controller whose states change only at its sampling instants, the start and every period after it.

    Between them everything is held, so that its output is one of its states.
    """

    @abstractmethod
    def sampling_period(self) -> Number:
        """Time from one instant to the next [s]."""

    @abstractmethod
    def sampled(self, at: Situation) -> dict:
        """All states after a sampling instant in which it finds a situation."""

    def evaluate(self, at: Situation) -> Contribution:
        return Contribution()


def smooth_excess(x, width):
    """max(x, 0) made smooth, w ln(1 + exp(x/w)): 0.69 w at x = 0, 4.5e-5 w at x = -10 w; -inf gives 0.

    Args: x and width w > 0 in the same unit.
    """
    xp = array_module(x, width)
    safe = xp.where(x > -xp.inf, x, 0.0)
    return xp.where(x > -xp.inf, width * xp.logaddexp(safe / width, 0.0), 0.0)


def smooth_limits(value, low, high, width):
    """A value kept between two limits, with corners rounded over a width; the limits may be infinite.

    The value itself further inside than 10 widths (within 5e-5 width), the limit further outside.
    """
    return value + smooth_excess(low - value, width) - smooth_excess(value - high, width)


def _gain(default):
    """Field: a gain of a controller, in units of output and measurement."""
    return quantity("1", low=-1e15, high=1e15, default=default)


def _limit(default: float):
    """Field: a limit of a controller's output, in its unit; infinite for none."""
    return quantity("1", default=default)


def _positive(unit: str, default: float):
    """Field: a number above zero."""
    return quantity(unit, low=1e-9, high=1e9, slip="it must be above zero", default=default)


def _tracking_gain(controller) -> Number:
    """k_t of the anti-windup; not zero, so that a controller without proportional and integral action divides by 1."""
    gain = controller.gain if controller.tracking_gain is None else controller.tracking_gain
    return array_module(gain).where(gain == 0.0, 1.0, gain)


def _check_tracking(controller) -> None:
    """Raise ValueError when the anti-windup would push the integral away from the limit."""
    gain = controller.gain if controller.tracking_gain is None else controller.tracking_gain
    integral = controller.integral_gain
    if is_concrete(gain) and is_concrete(integral) and np.any((integral != 0.0) & ~(gain * integral > 0.0)):
        raise ValueError(
            "integral action needs a tracking_gain (the gain, unless given) of the sign of integral_gain, got "
            f"{float(np.ravel(gain)[0]):g} and {float(np.ravel(integral)[0]):g}"
        )


class PIController(AbstractController):
    """Proportional-integral controller with limits and anti-windup, continuous in time.

    e = r - y,  v = k_p e + I,  u = v between the limits,  dI/dt = k_i (e + (u - v)/k_t)

    Args:
        measured: the quantity or sensor that is y, such as "shaft.speed"; reference r: a number, a signal, the name
            of an input or of another controller, in the unit of y.
        gain k_p [unit of u per unit of y]; integral_gain k_i [the same per s].
        low, high: limits of the output; rounding: over which their corners are smooth, in the unit of u.
        tracking_gain k_t of the anti-windup [as k_p]; None is k_p: at a limit I settles within the time k_p/k_i.
    Raises: ValueError for integral action with a k_t of zero or of the other sign.
    Validity: I starts at 0 unless `initial` says otherwise ("rate_loop.integral").
    Typical values: output -1..1 for a valve's command.
    Reference: Astrom and Murray, "Feedback Systems", 2008, sec. 10.4: back-calculation (unverified: from memory).
    """

    measured: str = read_name()
    reference: Number = driven("1")
    gain: Number = _gain(1.0)
    integral_gain: Number = _gain(0.0)
    low: Number = _limit(-float("inf"))
    high: Number = _limit(float("inf"))
    rounding: Number = _positive("1", 0.01)
    tracking_gain: Number | None = _gain(None)

    states = (State("integral", "1", 1.0),)

    def __check_init__(self):
        _check_tracking(self)

    def _demand(self, at: Situation):
        """Deviation e and output before the limits v."""
        deviation = at.given["reference"] - at.given["measured"]
        return deviation, self.gain * deviation + at.state["integral"]

    def output(self, at: Situation):
        return smooth_limits(self._demand(at)[1], self.low, self.high, self.rounding)

    def evaluate(self, at: Situation) -> Contribution:
        deviation, demand = self._demand(at)
        excess = smooth_limits(demand, self.low, self.high, self.rounding) - demand
        return Contribution(rate={"integral": self.integral_gain * (deviation + excess / _tracking_gain(self))})


class PIDController(AbstractController):
    """PID controller with filtered derivative of the measurement, limits and anti-windup, continuous in time.

    e = r - y,  v = k_p e + I - k_d (y - x)/T_f,  u = v between the limits,
    dI/dt = k_i (e + (u - v)/k_t),  dx/dt = (y - x)/T_f

    Args: as `PIController`, and derivative_gain k_d [unit of u per unit of y, times s]; filter_time T_f [s].
    Validity: the derivative does not act on the reference, so that a step of it gives no kick; x starts at y.
    Typical values: T_f = k_d/(10 k_p).
    Reference: Astrom and Murray, "Feedback Systems", 2008, secs. 10.4 and 10.5 (unverified: quoted from memory).
    """

    measured: str = read_name()
    reference: Number = driven("1")
    gain: Number = _gain(1.0)
    integral_gain: Number = _gain(0.0)
    derivative_gain: Number = _gain(0.0)
    filter_time: Number = _positive("s", 0.01)
    low: Number = _limit(-float("inf"))
    high: Number = _limit(float("inf"))
    rounding: Number = _positive("1", 0.01)
    tracking_gain: Number | None = _gain(None)

    states = (State("integral", "1", 1.0), State("filtered", "1", 1.0))

    def __check_init__(self):
        _check_tracking(self)

    def start(self, at: Situation) -> dict:
        return {"filtered": at.given["measured"]}

    def _demand(self, at: Situation):
        """Deviation e, slope of the measurement (y - x)/T_f, and output before the limits v."""
        deviation = at.given["reference"] - at.given["measured"]
        slope = (at.given["measured"] - at.state["filtered"]) / self.filter_time
        return deviation, slope, self.gain * deviation + at.state["integral"] - self.derivative_gain * slope

    def output(self, at: Situation):
        return smooth_limits(self._demand(at)[2], self.low, self.high, self.rounding)

    def evaluate(self, at: Situation) -> Contribution:
        deviation, slope, demand = self._demand(at)
        excess = smooth_limits(demand, self.low, self.high, self.rounding) - demand
        integral = self.integral_gain * (deviation + excess / _tracking_gain(self))
        return Contribution(rate={"integral": integral, "filtered": slope})


class SampledController(AbstractSampledController):
    """PID controller in a computer: reads, computes and holds its output (zero-order hold) every h = `period` seconds.

    At each instant, with e = r - y and y' the measurement one instant earlier:
    D <- (T_f D - k_d (y - y'))/(T_f + h),  v = k_p e + I + D,  u = v between the limits,
    I <- I + k_i h e + (1 - exp(-h k_i/k_t)) (u - v)

    Args: period h [s], its first instant is the start of the simulation; others as `PIDController`.
    Raises: NotImplementedError when the period is to be differentiated.
    Validity: no time for the computation. Several sampled controllers act at once: each sees the others as they were
        just before. The output just after an instant is shown at the instant.
    Typical values: the antennas' rate loop 0.05 s (20 Hz).
    Reference: Astrom and Murray, "Feedback Systems", 2008, sec. 10.5 (unverified: quoted from memory).
    """

    measured: str = read_name()
    period: Number = quantity("s", low=1e-6, high=1e6, slip="was it given in Hz or ms?")
    reference: Number = driven("1")
    gain: Number = _gain(1.0)
    integral_gain: Number = _gain(0.0)
    derivative_gain: Number = _gain(0.0)
    filter_time: Number = _positive("s", 0.01)
    low: Number = _limit(-float("inf"))
    high: Number = _limit(float("inf"))
    rounding: Number = _positive("1", 0.01)
    tracking_gain: Number | None = _gain(None)

    states = (
        State("output", "1", 1.0),
        State("integral", "1", 1.0),
        State("derivative", "1", 1.0),
        State("last_measured", "1", 1.0),
    )

    def __check_init__(self):
        _check_tracking(self)

    def start(self, at: Situation) -> dict:
        return {"last_measured": at.given["measured"]}

    def output(self, at: Situation):
        return at.state["output"]

    def sampling_period(self):
        return self.period

    def sampled(self, at: Situation) -> dict:
        measured, h, xp = at.given["measured"], self.period, array_module(at)
        deviation = at.given["reference"] - measured
        change = measured - at.state["last_measured"]
        derivative = self.filter_time * at.state["derivative"] - self.derivative_gain * change
        derivative = derivative / (self.filter_time + h)
        demand = self.gain * deviation + at.state["integral"] + derivative
        output = smooth_limits(demand, self.low, self.high, self.rounding)
        back = (1.0 - xp.exp(-h * self.integral_gain / _tracking_gain(self))) * (output - demand)
        integral = at.state["integral"] + self.integral_gain * h * deviation + back
        return {"output": output, "integral": integral, "derivative": derivative, "last_measured": measured}
