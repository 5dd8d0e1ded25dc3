"""Controllers in a circuit: in which order they can be evaluated, and what they read."""

from collections.abc import Mapping

from jaxlines.physics.controllers import AbstractController, AbstractSampledController
from jaxlines.physics.fields import External, driven_of


def controller_levels(components: Mapping) -> dict[str, int]:
    """Name of each controller -> level, lowest first: it needs the output of those on lower levels at the same instant.

    A sampled controller holds its output, which needs nothing: it is on level 0.
    Raises: ValueError that names the controllers of an algebraic loop.
    """
    controllers = {name: part for name, part in components.items() if isinstance(part, AbstractController)}
    levels: dict[str, int] = {}

    def settle(name: str, trail: tuple[str, ...]) -> int:
        if name in trail:
            loop = " -> ".join((*trail[trail.index(name) :], name))
            raise ValueError(
                f"controllers form an algebraic loop, {loop}: each needs the output of the next at the same instant; "
                "make one of them a SampledController, or let it read a state"
            )
        if name not in levels:
            below = [settle(other, (*trail, name)) for other in _listens_to(controllers[name]) if other in controllers]
            levels[name] = 1 + max(below, default=-1)
        return levels[name]

    for name in controllers:
        settle(name, ())
    return dict(sorted(levels.items(), key=lambda item: item[1]))


def _listens_to(controller: AbstractController) -> list[str]:
    """What drives the output of a controller at the same instant."""
    if isinstance(controller, AbstractSampledController):
        return []
    given = [getattr(controller, field) for field in driven_of(controller)]
    return [value.name for value in given if isinstance(value, External)]
