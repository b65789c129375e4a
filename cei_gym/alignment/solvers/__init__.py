"""Ways of following a trajectory: ours, and how packages offer theirs."""
