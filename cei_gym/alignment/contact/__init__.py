"""What holds and how: the source's grip, the refinement that carries it over, and its force."""
