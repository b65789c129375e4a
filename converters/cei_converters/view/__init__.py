"""One episode to look at, beside its source or alone: `cei-view`."""

from cei_converters.view.command import main

__all__ = ["main"]
