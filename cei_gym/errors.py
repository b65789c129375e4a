"""The exception for bad input: its text is the whole message a user sees."""

from collections.abc import Iterable
from difflib import get_close_matches
from textwrap import shorten


class CEIError(ValueError):
    """Bad input. The message is one line: what is wrong, where, and what would be right."""


class OutOfReachError(CEIError):
    """A robot cannot get where it should. With something else there, it may."""


def unknown(kind: str, name: object, valid: Iterable[str]) -> CEIError:
    """Error for a name that is not among the valid ones, which it lists (closest first)."""
    names = [str(v) for v in valid]
    close = get_close_matches(str(name), names, n=1)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    return CEIError(f"unknown {kind} {name!r}.{hint} Valid: {', '.join(names)}.")


def one_line(error: object, width: int = 200) -> str:
    """The text of a foreign error on one line, cut to `width` characters."""
    return shorten(str(error), width, placeholder=" ...")
