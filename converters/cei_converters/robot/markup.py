"""Text of descriptions on a page: escaped, and never Markdown, which viser takes for a program."""

from html import escape


def text(*lines: str | tuple[str, str], colour: str = "#444") -> str:
    """Lines, or pairs of a line and the colour of the square before it, as HTML that means nothing but themselves."""
    body = ""
    for line in lines:
        said, square = line if isinstance(line, tuple) else (line, None)
        mark = "" if square is None else f'<span style="color:{escape(square)}">&#9632;</span> '
        body += f"<div>{mark}{escape(said)}</div>" if said else ""
    style = f"font-size:0.8em;color:{colour};padding:0 0.8em 0.5em;overflow-wrap:anywhere"
    return f'<div style="{style}">{body}</div>' if body else ""
