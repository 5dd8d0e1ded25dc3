"""Audit of a simulation: whether mass, momentum and energy balance, node by node and for the whole circuit."""

import dataclasses
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import numpy as np

from jaxlines.physics.component import DOMAINS
from jaxlines.physics.controllers import AbstractSampledController
from jaxlines.physics.fields import HYDRAULIC
from jaxlines.simulation.assembly import compile_circuit
from jaxlines.simulation.circuit import Circuit
from jaxlines.simulation.ledger import inner_nodes, integrate_nodes, panel_edges, panel_times, see, slopes_at_nodes
from jaxlines.simulation.plan import Plan, Values, scales, unravel
from jaxlines.simulation.precision import computing_in
from jaxlines.simulation.result import Simulation
from jaxlines.simulation.sampling import clock_of
from jaxlines.simulation.simulate import simulate
from jaxlines.simulation.steady import state_labels

_UNITS = {HYDRAULIC: "kg", "rotational": "N*m*s", "translational": "N*s"}


class Balance(NamedTuple):
    """One balance: what was stored should equal what came in.

    unit: kg (mass), N*m*s and N*s (momentum), J (energy); turnover: sum of the sizes of all flows; audit_error: how
    far the audit itself may be off.
    """

    name: str
    unit: str
    stored: float
    received: float
    turnover: float
    audit_error: float

    @property
    def error(self) -> float:
        """What was stored beyond what came in."""
        return self.stored - self.received

    @property
    def relative_error(self) -> float:
        """Error per turnover [-]."""
        return abs(self.error) / self.turnover if self.turnover > 0.0 else 0.0

    def sentence(self) -> str:
        """The balance in words."""
        return (
            f"{self.name}: stored {self.stored:.6g} {self.unit}, received {self.received:.6g} {self.unit}, error "
            f"{self.error:.2g} {self.unit} ({self.relative_error:.1e} of what passed; the audit itself "
            f"+-{self.audit_error:.1g} {self.unit})"
        )


@dataclasses.dataclass(frozen=True)
class Audit:
    """The balances of a simulation.

    Fields: nodes: of each free node; contents: of each component whose fluid is known from its state, its mass against
    what its ports took in; mass and energy: of the whole circuit; supplied: name -> mass [kg] that sources, tanks and
    other components gave to the nodes; delivered: name -> energy [J], the same (negative: taken up, dissipated); true:
    mass balance of each hydraulic node as the fluid's real density would have it, only with mass="article", whose
    constant density conserves volume instead; deviation: largest difference of a saved output from the run that was
    audited, in units of the output's largest size (small when it had the same solver and tolerance).
    """

    nodes: tuple[Balance, ...]
    contents: tuple[Balance, ...]
    mass: Balance
    energy: Balance
    supplied: dict[str, float]
    delivered: dict[str, float]
    true: tuple[Balance, ...]
    deviation: float

    def worst(self) -> Balance:
        """The balance with the largest relative error."""
        return max([*self.nodes, *self.contents, self.mass, self.energy], key=lambda b: b.relative_error)

    def sentences(self) -> list[str]:
        """One sentence a balance, with numbers and units."""
        said = [balance.sentence() for balance in [*self.nodes, *self.contents, self.mass, self.energy]]
        for balance in self.true:
            said.append(
                f'mass is not conserved with mass="article" (constant density): {balance.name} has '
                f"{balance.error:.3g} kg more than came in, {100.0 * balance.relative_error:.2g} % of what passed"
            )
        return said

    def __str__(self) -> str:
        given = []
        for amounts, unit in ((self.supplied, "kg"), (self.delivered, "J")):
            least = 1e-9 * max(map(abs, amounts.values()), default=0.0)
            given += [f"  {name} gave {amount:.6g} {unit}" for name, amount in amounts.items() if abs(amount) > least]
        return "\n".join([*self.sentences(), *given])


