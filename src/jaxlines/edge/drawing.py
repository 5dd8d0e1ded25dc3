"""A drawing of a circuit as SVG: nodes are vertical rails, components are rows that touch the rails of their ports."""

from html import escape

from jaxlines.physics.component import AbstractComponent
from jaxlines.physics.fields import ports_of
from jaxlines.simulation.circuit import Circuit

_GAP, _MARGIN, _ROW, _TOP = 190, 40, 52, 46
_BOX_WIDTH, _BOX_HEIGHT = 140, 34


def _node_of_sensor(circuit: Circuit, sensor) -> str:
    """The node that a sensor reads at, or that the component it reads is attached to."""
    owner, *rest = sensor.quantity_read().split(".")
    part = circuit.parts().get(owner)
    return getattr(part, rest[0], owner) if part is not None else owner


def _attachments(circuit: Circuit) -> dict[str, list[tuple[str, str]]]:
    """Component or sensor -> its (port label, node) pairs; labels only where there is more than one port."""
    found = {}
    for name, part in circuit.components.items():
        if isinstance(part, AbstractComponent):
            ports = [(port, getattr(part, port)) for port in ports_of(part)]
            found[name] = [("" if len(ports) == 1 else port, node) for port, node in ports]
        else:
            found[name] = [("", _node_of_sensor(circuit, part))]
    return found


def _box(x: float, y: float, name: str, kind: str, css: str) -> str:
    """A labelled box whose left edge is at x and whose middle is at y."""
    left, top, middle = x, y - _BOX_HEIGHT / 2, x + _BOX_WIDTH / 2
    return (
        f'<rect class="{css}" x="{left:g}" y="{top:g}" width="{_BOX_WIDTH}" height="{_BOX_HEIGHT}" rx="6"/>'
        f'<text class="name" x="{middle:g}" y="{y - 3:g}">{escape(name)}</text>'
        f'<text class="kind" x="{middle:g}" y="{y + 11:g}">{escape(kind)}</text>'
    )


def _row(y: float, name: str, kind: str, attached, rails: dict[str, float], sensor: bool) -> str:
    """One component: a line between the rails of its ports, dots with port names, and its box."""
    xs = sorted({rails[node] for _, node in attached if node in rails})
    if not xs:
        return ""
    box_at, css = xs[0] + (_GAP - _BOX_WIDTH) / 2, "sensor" if sensor else "part"
    end = max(xs[-1], box_at)
    pieces = [f'<line class="{css}-wire" x1="{xs[0]:g}" y1="{y:g}" x2="{end:g}" y2="{y:g}"/>']
    for x in xs:
        labels = ", ".join(port for port, node in attached if rails.get(node) == x and port)
        pieces.append(f'<circle class="{css}-dot" cx="{x:g}" cy="{y:g}" r="4"/>')
        side, shift = ("first", -7) if x == xs[0] else ("other", 7)  # the box stands right of the first rail
        text = f'<text class="port {side}" x="{x + shift:g}" y="{y - 6:g}">{escape(labels)}</text>'
        pieces.append(text if labels else "")
    return "".join(pieces) + _box(box_at, y, name, kind, css)


def circuit_svg(circuit: Circuit) -> str:
    """The drawing of a circuit; colours come from the page (classes rail, part, sensor, ...)."""
    domains, fixed, attachments = circuit.nodes(), circuit.fixed_nodes(), _attachments(circuit)
    rails = {node: _MARGIN + i * _GAP + 10.0 for i, node in enumerate(domains)}
    height, width = _TOP + _ROW * len(attachments) + 10, _MARGIN * 2 + _GAP * len(rails)
    pieces = []
    for node, x in rails.items():
        css = f"rail {domains[node]}{' fixed' if node in fixed else ''}"
        pieces.append(f'<line class="{css}" x1="{x:g}" y1="{_TOP - 16}" x2="{x:g}" y2="{height - 8}"/>')
        pieces.append(f'<text class="node" x="{x:g}" y="{_TOP - 24}">{escape(node)}</text>')
    sensors = circuit.sensors()
    for i, (name, attached) in enumerate(attachments.items()):
        kind = type(circuit.components[name]).__name__
        pieces.append(_row(_TOP + _ROW * (i + 0.5), name, kind, attached, rails, name in sensors))
    described = "; ".join(
        f"{name} ({type(circuit.components[name]).__name__}) at {', '.join(node for _, node in attached)}"
        for name, attached in attachments.items()
    )
    size = f'viewBox="0 0 {width} {height}" style="max-width:{width}px;min-width:{0.6 * width:.0f}px"'
    title = f"<title>Circuit: {escape(described)}</title>"
    return f'<svg class="circuit" role="img" {size}>{title}{"".join(pieces)}</svg>'
