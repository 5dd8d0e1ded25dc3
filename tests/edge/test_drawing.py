"""Diagrams: everything is drawn and connected, nothing overlaps, sources above what they feed."""

import itertools
import re
import time
from xml.etree import ElementTree

import numpy as np
import pytest

import jaxlines as jl
from jaxlines.catalogue.dsn70m_axis import antenna_axis
from jaxlines.catalogue.dsn70m_drive import axis_drive
from jaxlines.edge.drawing import circuit_svg
from jaxlines.physics.fields import ports_of

OIL = jl.Oil(1.4e9, 850.0)


def instrumented() -> jl.Circuit:
    """The drive of an axis with two sensors and a leak between its control lines."""
    drive = axis_drive("azimuth")
    more = {
        "gauge <A>": jl.PressureSensor("A"),
        "meter": jl.FlowSensor("motor.a"),
        "leak": jl.LaminarLeak("A", "B", 1e-12),
    }
    return jl.Circuit(drive.fluid, {**drive.components, **more})


class Drawn:
    """A picture taken apart: boxes by name, wires as sampled points."""

    def __init__(self, circuit: jl.Circuit):
        self.root = ElementTree.fromstring(circuit_svg(circuit))
        elements = list(self.root)
        self.texts = [e.text for e in self.root.iter("text")]
        self.boxes = {}
        for i, element in enumerate(elements):
            if element.tag == "rect":
                name = next(e.text for e in elements[i + 1 :] if e.tag == "text")
                x, y, width, height = (float(element.attrib[a]) for a in ("x", "y", "width", "height"))
                self.boxes[name] = (x, y, x + width, y + height)
        paths = [e for e in elements if e.tag == "path"]
        self.wires = [points_of(path.attrib["d"]) for path in paths]
        self.classes = [path.attrib["class"] for path in paths]

    def touched(self, wire) -> set[str]:
        """Boxes on whose upper or lower edge a wire ends."""
        found = set()
        for x, y in (wire[0], wire[-1]):
            for name, (left, top, right, bottom) in self.boxes.items():
                if left < x < right and min(abs(y - top), abs(y - bottom)) < 0.11:
                    found.add(name)
        return found


