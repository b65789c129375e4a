"""Descriptions by the names that other projects gave them: `robot_descriptions:panda_description`, `mujoco_menagerie:franka_emika_panda`.

Both packages download what is not in their cache. A name is compared with their listing first; a download is there as a whole, or not at all.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterable
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any

from cei_gym.errors import CEIError, one_line
from cei_gym.extras import installed, lacking

CACHE = "ROBOT_DESCRIPTIONS_CACHE"
"""Environment variable of `robot_descriptions`: the folder of its downloads."""

NO_ANSWER_S = 30.0
"""How long a server may say nothing before a download is given up; of one that has begun, ten times as long."""

_EMPTY_REPOSITORY_BYTES = 10_000
_STAGING = ".cei-"

# In a process of its own: importing a description clones a repository, prints, and may wait for a server for minutes.
_IMPORT = """
import importlib, json, sys
try:
    module = importlib.import_module(f"robot_descriptions.{sys.argv[1]}")
    known = {k: v for k, v in vars(module).items() if k.isupper() and isinstance(v, (str, dict))}
    answer = {"known": known}
except Exception as error:
    answer = {"error": str(error) or type(error).__name__}
print("\\n" + json.dumps(answer, default=str))
"""


@dataclass(frozen=True)
class Named:
    """A description that a package offers.

    Attributes:
        path: its file.
        root: the model's folder, or the repository that it is in.
        packages: folders of ROS packages that it needs.
        xacro_args: arguments with which its xacro is this robot.
    """

    path: Path
    root: Path
    packages: tuple[Path, ...] = ()
    xacro_args: dict[str, str] = field(default_factory=dict[str, str])


def find_named(uri: str) -> Named | None:
    """The description that goes by a name, downloaded if need be; None for what is no such name.

    Raises:
        CEIError: the package is not installed, has no such name, or cannot download it.
    """
    package, colon, name = uri.partition(":")
    if not colon or package not in _FINDERS:
        return None
    if not installed(package):
        raise lacking(f"description {uri[:80]!r}", package)
    return _FINDERS[package](name, tuple(os.environ.get(variable) for variable in _VARIABLES))


# What is found depends on these, so they are part of what is remembered.
_VARIABLES = (CACHE, "ROBOT_DESCRIPTION_COMMIT", "MENAGERIE_CACHE_DIR", "MENAGERIE_BASE_URL", "MENAGERIE_ROOT", "HOME")


@lru_cache(maxsize=64)
def _of_menagerie(name: str, _variables: tuple[str | None, ...]) -> Named:
    """`NAME` is the robot without a scene, `NAME/MODEL` another of its models."""
    import mujoco_menagerie as menagerie

    robot_name, slash, model = name.partition("/")
    if robot_name not in menagerie.names():
        raise _no_such("robot", "mujoco_menagerie", robot_name, menagerie.names())
    robot = menagerie.get(robot_name)
    if slash and model not in robot.entry_names:
        raise _no_such(f"model of {robot_name}", "mujoco_menagerie", model, robot.entry_names)
    cache = menagerie.Cache()
    file = robot.entry(model or robot.default_model).file
    try:
        if cache.root is None and not cache.is_cached(robot):
            _check_reachable(f"{cache.base_url}/{robot.asset}")
        root = robot.path(cache)
    except (menagerie.MenagerieError, OSError) as error:
        raise _not_downloaded("mujoco_menagerie", name, str(error)) from None
    return Named(root / file, root)


def _check_reachable(url: str) -> None:
    """Ask for a file's head, so that a silent server costs seconds; the package would wait for minutes.

    Raises:
        OSError: there is no answer.
    """
    from urllib.request import Request, urlopen

    try:
        urlopen(Request(url, method="HEAD", headers={"User-Agent": "cei-gym"}), timeout=NO_ANSWER_S).close()
    except OSError as error:
        raise OSError(f"{url}: {getattr(error, 'reason', error)}") from None


@lru_cache(maxsize=64)
def _of_robot_descriptions(name: str, _variables: tuple[str | None, ...]) -> Named:
    from robot_descriptions import DESCRIPTIONS

    if name not in DESCRIPTIONS:
        raise _no_such("description", "robot_descriptions", name, DESCRIPTIONS)
    known = _imported(name)
    for kind in ("MJCF_PATH", "URDF_PATH", "XACRO_PATH"):
        if kind in known:
            packages = tuple(Path(folder).resolve() for folder in known.get("XACRO_PACKAGE_PATHS", {}).values())
            arguments = {str(k): str(v) for k, v in known.get("XACRO_ARGS", {}).items()} if kind == "XACRO_PATH" else {}
            return Named(Path(known[kind]), Path(known["REPOSITORY_PATH"]), packages, arguments)
    raise CEIError(f"robot_descriptions:{name} has neither an MJCF, a URDF nor a xacro.")


def _imported(name: str) -> dict[str, Any]:
    """The constants of a description's module. New repositories are cloned beside the cache, and moved into it when they are whole.

    Raises:
        CEIError: a repository cannot be cloned.
    """
    cache = Path(os.environ.get(CACHE, "~/.cache/robot_descriptions")).expanduser().absolute()
    with _staging(cache) as staging:
        answer = _answer(name, staging)
        if (error := answer.get("error")) is not None:
            raise _not_downloaded("robot_descriptions", name, error)
        for entry in staging.iterdir():
            if not entry.is_symlink():
                with suppress(OSError):
                    entry.rename(cache / entry.name)
                if not (cache / entry.name).is_dir():  # else another process was faster
                    raise CEIError(f"robot_descriptions:{name}: its cache {cache} cannot be written.")
    return json.loads(json.dumps(answer["known"]).replace(json.dumps(str(staging))[1:-1], json.dumps(str(cache))[1:-1]))


@contextmanager
def _staging(cache: Path) -> Generator[Path]:
    """A folder for new repositories with links to those that the cache has: in the cache, so that they move at once."""
    try:
        cache.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=_STAGING, dir=cache))
    except OSError:  # one that may be read only
        staging = Path(tempfile.mkdtemp(prefix=_STAGING))
    try:
        for entry in cache.iterdir() if cache.is_dir() else ():
            if not entry.name.startswith(_STAGING):
                (staging / entry.name).symlink_to(entry, target_is_directory=True)
        yield staging
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _answer(name: str, staging: Path) -> dict[str, Any]:
    """What the process that imports a description says; it is ended if nothing arrives for too long."""
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            [sys.executable, "-c", _IMPORT, name],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=None if sys.stderr.isatty() else subprocess.DEVNULL,  # its progress
            env=os.environ | {CACHE: str(staging), "GIT_TERMINAL_PROMPT": "0"},
            start_new_session=True,  # git and what it starts end with it
        )
        try:
            arrived, since = 0, time.monotonic()
            while process.poll() is None:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(1.0)
                if (now := _bytes_in(staging)) != arrived:
                    arrived, since = now, time.monotonic()
                patience_s = NO_ANSWER_S * (10 if arrived > _EMPTY_REPOSITORY_BYTES else 1)
                if time.monotonic() - since > patience_s:
                    return {"error": f"{_project(name)} sent nothing for {patience_s:.0f} s"}
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        output.seek(0)
        lines = output.read().decode(errors="replace").splitlines()
    try:
        return json.loads(lines[-1])
    except (IndexError, ValueError):
        return {"error": f"importing it ended with {process.returncode}"}


def _project(name: str) -> str:
    from robot_descriptions import DESCRIPTIONS

    return f"its project {DESCRIPTIONS[name].repository!r}"


def _bytes_in(folder: Path) -> int:
    """Size of what is new in it; links are not followed."""
    total = 0
    for where, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if name != "hooks"]
        for name in files:
            with suppress(OSError):
                total += Path(where, name).lstat().st_size
    return total


def _no_such(kind: str, package: str, name: str, valid: Iterable[str]) -> CEIError:
    names = list(valid)
    close = get_close_matches(name, names, n=8, cutoff=0.3) or names[:8]
    return CEIError(f"{package} has no {kind} {name[:60]!r}; the nearest of its {len(names)} are {', '.join(close)}.")


def _not_downloaded(package: str, name: str, reason: str) -> CEIError:
    told = re.search(r"fatal: (.*?)'?$", reason, re.MULTILINE)  # of git's command, output and exit status what it says
    return CEIError(
        f"{package}:{name} is not on this machine and cannot be downloaded: {one_line(told[1] if told else reason)}. A copy from"
        " elsewhere can be used by the path of its file: `description: FOLDER/ROBOT.urdf` (or .xml, .xacro)."
    )


_FINDERS = {"robot_descriptions": _of_robot_descriptions, "mujoco_menagerie": _of_menagerie}
