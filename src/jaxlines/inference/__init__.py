"""From recordings to parameters with uncertainty; knows hydraulics only through the simulation."""
