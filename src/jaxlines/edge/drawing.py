"""A diagram of a circuit as SVG: boxes are components, with the symbol of their family, rounded labels are nodes."""

import dataclasses
from html import escape

from jaxlines.edge.layout import Box, Wire, lay_out
from jaxlines.physics.component import AbstractComponent
from jaxlines.physics.controllers import AbstractController
from jaxlines.physics.fields import HYDRAULIC, External, driven_of, ports_of
from jaxlines.physics.sources import Tank
from jaxlines.simulation.circuit import Circuit

_MARGIN, _HEIGHT, _NODE_HEIGHT = 24.0, 46.0, 22.0

_SYMBOLS = {
    "sources": '<circle r="8"/><path class="solid" d="M0 -8 L5 0 L-5 0 Z"/>',
    "tanks": '<path d="M-8 -6 V7 H8 V-6 M-5 0 H5"/>',
    "lines": '<path d="M-9 -3 H9 M-9 3 H9"/>',
    "resistances": '<path d="M-6 -7 Q0 0 -6 7 M6 -7 Q0 0 6 7 M-9 0 H9"/>',
    "valves": '<rect x="-8" y="-8" width="16" height="16"/><path d="M-3 7 V-6 M-6 -2 L-3 -7 L0 -2 M4 -7 V6"/>',
    "machines": '<circle r="8"/><path class="solid" d="M-8 0 L-2 -4 L-2 4 Z M8 0 L2 -4 L2 4 Z"/>',
    "cylinders": '<rect x="-9" y="-5" width="13" height="10"/><path d="M-3 -5 V5 M-3 0 H9"/>',
    "mechanics": '<path d="M-9 0 H-6 L-4 -5 L0 5 L4 -5 L6 0 H9"/>',
    "accumulators": '<rect x="-6" y="-9" width="12" height="18" rx="6"/><path d="M-6 0 H6"/>',
    "sensors": '<circle r="8"/><path d="M0 2 L4 -5"/>',
    "controllers": '<rect x="-8" y="-8" width="16" height="16"/><path d="M-5 5 L0 -4 L5 5"/>',
}
"""Symbols of the families of components, about (0, 0), 18 wide."""

_FAMILIES = {
    "machines": ("motors", "pumps", "machines", "machine_losses"),
    "valves": ("servovalve", "pressure_valves", "valves"),
    "resistances": ("tables",),
    "mechanics": ("stops", "gears"),
}
"""Family -> modules of the physics floor whose components have its symbol; others have that of their module."""

_STYLE = (
    ".circuit text{font-family:var(--font,sans-serif);fill:var(--ink,#1b1f24);text-anchor:middle}"
    ".circuit .name{font-size:12.5px;font-weight:600}.circuit .node{font-size:12px;font-weight:600}"
    ".circuit .kind,.circuit .port{font-size:10px;fill:var(--soft,#667)}.circuit .port{text-anchor:start}"
    ".circuit .part,.circuit .sensor{fill:var(--card,#fff);stroke:var(--ink,#1b1f24);stroke-width:1.3}"
    ".circuit .sensor{stroke:var(--soft,#667);stroke-dasharray:4 3}"
    ".circuit .wire{fill:none;stroke:var(--blue,#2463b4);stroke-width:1.8}"
    ".circuit .rotational,.circuit .translational{stroke:var(--fair,#a2640a)}"
    ".circuit .fixed,.circuit .signal{stroke:var(--soft,#667)}.circuit .signal{stroke-dasharray:4 3;stroke-width:1.3}"
    ".circuit .rail{fill:var(--card,#fff);stroke:var(--blue,#2463b4);stroke-width:1.8}"
    ".circuit .rail.rotational,.circuit .rail.translational{stroke:var(--fair,#a2640a)}"
    ".circuit .rail.fixed{stroke:var(--soft,#667)}"
    ".circuit .symbol{fill:none;stroke:var(--ink,#1b1f24);stroke-width:1.3}.circuit .solid{fill:var(--ink,#1b1f24)}"
)


def _family(part) -> str:
    """The family of a component, by the module its class is in and by what its ports are."""
    if not isinstance(part, AbstractComponent):
        return "sensors"
    module, domains = type(part).__module__.rsplit(".", 1)[-1], list(ports_of(part).values())
    family = next((family for family, modules in _FAMILIES.items() if module in modules), module)
    moving = [domain for domain in domains if domain != HYDRAULIC]
    if moving and len(moving) >= len(domains) - 1:
        return "mechanics"
    return "tanks" if isinstance(part, Tank) else "valves" if family == "machines" and not moving else family


