"""Where trajectories start: candidates for frame 0, and which of them whole demonstrations choose."""
