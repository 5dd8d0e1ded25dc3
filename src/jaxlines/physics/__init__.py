"""Formulas and components: SI units, absolute pressure, nothing of time or files."""
