"""What each command says of itself, on the page of commands."""

import json
import os
import re
import subprocess
import sys
import tomllib

from site_files import ROOT

MARK = re.compile(r"^<!-- help: ([\w-]+)((?: \w+)*) -->$", re.MULTILINE)
"""Stands where the help of a command, or of one of its own commands, belongs."""
WIDTH = 100

_ASK = """
import contextlib, importlib, io, json, sys
said = []
for module, function, *words in json.load(sys.stdin):
    sys.argv, out = words, io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        getattr(importlib.import_module(module), function)()
    said.append(out.getvalue().rstrip())
json.dump(said, sys.stdout)
"""  # all in one process: imports take longer than the rest


def with_help(markdown: str) -> str:
    """A document with the help of the commands that it marks.

    Raises:
        RuntimeError: a command that is marked has none.
    """
    marks = [(found[0], [found[1], *found[2].split(), "--help"]) for found in MARK.finditer(markdown)]
    if not marks:
        return markdown
    projects = [tomllib.loads((ROOT / part / "pyproject.toml").read_text())["project"] for part in (".", "robots")]
    scripts = projects[0]["scripts"] | projects[1]["scripts"]
    said = _ask([[*scripts[words[0]].split(":"), *words] for _, words in marks])
    for (_, words), text in zip(marks, said, strict=True):
        if not text.startswith(f"usage: {words[0]}"):
            raise RuntimeError(f"{' '.join(words)} says: {text[:200]!r}")
    of_mark = dict(zip((mark for mark, _ in marks), said, strict=True))
    return MARK.sub(lambda found: f"```text\n{of_mark[found[0]]}\n```", markdown)


def _ask(calls: list[list[str]]) -> list[str]:
    """What commands print: each a module, a function of it, and the words of its command line; none need be installed."""
    paths = [str(ROOT), *(str(ROOT / part) for part in ("converters", "envs", "policies", "robots"))]
    environment = os.environ | {"COLUMNS": str(WIDTH), "NO_COLOR": "1", "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [sys.executable, "-c", _ASK],
        input=json.dumps(calls),
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    if done.returncode != 0:
        raise RuntimeError(f"the commands do not say what they do: {done.stderr[-2000:]}")
    return json.loads(done.stdout)
