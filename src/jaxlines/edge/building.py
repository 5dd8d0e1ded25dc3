"""From tables of a study file to fluid, components, containers and signals.

What a table may contain is read from the fields of the class it describes and their metadata, so that a new
component needs nothing here.
"""

import dataclasses
import difflib
import functools
import importlib
import inspect
import pkgutil
import re
import typing

import numpy as np

from jaxlines import physics
from jaxlines.edge.units import si
from jaxlines.physics.component import AbstractComponent
from jaxlines.physics.fields import AbstractSignal, External, family_of
from jaxlines.physics.fluids import Oil
from jaxlines.physics.sensors import AbstractSensor
from jaxlines.simulation import signals
from jaxlines.simulation.circuit import Circuit


class StudyError(ValueError):
    """A study that cannot be used; the text says where and why, in one line."""


@functools.cache
def _public_classes() -> tuple[type, ...]:
    """The concrete classes of the physics floor, and the signals."""
    names = [f"{physics.__name__}.{module.name}" for module in pkgutil.iter_modules(physics.__path__)]
    modules = [*(importlib.import_module(name) for name in names), signals]
    found = [(module, thing) for module in modules for thing in vars(module).values() if isinstance(thing, type)]
    own = [thing for module, thing in found if thing.__module__ == module.__name__ and thing is not External]
    return tuple(thing for thing in own if not thing.__name__.startswith(("_", "Abstract")))


def _kinds(*bases: type) -> dict[str, type]:
    """The classes of these kinds, by name."""
    return {kind.__name__: kind for kind in _public_classes() if issubclass(kind, bases)}


def suggest(word: str, known) -> str:
    """ "did you mean ...?", or what is known."""
    known = list(known)
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.6)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known) or 'none'}"


