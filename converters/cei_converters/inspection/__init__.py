"""What is in a dataset of any robot: `cei-inspect`."""

from cei_converters.inspection.command import main

__all__ = ["main"]
