"""Faults of recordings, found and named before a fit: swapped units, dead channels, gaps in time."""

from typing import NamedTuple

import numpy as np

from jaxlines.inference.recording import Recording

_UNITS = {
    "Pa": ((1e-5, "bar"), (1e-6, "MPa"), (1e-3, "kPa"), (1 / 6894.757, "psi")),
    "m^3/s": ((6e4, "L/min"), (1e3, "L/s"), (3600.0, "m^3/h"), (1e6, "mL/s")),
    "rad/s": ((60 / (2 * np.pi), "rpm"), (180 / np.pi, "deg/s")),
    "rad": ((180 / np.pi, "deg"), (1 / (2 * np.pi), "revolutions")),
    "m": ((1e3, "mm"), (1e2, "cm")),
    "m/s": ((1e3, "mm/s"),),
}
"""SI unit -> what a reading is too large by when it is in another unit and taken for SI."""

_SWAPS = {
    "Pa": (
        (10.0, "bar was taken for MPa"),
        (0.1, "MPa was taken for bar"),
        (14.504, "psi was taken for bar"),
        (1 / 14.504, "bar was taken for psi"),
        (6.895, "psi and kPa were swapped"),
        (1 / 6.895, "psi and kPa were swapped"),
        (1e5, "Pa was taken for bar"),
        (6894.757, "Pa was taken for psi"),
        (1e6, "Pa was taken for MPa"),
    )
}
_GRAVE = 100.0
"""No start of a fit is wrong by this factor."""

_ALIKE, _ALIKE_FAR = 0.16, 0.35
"""Decades within which a factor is that of a unit; a fit may start a factor of two off, and the smaller factors lie
too near to each other for that."""


class Fault(NamedTuple):
    """Something wrong with a recording.

    kind: "unit", "dead", "gap", "uneven"; channel, or "time"; grave: no fit of it could mean anything; text: what was
    found and what to do.
    """

    kind: str
    channel: str
    grave: bool
    text: str


def time_faults(recording: Recording) -> list[Fault]:
    """Gaps, and steps that are not even (time that runs backward is refused by `Recording` itself)."""
    steps, found = np.diff(recording.times), []
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > 5.0 * usual)
    if gaps.size:
        worst = int(np.argmax(steps))
        more = f" ({gaps.size} such gaps)" if gaps.size > 1 else ""
        text = (
            f"{recording.name}: time jumps by {steps[worst]:.3g} s at {recording.times[worst]:.6g} s, {usual:.3g} s is "
            f"usual{more}: are samples missing, or was the clock set? Inputs are joined across it: fit the parts apart"
        )
        found.append(Fault("gap", "time", False, text))
    uneven = float(np.mean(np.abs(steps / usual - 1.0) > 0.2))
    if uneven > 0.05:
        text = (
            f"{recording.name}: {100 * uneven:.0f} % of the time steps are more than 20 % off the usual {usual:.3g} s: "
            "whiteness tests assume even steps: is it the time of arrival instead of the time of sampling?"
        )
        found.append(Fault("uneven", "time", False, text))
    return found


def dead_channels(recording: Recording, simulated: dict[str, np.ndarray]) -> list[Fault]:
    """Channels that stay the same, or stick for a fifth of the recording, while others move.

    simulated: what the circuit shows, for fitted channels; one that should move by it and does not is a grave fault.
    """
    spans = {name: _span(values[recording.mask[name]]) for name, values in recording.channels.items()}
    found = []
    for name, values in recording.channels.items():
        good, others = recording.mask[name], any(span > 0.0 for other, span in spans.items() if other != name)
        if good.sum() < 10 or not others:
            continue
        shown = simulated.get(name)
        moves = shown is not None and np.all(np.isfinite(shown)) and _span(shown) > 1e-3 * np.max(np.abs(shown))
        should = bool(moves)
        if spans[name] == 0.0 and (should or shown is None):
            text = (
                f"{recording.name}: channel {name!r} is {values[good][0]:.6g} throughout while others move: is the "
                "sensor dead or the cable off? Leave the channel out"
            )
            found.append(Fault("dead", name, should, text))
        elif should:
            found += _stuck(recording, name, np.asarray(shown))
    return found


def _stuck(recording: Recording, name: str, shown: np.ndarray) -> list[Fault]:
    """A stretch of equal samples during which the channel should have moved."""
    good = recording.mask[name]
    index, values = np.flatnonzero(good), recording.channels[name][good]
    ends = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0.0) + 1, [values.size]])
    longest = int(np.argmax(np.diff(ends)))
    first, last = index[ends[longest]], index[ends[longest + 1] - 1]
    length = last - first + 1
    if length < max(20, 0.2 * values.size) or np.ptp(shown[first : last + 1]) < 0.2 * np.ptp(shown):
        return []
    text = (
        f"{recording.name}: channel {name!r} is stuck at {values[ends[longest]]:.6g} from {recording.times[first]:.6g} "
        f"to {recording.times[last]:.6g} s, where the circuit moves: mask this stretch"
    )
    return [Fault("dead", name, False, text)]


def _span(values) -> float:
    """Largest less smallest value."""
    return float(np.ptp(values)) if np.size(values) else 0.0


def unit_faults(recording: Recording, simulated: dict[str, np.ndarray], units: dict[str, str]) -> list[Fault]:
    """Channels whose readings and movement are both off from the circuit's by the factor of a unit."""
    found = []
    for name, shown in simulated.items():
        good = recording.mask[name] & np.isfinite(shown)
        if good.sum() < 10:
            continue
        measured, shown = recording.channels[name][good], shown[good]
        spans, sizes = (_span(measured), _span(shown)), (np.max(np.abs(measured)), np.max(np.abs(shown)))
        if min(spans) <= 1e-9 * max(min(sizes), 1e-300) or min(sizes) <= 0.0:
            continue
        by_span, by_size = np.log10(spans[0] / spans[1]), np.log10(sizes[0] / sizes[1])
        if min(abs(by_span), abs(by_size)) < 0.7 or abs(by_span - by_size) > 0.5:
            continue
        factor = 10 ** (0.5 * (by_span + by_size))
        guess = _guess(units.get(name, "1"), factor)
        grave = bool(guess) and not 1.0 / _GRAVE < factor < _GRAVE
        text = (
            f"{recording.name}: channel {name!r} reads {factor:.3g} times what the circuit shows at the start of the "
            f"fit: {guess or 'are the units of channels and inputs right, and the start values near?'}"
        )
        if guess or abs(np.log10(factor)) > 1.5:
            found.append(Fault("unit", name, grave, text))
    return found


def _guess(unit: str, factor: float) -> str:
    """Which unit would explain a factor; empty when none does."""
    read = [(abs(np.log10(factor / f)), f"was it recorded in {word}?") for f, word in _UNITS.get(unit, ())]
    read += [(abs(np.log10(factor / f)), f"it looks as if {words}") for f, words in _SWAPS.get(unit, ())]
    distance, text = min(read, default=(np.inf, ""))
    grave = not 1.0 / _GRAVE < factor < _GRAVE
    return text if distance < (_ALIKE_FAR if grave else _ALIKE) else ""


def find_faults(recording: Recording, simulated: dict[str, np.ndarray], units: dict[str, str]) -> list[Fault]:
    """Everything that looks wrong with a recording.

    Args: simulated: fitted channel -> what the circuit shows at the times of the recording; units: their SI units.
    """
    dead = dead_channels(recording, simulated)
    gone = {fault.channel for fault in dead}
    alive = {name: values for name, values in simulated.items() if name not in gone}
    return [*time_faults(recording), *dead, *unit_faults(recording, alive, units)]
