"""How well a trajectory does: its report, its quality, what it is in, and what it cannot reach."""