def points_of(path: str) -> np.ndarray:
    """Points along a path of cubic curves and vertical lines, close together."""
    t, pieces, at = np.linspace(0.0, 1.0, 41)[:, None], [], np.zeros(2)
    for letter, numbers in re.findall(r"([MCV])([^MCV]*)", path):
        values = np.asarray(numbers.split(), dtype=float)
        if letter == "V":
            values = np.array([at[0], values[0]])
            pieces.append(at + t * (values - at))
        if letter == "C":
            a, b, c, d = at, *values.reshape(3, 2)
            pieces.append((1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * b + 3 * (1 - t) * t**2 * c + t**3 * d)
        at = values[-2:]
    return np.concatenate(pieces)


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    return Drawn(instrumented())


@pytest.fixture(scope="module")
def whole() -> Drawn:
    """A whole axis: four motors with gears, and a rate loop."""
    return Drawn(antenna_axis("azimuth"))


def test_everything_has_a_name_a_type_and_labelled_ports(drawn):
    circuit = instrumented()
    for name, part in circuit.components.items():
        assert name in drawn.texts
        assert any((text or "").startswith(type(part).__name__) for text in drawn.texts)
    assert set(circuit.nodes()) < set(drawn.texts)
    assert {"supply", "tank", "a", "b", "case", "shaft", "line"} < set(drawn.texts)
    assert "Servovalve \N{LEFTWARDS ARROW} spool" in drawn.texts
    assert "motor (Motor) at A, B, P_D, shaft" in (drawn.root.findtext("title") or "")


def test_every_port_is_wired_to_its_node(drawn):
    circuit = instrumented()
    expected = [{name, getattr(part, port)} for name, part in circuit.parts().items() for port in ports_of(part)]
    expected += [{"gauge <A>", "A"}, {"meter", "motor"}]
    found = [drawn.touched(wire) for wire in drawn.wires]
    assert sorted(map(sorted, found)) == sorted(map(sorted, expected))


@pytest.mark.parametrize("picture", ["drawn", "whole"])
def test_boxes_do_not_overlap_and_wires_pass_beside_them(picture, request):
    drawn = request.getfixturevalue(picture)
    for (a, one), (b, two) in itertools.combinations(drawn.boxes.items(), 2):
        apart = one[2] < two[0] or two[2] < one[0] or one[3] < two[1] or two[3] < one[1]
        assert apart, (a, b)
    for wire in drawn.wires:
        for name, (left, top, right, bottom) in drawn.boxes.items():
            x, y = wire.T
            inside = (x > left + 0.2) & (x < right - 0.2) & (y > top + 0.2) & (y < bottom - 0.2)
            assert not np.any(inside), (name, drawn.touched(wire))
    left, top, width, height = map(float, drawn.root.attrib["viewBox"].split())
    for x, y in (wire.T for wire in drawn.wires):
        assert left < x.min() and top < y.min() and x.max() < left + width and y.max() < top + height
    for box in drawn.boxes.values():
        assert left < box[0] and top < box[1] and box[2] < left + width and box[3] < top + height


def test_fluid_runs_down_from_the_supply(drawn):
    heights = {name: box[1] for name, box in drawn.boxes.items()}
    order = ["supply", "P_S", "servovalve", "A", "motor", "P_D", "drain"]
    assert [heights[name] for name in order] == sorted(heights[name] for name in order)
    assert heights["motor"] < heights["shaft"] < heights["inertia"]


def test_a_controller_stands_above_what_it_reads_and_drives(whole):
    circuit = antenna_axis("azimuth")
    ends = [whole.touched(w) for w, css in zip(whole.wires, whole.classes, strict=True) if css == "wire signal"]
    assert sorted(map(sorted, ends)) == [["rate_loop", "servovalve"], ["rate_loop", "shaft_1"]]
    assert set(circuit.components) | set(circuit.nodes()) == set(whole.boxes)
    assert whole.boxes["rate_loop"][1] < whole.boxes["servovalve"][1] < whole.boxes["motor_1"][1]


def test_colours_by_domain_and_for_given_potentials(drawn):
    by_ends = {frozenset(drawn.touched(w)): css for w, css in zip(drawn.wires, drawn.classes, strict=True)}
    assert by_ends[frozenset({"motor", "shaft"})] == "wire rotational"
    assert by_ends[frozenset({"motor", "A"})] == "wire hydraulic"
    assert by_ends[frozenset({"servovalve", "P_S"})] == "wire hydraulic fixed"
    assert by_ends[frozenset({"gauge <A>", "A"})] == "wire signal"


def test_separate_circuits_stand_side_by_side_and_a_file_stands_alone():
    parts: dict = {f"{k}{i}": jl.Line(f"N{i}", jl.Vessel(1e-3)) for i in range(3) for k in ("first", "second")}
    circuit = jl.Circuit(OIL, parts)
    boxes = Drawn(circuit).boxes
    spans = [[boxes[name] for name in (f"first{i}", f"second{i}", f"N{i}")] for i in range(3)]
    lefts, rights = [min(b[0] for b in s) for s in spans], [max(b[2] for b in s) for s in spans]
    for i, j in itertools.combinations(range(3), 2):
        assert rights[i] < lefts[j] or rights[j] < lefts[i]
    alone = ElementTree.fromstring(circuit_svg(circuit, standalone=True))
    assert alone.tag == "{http://www.w3.org/2000/svg}svg"


def test_a_loop_and_a_network_of_two_hundred_lines_are_drawn():
    ring: dict = {f"orifice{i}": jl.Orifice(f"N{i}", f"N{(i + 1) % 5}", 1e-6) for i in range(5)}
    ring |= {f"volume{i}": jl.Line(f"N{i}", jl.Vessel(1e-3)) for i in range(5)}
    assert len(Drawn(jl.Circuit(OIL, ring)).wires) == 15
    pipe = jl.Pipe(1.0, 0.01, 0.014)

    def net(count: int) -> str:
        lines: dict = {f"pipe{i}": jl.Line(f"N{i // 2}", pipe, to=f"N{i + 1}", segments=2) for i in range(count)}
        return circuit_svg(jl.Circuit(OIL, {**lines, "supply": jl.PressureSource("N0", 1e7)}))

    begun = time.perf_counter()
    assert net(200).count("<rect") == 402
    assert time.perf_counter() - begun < 20.0
    assert net(30) == net(30)
