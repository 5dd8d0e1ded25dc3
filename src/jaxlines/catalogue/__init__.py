"""Real systems, ready to use: the hydraulic drives of the DSN 70-metre antennas."""
