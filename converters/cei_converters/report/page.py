"""The page itself: a template that escapes whatever it is given, and pictures and films as part of it."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined, Template

PNG, WEBP, MP4 = "image/png", "image/webp", "video/mp4"
_TEMPLATE = Path(__file__).with_name("page.html")


@dataclass(frozen=True)
class Medium:
    """A picture or a film on a page.

    Attributes:
        kind: its MIME type.
        content: of its file.
        caption: what it shows.
    """

    kind: str
    content: bytes
    caption: str

    @property
    def url(self) -> str:
        """It, as an address that nothing is fetched for."""
        return f"data:{self.kind};base64,{base64.b64encode(self.content).decode()}"


def render(contents: Mapping[str, Any]) -> str:
    """The page as HTML.

    Args:
        contents: what the template names; all text is escaped.
    """
    return _template().render(contents) + "\n"


@cache
def _template() -> Template:
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(_TEMPLATE.read_text())
