"""A number of an expression: a constant, an input, or what an operation makes of other numbers."""

import dataclasses
from typing import Any


@dataclasses.dataclass(eq=False, slots=True)
class Node:
    """A number: a constant (`value`), an input (`name`), or what an operation makes of others (`args`).

    moving: whether it changes while time goes on; whole: for an operation on arrays, shapes of its arguments.
    """

    dtype: Any
    moving: bool
    value: Any = None
    name: Any = None
    primitive: Any = None
    params: dict = dataclasses.field(default_factory=dict)
    args: tuple = ()
    whole: tuple | None = None
    pick: tuple[int, int] | None = None

    def is_constant(self, number=None) -> bool:
        """Whether it is a constant, or this constant."""
        return self.value is not None and (number is None or bool(self.value == number))
