"""Compiled parts of the second-order solver: what runs some ten times a frame."""
