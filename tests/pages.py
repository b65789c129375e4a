"""Pages that are one HTML file: what they show, and how a browser shows them."""

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
from browser import browse
from PIL import Image

_VOID = {"meta", "img", "br", "hr", "input", "link"}


class Html(HTMLParser):
    """What a page shows.

    Attributes:
        tables: each as rows of texts, the head first.
        media: pictures and videos, as kind and bytes. All are part of the page, or parsing fails.
        preformatted: text of its `pre`.
        text: all of its text but styles.
        tags: every element it has.
    """

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.media: list[tuple[str, bytes]] = []
        self.preformatted = self.text = ""
        self.tags: list[str] = []
        self._open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        for name, value in attrs:
            assert not name.startswith("on"), (tag, name)
            if name == "src":
                found = re.fullmatch(r"data:(\S+);base64,(\S+)", value or "")
                assert found, f"{tag} fetches {value}"
                self.media.append((found[1], base64.b64decode(found[2], validate=True)))
            elif name == "href":
                assert (value or "").startswith("#"), value
        if tag not in _VOID:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag  # all are closed, in order

    def handle_data(self, data: str) -> None:
        if "style" in self._open:
            assert "url(" not in data and "@import" not in data
            return
        self.text += data
        if "td" in self._open or "th" in self._open:
            self.tables[-1][-1][-1] += data
        elif "pre" in self._open:
            self.preformatted += data

    def rows(self, first: str) -> list[dict[str, str]]:
        """The rows of the table whose first column is called so, by columns' names."""
        head, *rows = next(table for table in self.tables if table[0][0] == first)
        return [dict(zip(head, row, strict=True)) for row in rows]


def screenshot(page: Path, picture: Path, width: int = 1100, height: int = 2600) -> np.ndarray:
    """(H, W, 3) what headless Chromium shows of it, and a PNG of that."""
    with browse(page.resolve().as_uri(), picture.with_suffix(".profile"), width, height) as shown:
        shown.wait("document.readyState === 'complete' && [...document.images].every(image => image.complete)")
        shown.picture(picture)
    return np.asarray(Image.open(picture).convert("RGB"))
