"""A command's result as JSON."""

import json
from collections.abc import Iterable
from typing import Any

from cei_converters.cli.outputs import Output
from cei_converters.dataset.metadata import plain


def write_json(output: Output | None, result: dict[str, Any], **long: Iterable[Any]) -> None:
    """Write a result in one go (a reader never sees half of it); nothing if no file is asked for.

    Args:
        output: the file.
        result: JSON types, arrays and dataclasses; not empty.
        long: lists that come after it, by name, of which memory holds one item.
    """
    if output is None:
        return
    with output.whole() as partial, partial.open("w") as file:
        file.write(json.dumps(plain(result), indent=1, allow_nan=False).removesuffix("\n}"))
        for name, items in long.items():
            file.write(f",\n {json.dumps(name)}: [")
            for i, item in enumerate(items):
                file.write(("," if i else "") + "\n  " + json.dumps(plain(item), allow_nan=False))
            file.write("\n ]")
        file.write("\n}\n")