def _drives(part) -> list[str]:
    """The names of the inputs and controllers that drive a component."""
    values = [getattr(part, field) for field in driven_of(part)] if isinstance(part, AbstractComponent) else []
    return list(dict.fromkeys(value.name for value in values if isinstance(value, External)))


def _read_by(part) -> list[str]:
    """The quantities or sensors that a sensor or controller reads."""
    if not isinstance(part, AbstractComponent):
        return [part.quantity_read()]
    return [getattr(part, f.name) for f in dataclasses.fields(part) if f.metadata.get("reads")]


def _owner(circuit: Circuit, name: str) -> str | None:
    """The node or component that a quantity belongs to."""
    first = name.split(".")[0]
    return first if first in circuit.components or first in circuit.nodes() else None


def _wires(circuit: Circuit, boxes: dict[str, Box]) -> list[Wire]:
    """Wires from components to the nodes of their ports, and dashed ones to what reads and drives."""
    fixed, wires = circuit.fixed_nodes(), []
    for name, part in circuit.components.items():
        ports = ports_of(part) if isinstance(part, AbstractComponent) else {}
        for port, domain in ports.items():
            node = getattr(part, port)
            css = f"wire {domain}{' fixed' if node in fixed else ''}"
            label = "" if len(ports) == 1 else port
            mixed = domain != HYDRAULIC and HYDRAULIC in ports.values()
            wires.append(Wire(boxes[name], boxes[node], label, css, down=mixed))
        for read in _read_by(part):
            owner = _owner(circuit, read)
            if owner is not None and owner != name:
                upper, lower = boxes[owner], boxes[name]
                if isinstance(part, AbstractController):  # it stands above what it reads and drives
                    upper, lower = lower, upper
                wires.append(Wire(upper, lower, "", "wire signal", down=True))
        wires += [Wire(boxes[d], boxes[name], "", "wire signal", down=True) for d in _drives(part) if d in boxes]
    return wires


def _weigh(circuit: Circuit, boxes: dict[str, Box]) -> None:
    """Order from top to bottom: steps from the nearest source, tanks last, what only reads below what it reads."""
    near: dict[str, set[str]] = {name: set() for name in boxes}
    for name, part in circuit.parts().items():
        for port in ports_of(part):
            near[name].add(getattr(part, port))
            near[getattr(part, port)].add(name)
    family = {name: _family(part) for name, part in circuit.components.items()}
    queue = [name for name, kind in family.items() if kind == "sources"] or list(circuit.parts())[:1]
    steps = dict.fromkeys(queue, 0)
    for _ in range(2):
        for name in queue:
            for other in near[name]:
                if other not in steps:
                    steps[other] = steps[name] + 1
                    queue.append(other)
        queue += [name for name in near if name not in steps]
        steps |= {name: 0 for name in queue if name not in steps}
    bottom = max(steps.values(), default=0) + 1.0
    for name, box in boxes.items():
        box.weight = float(steps[name])
        owner = circuit.fixed_nodes().get(name, ("",))[0]
        if family.get(name) == "tanks" or family.get(owner) == "tanks":
            box.weight = bottom + (name in family)


def _curve(wire: Wire) -> str:
    """A wire as a smooth path with vertical ends, and its label at the component's end."""
    (x, y), *rest = wire.points
    path, last = f"M{x:.1f} {y:.1f}", rest[-1]
    pass_by = _HEIGHT / 2 if last[1] > y else -_HEIGHT / 2
    for to_x, to_y in rest:
        # Straight down beside the boxes of a layer that it crosses.
        first, then = (to_y, to_y) if (to_x, to_y) == last else (to_y - pass_by, to_y + pass_by)
        middle = 0.5 * (y + first)
        path += f" C{x:.1f} {middle:.1f} {to_x:.1f} {middle:.1f} {to_x:.1f} {first:.1f}"
        path += f" V{then:.1f}" if then != first else ""
        x, y = to_x, then
    drawn = f'<path class="{wire.css}" d="{path}"/>'
    if not wire.label:
        return drawn
    (x, y), (_, towards) = wire.points[0], wire.points[1]
    at = y + (11.0 if towards > y else -4.0)
    return drawn + f'<text class="port" x="{x + 4.0:.1f}" y="{at:.1f}">{escape(wire.label)}</text>'


