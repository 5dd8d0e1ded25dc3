"""From a circuit to trajectories: signals, assembly, simulation."""
