"""Embodiments by name: every arm with every end-effector, each one YAML, those that ship and those of your own."""

import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from cei_gym.embodiment.building import build_embodiment
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.embodiment.spec import ArmSpec, EndEffectorSpec, load_spec, read_fields
from cei_gym.errors import CEIError, unknown

ARMS = ("UR5e", "IIWA", "Kinova3", "Panda")
"""The arms of the paper's grid, which robosuite mounts and drives."""

END_EFFECTORS = ("FourierRight", "Inspire", "FourierLeft", "RobotiqThreeFinger", "PandaGripper")
"""The end-effectors of the paper's grid."""

GRID = tuple(f"{arm}-{end_effector}" for arm in ARMS for end_effector in END_EFFECTORS)
"""All pairs of these."""

FOLDERS = "CEI_GYM_EMBODIMENTS"
"""Environment variable with folders of your own embodiments, separated as in PATH; each has `arms` and `end_effectors`."""

_KEPT = 8
"""Compiled embodiments are kept, of 50 to 100 MB each: more than a conversion has, and not all of them."""

_SHIPPED = Path(__file__).parent / "specifications"


def arm_names() -> list[str]:
    """List the arms that ship, those of the paper first, then your own."""
    return [*_shipped("arms", ARMS), *_own("arms")]


def end_effector_names() -> list[str]:
    """List the end-effectors that ship, those of the paper first, then your own."""
    return [*_shipped("end_effectors", END_EFFECTORS), *_own("end_effectors")]


def embodiment_names() -> list[str]:
    """All `<Arm>-<EndEffector>` names."""
    return [f"{arm}-{end_effector}" for arm in arm_names() for end_effector in end_effector_names()]


def load_arm(name: str) -> ArmSpec:
    """Specification of an arm.

    Raises:
        CEIError: no such name (the message lists the valid ones), or its YAML is wrong.
    """
    if name not in arm_names():
        raise unknown("arm", name, arm_names())
    return _load(ArmSpec, "arms", name)


def load_end_effector(name: str) -> EndEffectorSpec:
    """Specification of an end-effector.

    Raises:
        CEIError: no such name (the message lists the valid ones), or its YAML is wrong.
    """
    if name not in end_effector_names():
        raise unknown("end-effector", name, end_effector_names())
    return _load(EndEffectorSpec, "end_effectors", name)


@lru_cache(maxsize=_KEPT)
def load_embodiment(name: str) -> Embodiment:
    """Build an embodiment (compiled once a process as long as it uses few; treat it as read-only).

    Raises:
        CEIError: no such name (the message lists the valid ones), or its description is not installed.
    """
    check_embodiment(name)
    arm, end_effector = name.split("-")
    return build_embodiment(load_arm(arm), load_end_effector(end_effector))


def own_yamls(name: str) -> list[Path]:
    """The YAMLs of one's own, arm's first, that an embodiment's name stands for; none of what ships, or of no such name.

    Raises:
        CEIError: a folder that `FOLDERS` names is not there.
    """
    arm, _, end_effector = name.partition("-")
    return [
        path
        for kind, part in (("arms", arm), ("end_effectors", end_effector))
        for path in _own_files(kind)
        if path.stem == part
    ]


def check_embodiment(name: str, kind: str = "embodiment") -> None:
    """Refuse what is no embodiment's name.

    Args:
        name: `<Arm>-<EndEffector>`.
        kind: what it is the name of, for the message.

    Raises:
        CEIError: it is none; the message says which part of it is unknown, with the valid ones.
    """
    arm, _, end_effector = name.partition("-")
    for part, own, valid in (("arm", arm, arm_names()), ("end-effector", end_effector, end_effector_names())):
        if own not in valid:
            raise CEIError(f"unknown {kind} {name!r}, <Arm>-<EndEffector>: {unknown(part, own, valid)}")


def load_part(path: Path) -> ArmSpec | EndEffectorSpec:
    """The arm or end-effector of a YAML, told apart by `mount_body` and `pads`, which only one of them has.

    Raises:
        CEIError: it is neither, or wrong.
    """
    fields = read_fields(path)
    if ("mount_body" in fields) == ("pads" in fields):
        raise CEIError(
            f"{path.name}: an arm has a `mount_body`, an end-effector `pads`; this has {'both' if 'pads' in fields else 'neither'}."
        )
    return load_spec(ArmSpec if "mount_body" in fields else EndEffectorSpec, path)


@lru_cache
def _shipped(kind: str, first: tuple[str, ...]) -> tuple[str, ...]:
    return (*first, *sorted({path.stem for path in (_SHIPPED / kind).glob("*.yaml")} - set(first)))


def _own(kind: str) -> list[str]:
    return [path.stem for path in _own_files(kind)]


def _own_files(kind: str) -> Iterator[Path]:
    for folder in filter(None, os.environ.get(FOLDERS, "").split(os.pathsep)):
        if not Path(folder).is_dir():
            raise CEIError(f"{FOLDERS}: no such folder: {folder}.")
        yield from sorted(Path(folder, kind).glob("*.yaml"))


def _load[Spec: (ArmSpec, EndEffectorSpec)](cls: type[Spec], kind: str, name: str) -> Spec:
    files = [
        path for path in (_SHIPPED / kind / f"{name}.yaml", *_own_files(kind)) if path.stem == name and path.is_file()
    ]
    if len(files) > 1:
        raise CEIError(f"{name} is described twice, in {files[0]} and {files[1]}; rename one.")
    spec = load_spec(cls, files[0])
    if spec.name != name or "-" in name:
        raise CEIError(f"{files[0]}: its name is {spec.name!r}; it should be that of the file, without a hyphen.")
    return spec
