"""One self-contained page about a conversion, and about replays of it: `cei-report`."""

from cei_converters.report.command import main

__all__ = ["main"]
