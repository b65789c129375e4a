"""Entries that a docstring shares between names, `lower, upper: (n,) limits`, become an entry each, with the type of each."""

import re
from typing import Any

from griffe import Extension, Object

_SHARED = re.compile(r"^( +)(\*{0,2}\w+(?:, \*{0,2}\w+)+): (.*(?:\n\1 +\S.*)*)", re.MULTILINE)
_SECTION = re.compile(r"^(Args|Attributes):\n((?:[ \t]+.*\n?|\n(?=[ \t]))+)", re.MULTILINE)


def separate(docstring: str) -> str:
    """A docstring whose entries are of one name each."""

    def each(found: re.Match[str]) -> str:
        return "\n".join(f"{found[1]}{name}: {found[3]}" for name in found[2].split(", "))

    return _SECTION.sub(lambda section: _SHARED.sub(each, section[0]), docstring)


class SharedEntries(Extension):
    """Separates them wherever griffe finds some."""

    def on_object(self, *, obj: Object, **kwargs: Any) -> None:
        """See `griffe.Extension`."""
        if obj.docstring is not None:
            obj.docstring.value = separate(obj.docstring.value)
