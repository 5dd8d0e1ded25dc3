"""What every part of a circuit has in common: the interface between physics and simulation.

A component attaches to nodes by its ports. For the potentials at its ports (pressure, speed) and its own
states it gives the *flow into* each node, the *capacity* it adds to each node, and the rates of its states.
Every node then obeys one law: rate of potential = sum of flows / sum of capacities. For a hydraulic node
with mass flows [kg/s] and capacities dm/dp [kg/Pa] this is eq. (8) of the article, and adding capacities is
its eq. (5); for a shaft, flows are torques [N m] and capacities moments of inertia [kg m^2].

To add a component: one class with its fields and `evaluate`, written as if for one component. Components
of a kind are evaluated together, as arrays, so use arithmetic that works element by element.
"""

from abc import abstractmethod
from typing import ClassVar, NamedTuple

import equinox as eqx

from jaxlines.physics.fields import HYDRAULIC, ROTATIONAL, TRANSLATIONAL, check_fields
from jaxlines.physics.fluids import Oil


class State(NamedTuple):
    """A state of a component: its name, unit, and a typical size, by which the solver scales it.

    A state with a `shape` is an array whose own axes stand in front: (segments,) for one component,
    (segments, count, [lanes]) for a kind, so that numbers of the component still apply element by element.
    """

    name: str
    unit: str
    scale: float
    shape: tuple[int, ...] = ()


class Domain(NamedTuple):
    """What a node's potential, its flow and its capacity are, and the typical size of its potential."""

    potential: str
    unit: str
    scale: float
    flow: str
    flow_unit: str


DOMAINS = {
    HYDRAULIC: Domain("pressure", "Pa", 1e6, "flow", "m^3/s"),
    ROTATIONAL: Domain("speed", "rad/s", 1.0, "torque", "N*m"),
    TRANSLATIONAL: Domain("velocity", "m/s", 1.0, "force", "N"),
}


class Situation(NamedTuple):
    """What a component sees at one instant, each by name of its own port, state or driven field."""

    fluid: Oil
    potential: dict
    state: dict
    given: dict


class Contribution(NamedTuple):
    """What a component does to its nodes and states; a port or state left out is zero."""

    flow: dict = {}
    capacity: dict = {}
    rate: dict = {}


class AbstractComponent(eqx.Module):
    """A part of a circuit. Numbers are checked against the ranges that its fields declare."""

    states: ClassVar[tuple[State, ...]] = ()  # of a component whose states depend on nothing; see `states_in`

    def __check_init__(self):
        check_fields(self)

    @abstractmethod
    def evaluate(self, at: Situation) -> Contribution:
        """Flows into the nodes, capacities and state rates in a situation, element by element.

        Hydraulic flows are mass flows [kg/s], positive into the node.
        """

    def states_in(self, fluid: Oil) -> tuple[State, ...]:
        """The states this component has when filled with a fluid."""
        return self.states

    def start(self, at: Situation) -> dict:
        """State name -> where it starts unless told otherwise (zero for those left out); `at.state` is empty."""
        return {}

    def sets(self) -> dict:
        """Port name -> name of the driven field whose value is the node's potential (sources only)."""
        return {}
