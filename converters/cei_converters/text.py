"""Foreign error messages as part of a one-line message."""

from textwrap import shorten


def one_line(error: object, width: int = 200) -> str:
    """The text of an error on one line, cut to `width` characters."""
    return shorten(str(error), width, placeholder=" ...")
