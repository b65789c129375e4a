"""Environments that episodes are recorded and replayed in."""
