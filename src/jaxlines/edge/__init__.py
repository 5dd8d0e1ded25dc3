"""Where files, units, pictures and people are."""
