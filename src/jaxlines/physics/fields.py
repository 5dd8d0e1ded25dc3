"""How a component declares its numbers, ports and inputs, and how wrong numbers are refused.

Every physical number is an array leaf made by `quantity`, every node name a static field made by
`port`, every time-varying number a field made by `driven`. The metadata written here (unit, range,
likely slip) is what study files, error messages and reports read, so that it is stated once.
"""

import dataclasses
import functools
import typing
from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

if TYPE_CHECKING:  # a type checker does not see that a converter makes arrays of plain numbers
    Number = Any
else:
    Number = Float[Array | np.ndarray, "..."]
"""A physical number: a scalar leaf, or an array of them where components of a kind are evaluated together."""

HYDRAULIC, ROTATIONAL, TRANSLATIONAL = "hydraulic", "rotational", "translational"

ATMOSPHERE = 101325.0
"""Reference pressure of densities and air fractions [Pa absolute] (ISO 2533 standard atmosphere)."""


GRAVITY = 9.80665
"""Standard acceleration of gravity [m/s^2] (3rd CGPM, 1901)."""


class AbstractSignal(eqx.Module):
    """A number as a function of time, `signal(t)`, with the times of its jumps as data."""

    @abstractmethod
    def __call__(self, t):
        """Value at time t [s]."""

    def jump_times(self):
        """Times [s] at which the value jumps, shape (jumps,)."""
        return np.zeros(0)

    def knot_times(self):
        """Times [s] at which the value is continuous but its slope jumps, shape (knots,)."""
        return np.zeros(0)


class External(AbstractSignal):
    """A placeholder for an input that is given by name when the circuit is simulated."""

    name: str = eqx.field(static=True)

    def __call__(self, t):
        raise TypeError(f"input {self.name!r} has no value of its own: pass inputs={{{self.name!r}: ...}}")


def as_number(value: Any) -> Any:
    """A float64 NumPy array, or the JAX array or tracer itself. Text is refused."""
    if isinstance(value, jax.Array | np.ndarray) or value is None:
        return value
    if isinstance(value, str):
        raise TypeError(
            f"expected a number in SI units, got the text {value!r}: quantities with units belong into a "
            'study file, or convert with jaxlines.si("12.8 mm", "m")'
        )
    return np.asarray(value, dtype=np.float64)


def _as_driven(value: Any):
    """A number, a signal, or the name of an external input."""
    if isinstance(value, str):
        return External(value)
    return value if isinstance(value, AbstractSignal) else as_number(value)


def quantity(
    unit: str,
    *,
    low: float = -np.inf,
    high: float = np.inf,
    slip: str = "",
    level: bool = False,
    default: Any = dataclasses.MISSING,
):
    """A physical number in SI `unit`, legal in [low, high]; `slip` is the likely cause of a wrong one.

    `level` marks a pressure that is counted from zero or from atmosphere (not a difference or a stiffness),
    so that a text from outside must say absolute or gauge.
    """
    metadata = {"unit": unit, "low": low, "high": high, "slip": slip, "level": level}
    options = {} if default is dataclasses.MISSING else {"default": default}
    return eqx.field(converter=as_number, metadata=metadata, **options)


def driven(
    unit: str,
    *,
    low: float = -np.inf,
    high: float = np.inf,
    slip: str = "",
    level: bool = False,
    default: Any = dataclasses.MISSING,
):
    """A number in SI `unit` that may also be a signal of time or the name of an external input."""
    metadata = {"unit": unit, "low": low, "high": high, "slip": slip, "level": level, "driven": True}
    options = {} if default is dataclasses.MISSING else {"default": default}
    return eqx.field(converter=_as_driven, metadata=metadata, **options)


def port(domain: str = HYDRAULIC, *, optional: bool = False):
    """The name of the node that this port is attached to; an optional port may be None, attached to nothing."""
    options = {"default": None} if optional else {}
    return eqx.field(static=True, metadata={"port": domain, "optional": optional}, **options)


def ports_of(module) -> dict[str, str]:
    """Name of each attached port -> domain, in the order of declaration."""
    ports = {f.name: f.metadata for f in dataclasses.fields(module) if "port" in f.metadata}
    return {n: m["port"] for n, m in ports.items() if not (m["optional"] and getattr(module, n) is None)}


def driven_of(module) -> dict[str, dict]:
    """Driven field name -> its metadata, in the order of declaration."""
    return {f.name: dict(f.metadata) for f in dataclasses.fields(module) if f.metadata.get("driven")}


def array_module(*trees) -> Any:
    """NumPy when every leaf is a plain number, so that formulas on the host stay in float64; else jax.numpy."""
    return jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(trees)) else np


def is_concrete(value) -> bool:
    """Whether a value can be looked at now (it is not being traced by JAX)."""
    return not isinstance(value, Tracer)


def check_range(name: str, value, metadata: dict) -> None:
    """Raise ValueError when a concrete number lies outside its legal range or is not finite."""
    if value is None or isinstance(value, AbstractSignal) or not is_concrete(value):
        return
    low, high, unit = metadata["low"], metadata["high"], metadata["unit"]
    numbers = np.asarray(value)
    wrong = numbers[~((numbers >= low) & (numbers <= high))]
    if wrong.size:
        slip = f": {metadata['slip']}" if metadata["slip"] else ""
        # A slash keeps the unit of a plain number readable: "[1]" would look like a footnote.
        suffix = "" if unit == "1" else f" {unit}"
        raise ValueError(f"{name} must be {low:g}..{high:g}{suffix}, got {wrong.flat[0]:g}{suffix}{slip}")


def family_of(hint) -> type | None:
    """The family of physical objects (`AbstractContainer`, `AbstractFriction`) that an annotation asks for, if any."""
    if isinstance(hint, type) and not typing.get_args(hint):
        return hint if issubclass(hint, eqx.Module) and hint.__name__.startswith("Abstract") else None
    return next((found for inner in typing.get_args(hint) if (found := family_of(inner)) is not None), None)


@functools.cache
def _laws(kind: type) -> dict[str, tuple[type, bool]]:
    """Name of each field that holds one object of a family -> the family, and whether it may be None."""
    hints = {name: hint for name, hint in typing.get_type_hints(kind).items() if typing.get_origin(hint) is not tuple}
    families = {name: (family_of(hint), type(None) in typing.get_args(hint)) for name, hint in hints.items()}
    return {name: (family, optional) for name, (family, optional) in families.items() if family is not None}


def _check_law(label: str, value, family: type, optional: bool) -> None:
    """Raise TypeError when a field holds something else than an object of its family."""
    if not isinstance(value, family) and not (optional and value is None):
        known = [kind.__name__ for kind in family.__subclasses__() if not kind.__name__.startswith("Abstract")]
        raise TypeError(
            f"{label} must be an object such as {' or '.join(f'{name}(...)' for name in known)}, got {value!r}"
        )


def check_fields(module, where: str = "") -> None:
    """Check every number of a module against its declared range, every port for a name, every law for its family."""
    for name, (family, optional) in _laws(type(module)).items():
        _check_law(f"{where}{name}", getattr(module, name), family, optional)
    for field in dataclasses.fields(module):
        value, label = getattr(module, field.name), f"{where}{field.name}"
        if "unit" in field.metadata:
            check_range(label, value, dict(field.metadata))
        detached = field.metadata.get("optional") and value is None
        if "port" in field.metadata and not isinstance(value, str) and not detached:
            raise TypeError(f"{type(module).__name__}.{label} must be the name of a node, got {value!r}")