def audit(
    simulation: Simulation,
    *,
    initial: dict | None = None,
    solver: diffrax.AbstractSolver | None = None,
    tolerance: float = 1e-7,
    max_steps: int = 100_000,
    max_step: float | None = None,
) -> Audit:
    """Run a simulation again and compare what each node stored with what flowed into it.

    Stored is the integral of capacity times the change of the potential along the trajectory, received the integral of
    the net flow, both over the solver's dense output: their difference is the error that the solver made. Energy: that
    of flows (mass flow times the integral of dp/rho from atmosphere, torque times speed, force times velocity).

    Args: simulation: a finished one; initial: start values, needed where the simulation did not
        save them all, and for sampled controllers that were given some (also by a steady state); solver,
        tolerance, max_steps, max_step: as given to `simulate`.
    Raises: ValueError when a start value is neither saved nor given; RuntimeError when the run fails.
    Validity: the whole circuit's mass counts fluid inside components whose content is known (lines, accumulators,
        cylinders); others are taken to hold none but their capacity. With mass="article" mass means volume times the
        constant density, and `true` says what the real density makes of it.
    """
    with computing_in("float64"):
        start = _start(simulation, initial or {})
        plan, values = compile_circuit(simulation.circuit, start, simulation.inputs)
        clock = clock_of(plan, values, simulation.times[0])
        periods = () if clock is None else np.unique(np.asarray(clock.periods))
        steps = int(simulation.num_steps)
        edges = panel_edges(simulation.circuit, simulation.times, simulation.inputs, periods, steps)
        again = simulate(
            simulation.circuit,
            panel_times(edges),
            simulation.inputs,
            initial=start,
            outputs=state_labels(plan),
            solver=solver,
            tolerance=tolerance,
            max_steps=max_steps,
            max_step=max_step,
        )
        return _audited(simulation, again, plan, values, edges)


def _audited(simulation: Simulation, again: Simulation, plan: Plan, values: Values, edges) -> Audit:
    """The balances of a run that saved everything at the times of panels."""
    y = np.stack([again.outputs[label] for label in state_labels(plan)], axis=-1) / scales(plan)
    found = _balances(plan, simulation, edges, y, _seen(plan, values, again.times, y))
    true, fluid = (), values.fluid
    if fluid.mass == "article" and not fluid.air.liquid_frozen:
        real = eqx.tree_at(lambda v: v.fluid, values, dataclasses.replace(fluid, mass="conserved"))
        true = tuple(b for b in _node_balances(plan, edges, y, _seen(plan, real, again.times, y)) if b.unit == "kg")
    return Audit(*found, true, _deviation(simulation, again))


def _seen(plan: Plan, values, times, y):
    """What happens at all times, as NumPy."""

    @jax.jit
    def at_all(values, times, y):
        return jax.vmap(lambda t, y: see(plan, values, t, *unravel(plan, y)))(times, y)

    return jax.tree.map(np.asarray, at_all(values, times, y))


def _start(simulation: Simulation, given: dict) -> dict:
    """Start values: those given, else those saved; states that were not saved start as their component says."""
    nodes, outputs = simulation.circuit.nodes(), simulation.outputs
    start = {}
    for node in set(nodes) - set(simulation.circuit.fixed_nodes()):
        name = f"{node}.{DOMAINS[nodes[node]].potential}"
        if name not in given and name not in outputs:
            raise ValueError(f"the audit needs the start value of {name}, which was not saved: give initial={{...}}")
        if name not in given:
            start[name] = float(outputs[name][0])
    for name, part in simulation.circuit.parts().items():
        if isinstance(part, AbstractSampledController):
            continue  # it samples at the start: what was saved there has been sampled already
        for state in part.states_in(simulation.circuit.fluid):
            labels = [".".join([name, state.name, *map(str, own)]) for own in np.ndindex(state.shape)]
            if all(label in outputs for label in labels):
                start[f"{name}.{state.name}"] = np.reshape([outputs[label][0] for label in labels], state.shape)
    return start | given


def _node_balances(plan: Plan, edges, y, seen) -> list[Balance]:
    """Stored against received at each free node."""
    count = len(plan.free_nodes)
    slopes = slopes_at_nodes(edges, y[:, :count] * scales(plan)[:count])
    stored = integrate_nodes(edges, inner_nodes(seen.capacity) * slopes)
    received, gross = (
        integrate_nodes(edges, inner_nodes(seen.flow)),
        integrate_nodes(edges, inner_nodes(seen.gross)).value,
    )
    return [
        Balance(
            f"{'mass' if domain == HYDRAULIC else 'momentum'} at {node}",
            _UNITS[domain],
            float(stored.value[i]),
            float(received.value[i]),
            float(gross[i]),
            float(stored.error[i] + received.error[i]),
        )
        for i, (node, domain) in enumerate(plan.free_nodes)
    ]


