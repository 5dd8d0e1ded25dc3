"""Checks of free and known parameters against a circuit: they exist, once, with bounds in range."""

import dataclasses

import numpy as np

from jaxlines.inference.parameters import Free, Known
from jaxlines.physics.fields import driven_of
from jaxlines.simulation.circuit import Circuit, field_metadata
from jaxlines.simulation.paths import resolve


def check_parameters(circuit: Circuit, free, known, locations) -> tuple[tuple[Free, ...], tuple[Known, ...]]:
    """Free and known parameters with full paths; raises for unknown, repeated or out-of-range ones."""
    full_free, full_known, seen = [], [], set()
    for parameter in free:
        paths = tuple(resolve(path, locations) for path in parameter.paths)
        full_free.append(dataclasses.replace(parameter, path=paths, name=parameter.label))
    for number in known:
        full_known.append(dataclasses.replace(number, path=resolve(number.path, locations)))
    for path in [p for f in full_free for p in f.paths] + [k.path for k in full_known]:
        if path in seen:
            raise ValueError(f"{path} is given twice among the free and known parameters")
        seen.add(path)
    for parameter in full_free:
        for path, ratio in zip(parameter.paths, parameter.path_ratios, strict=True):
            metadata, ends = number_metadata(circuit, path), sorted(ratio * bound for bound in parameter.bounds)
            if metadata and not (metadata["low"] <= ends[0] and ends[1] <= metadata["high"]):
                low, high, slip = metadata["low"], metadata["high"], metadata.get("slip")
                raise ValueError(
                    f"{path}: bounds must lie in {low:g}..{high:g} {metadata['unit']}, got "
                    f"{ends[0]:g}..{ends[1]:g}{': ' + slip if slip else ''}"
                )
    if not full_free:
        raise ValueError("a fit needs at least one free parameter, such as Free('fluid.bulk_modulus', (0.6e9, 2.5e9))")
    return tuple(full_free), tuple(full_known)


def number_metadata(circuit: Circuit, path: str) -> dict:
    """Unit and range of a number or an initial value; empty where none is declared."""
    owner = path.partition(".")[0]
    if owner == "fluid" or owner in circuit.components:
        return field_metadata(circuit, path)
    if owner == "initial" and path.endswith(".pressure"):
        return {"unit": "Pa", "low": 0.0, "high": 1e9, "slip": "pressures are absolute and in Pa"}
    driven = circuit.external_inputs().get(owner)
    if driven and path.endswith(".delay"):
        return {"unit": "s", "low": -1e6, "high": 1e6, "slip": "was it given in ms?"}
    if driven and path.endswith(".offset"):
        component, field = driven[0]
        return {"unit": driven_of(circuit.components[component])[field]["unit"], "low": -np.inf, "high": np.inf}
    return {}