def _part(box: Box, part) -> str:
    """A component: a box with symbol, name, type, and the inputs that drive it."""
    css = "part" if isinstance(part, AbstractComponent) else "sensor"
    left, top = box.x - box.width / 2, box.y - box.height / 2
    symbol, kind, drives = _SYMBOLS.get(_family(part), ""), type(part).__name__, _drives(part)
    middle = box.x + (12.0 if symbol else 0.0)
    kind += f" \N{LEFTWARDS ARROW} {', '.join(drives)}" if drives else ""
    size = f'x="{left:.1f}" y="{top:.1f}" width="{box.width:.1f}" height="{box.height:.1f}"'
    return (
        f'<rect class="{css}" {size} rx="5"/>'
        f'<g class="symbol" transform="translate({left + 17:.1f} {box.y:.1f})">{symbol}</g>'
        f'<text class="name" x="{middle:.1f}" y="{box.y - 3:.1f}">{escape(box.name)}</text>'
        f'<text class="kind" x="{middle:.1f}" y="{box.y + 12:.1f}">{escape(kind)}</text>'
    )


def _node(box: Box, domain: str, fixed: bool) -> str:
    """A node: a rounded label."""
    size = f'x="{box.x - box.width / 2:.1f}" y="{box.y - box.height / 2:.1f}" width="{box.width:.1f}"'
    css = f"rail {domain}{' fixed' if fixed else ''}"
    return (
        f'<rect class="{css}" {size} height="{box.height:g}" rx="{box.height / 2:g}"/>'
        f'<text class="node" x="{box.x:.1f}" y="{box.y + 4:.1f}">{escape(box.name)}</text>'
    )


def _boxes(circuit: Circuit) -> dict[str, Box]:
    """A box for every node and component, as wide as what stands in it."""
    boxes = {node: Box(node, max(30.0, 18.0 + 7.5 * len(node)), _NODE_HEIGHT) for node in circuit.nodes()}
    for name, part in circuit.components.items():
        below = len(type(part).__name__) + sum(len(drive) + 3 for drive in _drives(part))
        ports = len(ports_of(part)) if isinstance(part, AbstractComponent) else 0
        boxes[name] = Box(name, max(96.0, 34.0 * ports, 44.0 + max(7.5 * len(name), 5.6 * below)), _HEIGHT)
    return boxes


def circuit_svg(circuit: Circuit, *, standalone: bool = False) -> str:
    """The diagram of a circuit.

    Args: circuit; standalone: as a file of its own. Colours come from the page (CSS variables --ink, --soft, --card,
    --blue, --fair; classes part, sensor, rail, wire, ...), or are those of a light page.
    """
    boxes, fixed = _boxes(circuit), circuit.fixed_nodes()
    _weigh(circuit, boxes)
    wires = _wires(circuit, boxes)
    width, height = lay_out(boxes.values(), wires)
    pieces = [_curve(wire) for wire in wires]
    pieces += [_node(boxes[node], domain, node in fixed) for node, domain in circuit.nodes().items()]
    pieces += [_part(boxes[name], part) for name, part in circuit.components.items()]
    described = "; ".join(_described(name, part) for name, part in circuit.components.items())
    span = f"{-_MARGIN:g} {-_MARGIN:g} {width + 2 * _MARGIN:.0f} {height + 2 * _MARGIN:.0f}"
    page = f'viewBox="{span}" style="max-width:{width + 2 * _MARGIN:.0f}px;min-width:{0.6 * width:.0f}px"'
    space = 'xmlns="http://www.w3.org/2000/svg" ' if standalone else ""
    title = f"<title>Circuit: {escape(described)}</title><style>{_STYLE}</style>"
    return f'<svg {space}class="circuit" role="img" {page}>{title}{"".join(pieces)}</svg>'


def _described(name: str, part) -> str:
    """One component in words, for those who do not see the picture."""
    at = [getattr(part, port) for port in ports_of(part)] if isinstance(part, AbstractComponent) else _read_by(part)
    return f"{name} ({type(part).__name__}) at {', '.join(at)}" if at else f"{name} ({type(part).__name__})"
