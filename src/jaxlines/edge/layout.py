"""Where the boxes and wires of a diagram go: layers from sources down to tanks and shafts, by Sugiyama's method.

The layout itself is grandalf's; what is said here is which way each wire points, and how wires leave their boxes.
"""

import dataclasses
import math
from collections.abc import Iterable
from typing import Any


@dataclasses.dataclass
class Box:
    """What is drawn: its size, and where the layout put its middle; `weight` orders it from top to bottom."""

    name: str
    width: float
    height: float
    weight: float = 0.0
    x: float = 0.0
    y: float = 0.0


@dataclasses.dataclass
class Wire:
    """A connection from one box to another, labelled at either end.

    points: where it runs, ends included; set by `lay_out`. `down` says that it is meant to point downwards.
    """

    start: Box
    end: Box
    label: str
    css: str
    down: bool = False
    points: list[tuple[float, float]] = dataclasses.field(default_factory=list)


_GAP, _LAYER = 34.0, 58.0
_ROUNDS = 12


class _View:
    """What the layout wants to know of a box."""

    def __init__(self, box: Box):
        self.w, self.h, self.xy = box.width, box.height, (0.0, 0.0)


class _Path:
    """What the layout tells of a wire: where its layers are crossed."""

    points: list

    def setpath(self, points):
        self.points = list(points)


def lay_out(boxes: Iterable[Box], wires: list[Wire]) -> tuple[float, float]:
    """Place boxes and wires; returns width and height of the drawing.

    Reference: Sugiyama, Tagawa and Toda, "Methods for visual understanding of hierarchical system structures", IEEE
    Trans. Systems, Man, and Cybernetics 11, 1981.
    """
    from grandalf.graphs import Edge, Graph, Vertex

    vertices: dict[int, Any] = {id(box): Vertex(box) for box in boxes}
    for vertex in vertices.values():
        vertex.view = _View(vertex.data)
    edges = []
    for wire in wires:
        ends = (wire.start, wire.end)
        upper, lower = ends if wire.down or wire.start.weight <= wire.end.weight else ends[::-1]
        edge: Any = Edge(vertices[id(upper)], vertices[id(lower)], data=(wire, upper is wire.start))
        edge.view = _Path()
        edges.append(edge)
    left = height = 0.0
    for part in Graph(list(vertices.values()), edges).C:
        width, tall = _place(part, left)
        left, height = left + width + _GAP, max(height, tall)
    _attach(wires)
    return left - _GAP, height


def _place(part, left: float) -> tuple[float, float]:
    """Lay out one connected part of the graph with its left edge there; returns its width and height."""
    from grandalf.layouts import SugiyamaLayout

    layout: Any = SugiyamaLayout(part)
    layout.xspace, layout.yspace, layout.route_edge = _GAP, _LAYER, lambda edge, points: None
    layout.init_all(roots=[v for v in part.sV if not v.e_in()] or [next(iter(part.sV))])
    layout.draw(_ROUNDS)
    placed: list[Box] = []
    for vertex in part.sV:
        vertex.data.x, vertex.data.y = vertex.view.xy
        placed.append(vertex.data)
    crossings = [x for edge in part.sE for x, _ in edge.view.points[1:-1]]
    shift = left - min(*crossings, *(box.x - box.width / 2 for box in placed), math.inf)
    top = min(box.y - box.height / 2 for box in placed)
    for box in placed:
        box.x, box.y = box.x + shift, box.y - top
    for edge in part.sE:
        wire, forward = edge.data
        inner = [(x + shift, y - top) for x, y in edge.view.points[1:-1]]
        wire.points = [(wire.start.x, wire.start.y), *(inner if forward else inner[::-1]), (wire.end.x, wire.end.y)]
    right = max(*(x + shift for x in crossings), *(box.x + box.width / 2 for box in placed), left)
    return right - left, max(box.y + box.height / 2 for box in placed)


def _attach(wires: list[Wire]) -> None:
    """Let the wires end side by side on the upper and lower edges of their boxes, in the order of where they go."""
    sides: dict[tuple[int, bool], list[tuple[float, Wire, int]]] = {}
    for wire in wires:
        for box, at, towards in ((wire.start, 0, 1), (wire.end, -1, -2)):
            x, y = wire.points[towards]
            sides.setdefault((id(box), y > box.y), []).append((x, wire, at))
    for (_, below), ends in sides.items():
        ends.sort(key=lambda end: end[0])
        for i, (_, wire, at) in enumerate(ends):
            box = wire.start if at == 0 else wire.end
            x = box.x - box.width / 2 + box.width * (i + 1) / (len(ends) + 1)
            wire.points[at] = (x, box.y + (box.height / 2 if below else -box.height / 2))
