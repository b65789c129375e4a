"""What each command says of itself, on the page of commands."""

import os
import re
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor

from site_files import ROOT

MARK = re.compile(r"^<!-- help: ([\w-]+)((?: \w+)*) -->$", re.MULTILINE)
"""Stands where the help of a command, or of one of its own commands, belongs."""


def entry_points() -> dict[str, str]:
    """Command to "module:function", as in pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


def with_help(markdown: str) -> str:
    """A document with the help of the commands that it marks."""
    marks = list(MARK.finditer(markdown))
    if not marks:
        return markdown
    with ThreadPoolExecutor(2) as pool:
        texts = pool.map(lambda mark: _help(mark[1], mark[2].split()), marks)
        of_mark = dict(zip((mark[0] for mark in marks), texts, strict=True))
    return MARK.sub(lambda mark: f"```text\n{of_mark[mark[0]]}\n```", markdown)


def _help(command: str, more: list[str]) -> str:
    """What `command --help` prints; the command need not be installed."""
    module, function = entry_points()[command].split(":")
    code = f"import sys; from {module} import {function} as main; sys.argv[0] = {command!r}; sys.exit(main())"
    paths = [str(ROOT), *(str(ROOT / part) for part in ("converters", "envs", "policies"))]
    environment = os.environ | {"COLUMNS": "100", "NO_COLOR": "1", "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [sys.executable, "-c", code, *more, "--help"], capture_output=True, text=True, env=environment, check=False
    )
    if done.returncode != 0:
        raise SystemExit(f"{command} --help exits with {done.returncode}: {done.stderr[-2000:]}")
    return done.stdout.rstrip()
