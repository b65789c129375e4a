"""`cei-robot`: a robot of one's own, from its description to a YAML that works."""