def _balances(plan: Plan, simulation: Simulation, edges, y, seen):
    """Nodes, contents, whole mass, whole energy, and who supplied what."""
    nodes, count = _node_balances(plan, edges, y, seen), len(plan.free_nodes)
    slopes = slopes_at_nodes(edges, y[:, :count] * scales(plan)[:count])
    supplied, delivered = _supplied(plan, simulation.circuit, edges, seen)
    contents = _contents(plan, edges, slopes, seen)
    for content in contents:
        del supplied[content.name.removeprefix("mass in ")]
    hydraulic = [node for node in nodes if node.unit == "kg"]
    # What components keep beyond the capacities that they give to nodes is in their own balances only.
    error = sum(b.error for b in (*hydraulic, *contents))
    received = sum(supplied.values())
    turnover, uncertain = (sum(getattr(b, of) for b in hydraulic) for of in ("turnover", "audit_error"))
    mass = Balance("mass of the whole circuit", "kg", received + error, received, turnover, uncertain)
    work = integrate_nodes(edges, inner_nodes(seen.energy * seen.flow))
    kept = integrate_nodes(edges, inner_nodes(seen.energy * seen.capacity) * slopes)
    turned = integrate_nodes(edges, inner_nodes(np.abs(seen.energy) * seen.gross)).value
    sums = [float(np.sum(numbers)) for numbers in (kept.value, work.value, turned, work.error + kept.error)]
    return tuple(nodes), contents, mass, Balance("energy of the whole circuit", "J", *sums), supplied, delivered


def _supplied(plan: Plan, circuit: Circuit, edges, seen) -> tuple[dict[str, float], dict[str, float]]:
    """Mass and energy that each component gave to the nodes; sources of potential give what flows out of theirs."""
    supplied, delivered, owners = {}, {}, circuit.fixed_nodes()
    for kind, given, power in zip(plan.kinds, seen.given, seen.power, strict=False):
        mass, energy = (integrate_nodes(edges, inner_nodes(room)).value for room in (given, power))
        supplied |= dict(zip(kind.members, map(float, mass), strict=True))
        delivered |= dict(zip(kind.members, map(float, energy), strict=True))
    for i, node in enumerate(plan.fixed_nodes):
        flow, power = (integrate_nodes(edges, inner_nodes(room[:, i])).value for room in (seen.outflow, seen.lost))
        supplied[owners[node.name][0]] -= float(flow) if node.domain == HYDRAULIC else 0.0
        delivered[owners[node.name][0]] -= float(power)
    return supplied, delivered


def _contents(plan: Plan, edges, slopes, seen) -> tuple[Balance, ...]:
    """For each component whose fluid is known: the change of its mass against what its ports took in."""
    found = []
    for k, content in seen.content.items():
        taken = -inner_nodes(seen.given[k])
        passed = np.abs(taken)
        for port in plan.kinds[k].ports:
            if (k, port.name) in seen.filling:
                filled = inner_nodes(seen.filling[k, port.name]) * slopes[..., np.asarray(port.index)]
                taken, passed = taken + filled, passed + np.abs(filled)
        received, turnover = integrate_nodes(edges, taken), integrate_nodes(edges, passed).value
        for i, member in enumerate(plan.kinds[k].members):
            change = float(content[-1, i] - content[0, i])
            numbers = (change, received.value[i], turnover[i], received.error[i])
            found.append(Balance(f"mass in {member}", "kg", *map(float, numbers)))
    return tuple(found)


def _deviation(simulation: Simulation, again: Simulation) -> float:
    """Largest difference of shared outputs at the saved times, in units of each output's largest size."""
    where = np.searchsorted(again.times, simulation.times)
    where = np.minimum(where, again.times.size - 1)
    same = np.abs(again.times[where] - simulation.times) < 1e-12 * (1.0 + np.abs(simulation.times))
    largest = 0.0
    for name in set(simulation.outputs) & set(again.outputs):
        ours, theirs = again.outputs[name][where][same], np.asarray(simulation.outputs[name])[same]
        largest = max(largest, float(np.max(np.abs(ours - theirs)) / max(np.max(np.abs(theirs)), 1e-300)))
    return largest