def _snake(name: str) -> str:
    """ "FlowSource" as "flow_source"."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


@dataclasses.dataclass(frozen=True)
class Builder:
    """Makes objects of tables; gauge pressures count from `atmospheric_pressure` [Pa]."""

    atmospheric_pressure: float

    def number(self, value, metadata: dict, where: str) -> float:
        """A number in the unit of its field. Raises StudyError with the place."""
        level, atmosphere = bool(metadata.get("level")), self.atmospheric_pressure
        try:
            return si(value, metadata["unit"], level=level, atmospheric_pressure=atmosphere)
        except (ValueError, TypeError) as error:
            raise StudyError(f"{where}: {error}") from error

    def shown(self, value, metadata: dict, where: str, gauge: bool) -> float:
        """A number as an output shows it: what a gauge sensor shows counts from the atmosphere."""
        return self.number(value, metadata, where) - (self.atmospheric_pressure if gauge else 0.0)

    def numbers(self, value, metadata: dict, where: str):
        """A number, or an array of them from a list or a list of lists."""
        if not isinstance(value, list):
            return self.number(value, metadata, where)
        rows = [self.numbers(item, metadata, f"{where}.{i}") for i, item in enumerate(value)]
        if len({np.shape(row) for row in rows}) > 1:
            raise StudyError(f"{where}: the rows of a table must be of one length")
        return np.asarray(rows)

    def driven(self, value, metadata: dict, where: str):
        """A number, the name of an input from {input = "..."}, or a signal from {step = {...}}."""
        if not isinstance(value, dict):
            return self.number(value, metadata, where)
        kinds = {_snake(name): kind for name, kind in _kinds(AbstractSignal).items()}
        if len(value) != 1 or next(iter(value)) not in ["input", *kinds]:
            found = next(iter(value), "nothing")
            raise StudyError(
                f'{where}: expected a number, {{ input = "name" }} or a signal such as {{ step = {{ ... }} }}, '
                f"got {found!r}: {suggest(str(found), ['input', *kinds])}"
            )
        kind, content = next(iter(value.items()))
        if kind != "input":
            return self.module(kinds[kind], content, f"{where}.{kind}", metadata)
        if not isinstance(content, str) or not content:
            raise StudyError(f"{where}.input: expected the name of an input, got {content!r}")
        return content

    def module(self, kind: type, table, where: str, driven: dict | None = None):
        """An object of a class from its table; `driven` is the metadata of what a signal drives."""
        if not isinstance(table, dict):
            raise StudyError(f"{where}: expected a table for a {kind.__name__}, got {table!r}")
        accepted = inspect.signature(kind).parameters
        fields = {field.name: field for field in dataclasses.fields(kind) if field.name in accepted}
        for key in table:
            if key not in fields and key != "type":
                raise StudyError(f"{where}: unknown key {key!r}, {suggest(key, fields)}")
        for name, field in fields.items():
            no_default = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
            if name not in table and no_default:
                raise StudyError(f"{where}: {name!r} is missing ({kind.__name__})")
        hints = typing.get_type_hints(kind)
        given = {
            name: self._field(field, hints.get(name), table[name], f"{where}.{name}", driven)
            for name, field in fields.items()
            if name in table
        }
        try:
            return kind(**given)
        except (ValueError, TypeError) as error:
            raise StudyError(f"{where}: {error}") from error

    def _field(self, field, hint, value, where: str, driven: dict | None):
        """One field of a table by what the class says of it."""
        metadata = dict(field.metadata)
        if driven is not None:
            metadata = _signal_metadata(field.name, metadata, driven)
        if metadata.get("driven") and driven is None:
            return self.driven(value, metadata, where)
        if "unit" in metadata:
            return self.numbers(value, metadata, where)
        family = family_of(hint)
        if family is not None and typing.get_origin(hint) is tuple:
            tables = value if isinstance(value, list) else [value]
            return tuple(self.choose(t, (family,), f"{where}.{i}") for i, t in enumerate(tables))
        if family is not None:
            return self.choose({"type": value} if isinstance(value, str) else value, (family,), where)
        wanted = [kind for kind in (hint, *typing.get_args(hint)) if kind in (int, float, bool, str)] or [str]
        if type(value) not in wanted:
            kinds = " or ".join(kind.__name__ for kind in wanted)
            what = "the name of a node" if "port" in metadata else f"a value of type {kinds}"
            raise StudyError(f"{where}: expected {what}, got {value!r}")
        return value

    def choose(self, table, bases: tuple[type, ...], where: str, default: str | None = None):
        """An object of the class that the key `type` names."""
        kinds = _kinds(*bases)
        if not isinstance(table, dict):
            raise StudyError(f"{where}: expected a table, got {table!r}")
        name = table.get("type", default)
        if name is None:
            raise StudyError(f"{where}: 'type' is missing; known: {', '.join(kinds)}")
        if name not in kinds:
            raise StudyError(f"{where}: unknown type {name!r}, {suggest(str(name), kinds)}")
        return self.module(kinds[name], table, where)


def _signal_metadata(name: str, metadata: dict, driven: dict) -> dict:
    """What a number of a signal is: a time, or a value of what the signal drives (amplitudes are differences)."""
    if name == "times":
        return {"unit": "s"}
    if name == "values" or metadata.get("unit") == "1":
        return {**driven, "level": driven.get("level") and name != "amplitude"}
    return metadata


def _atmosphere(fluid: dict) -> float:
    """The atmospheric pressure of a fluid's table [Pa]; it cannot be gauge itself."""
    text = fluid.get("atmospheric_pressure", f"{float(Oil.atmospheric_pressure)} Pa_a")
    if isinstance(text, str) and text.strip().endswith("_g"):
        raise StudyError(f"fluid.atmospheric_pressure: {text!r} must be absolute, such as 1.013 bar_a")
    return Builder(0.0).number(text, {"unit": "Pa", "level": True}, "fluid.atmospheric_pressure")


def build_circuit(fluid: dict, components: dict) -> tuple[Circuit, Builder]:
    """The circuit of a study, and the builder that knows its atmosphere. Raises StudyError with the place."""
    builder = Builder(_atmosphere(fluid))
    oil = builder.choose(fluid, (Oil,), "fluid", "Oil")
    parts = {
        name: builder.choose(table, (AbstractComponent, AbstractSensor), f"circuit.{name}")
        for name, table in components.items()
    }
    try:
        return Circuit(oil, parts), builder
    except (ValueError, TypeError) as error:
        raise StudyError(f"circuit: {error}") from error
