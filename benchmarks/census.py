"""How many public robot descriptions load right, are refused with a reason, or come out as something else without a word.

usage: python benchmarks/census.py [--sets robosuite example-robot-data shared] [--results DIR]

The sets: what the robosuite wheel ships, what PyPI's example-robot-data does (`pip install --no-deps example-robot-data`), and ../shared/robots.
Every URDF and MJCF in them is loaded as an arm and, if that succeeds, held against readers that share no code with ours: of a URDF, a
few lines of scipy say where links are in three random poses, trimesh how far each link's meshes reach, and the file itself masses and
limits; of an MJCF, MuJoCo itself says where links are, masses and limits, where it opens the file. What differs and is said in no note is "altered".
Writes census.json.
"""

import argparse
import contextlib
import importlib.metadata
import importlib.util
import os
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import trimesh
from measure import save
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from cei_gym.embodiment import ArmSpec, Embodiment, build_embodiment, use_package_path
from cei_gym.embodiment.meshes import link_mesh
from cei_gym.errors import CEIError, one_line

POSE_M, EXTENT_M, MASS = 1e-4, 1e-3, 1e-3
POSES = 3
SETS = ["robosuite", "example-robot-data", "shared"]
NO_ROBOTS = ["arenas", "bases", "objects"]
"""Folders of robosuite's."""
KINDS = ["right", "refused", "altered", "not compared"]


class NotComparableError(Exception):
    """No other reader says what a description should become."""


def descriptions(folder: Path) -> list[Path]:
    """URDF and MJCF files of robots below a folder; templates and parts of files are none."""
    found: list[Path] = []
    for path in sorted([*folder.rglob("*.urdf"), *folder.rglob("*.xml")]):
        if {*NO_ROBOTS} & {*path.relative_to(folder).parts}:
            continue
        with contextlib.suppress(ElementTree.ParseError, OSError):
            root = ElementTree.parse(path).getroot()
            robot = {"robot": "./link", "mujoco": "./worldbody/body"}.get(root.tag)
            if robot is not None and root.find(robot) is not None:
                found.append(path)
    return found


def load(path: Path) -> Embodiment:
    """A description as an arm that ends at its last link.

    Raises:
        CEIError: it is refused.
    """
    root = ElementTree.parse(path).getroot()
    links = [link.get("name", "") for link in root.iter("link" if root.tag == "robot" else "body")]
    return build_embodiment(ArmSpec("Robot", str(path), links[-1], {}), None)


def altered(path: Path, body: Embodiment) -> Iterator[str]:
    """What an embodiment has otherwise than its file."""
    root = ElementTree.parse(path).getroot()
    if root.tag == "robot":
        yield from _poses(root, body)
        yield from _extents(path, root, body)
        yield from _numbers(root, body)
    else:
        yield from _against_mujoco(path, body)


def _random(body: Embodiment, rng: np.random.Generator) -> np.ndarray:
    lower, upper = body.independent_limits
    low, high = np.clip(lower, -3, 3), np.clip(upper, -3, 3)
    return body.coupled.expand(low + rng.random(len(low)) * (high - low))


def _poses(root: ElementTree.Element, body: Embodiment) -> Iterator[str]:
    rng, data = np.random.default_rng(0), mujoco.MjData(body.model)
    for _ in range(POSES):
        data.qpos[:] = _random(body, rng)
        known = dict(zip(body.joint_names, data.qpos, strict=True))
        mujoco.mj_kinematics(body.model, data)
        expected = link_poses(root, known)
        for link in range(1, body.model.nbody):
            name = body.model.body(link).name
            if name in expected and (off := np.abs(expected[name][:3, 3] - data.xpos[link]).max()) > POSE_M:
                yield f"link {name} is {1e3 * off:.1f} mm off"
                return


def link_poses(root: ElementTree.Element, known: dict[str, float]) -> dict[str, np.ndarray]:
    """(4, 4) of each link of a URDF in the root link's frame; joints that are not known are at 0.

    Here and not pytorch-kinematics, which opens no file whose first link is not its root.
    """
    joints = {joint.find("child").get("link"): joint for joint in root.findall("joint")}  # pyright: ignore
    found: dict[str, np.ndarray] = {}

    def pose(link: str) -> np.ndarray:
        if link not in found:
            joint = joints.get(link)
            found[link] = np.eye(4) if joint is None else pose(joint.find("parent").get("link")) @ _joint(joint, known)  # pyright: ignore
        return found[link]

    for link in root.findall("link"):
        pose(link.get("name", ""))
    return found


def _joint(joint: ElementTree.Element, known: dict[str, float]) -> np.ndarray:
    T, axis, q = _origin(joint), joint.find("axis"), known.get(joint.get("name", ""), 0.0)
    along = np.array((axis.get("xyz") if axis is not None else "1 0 0").split(), float)  # pyright: ignore
    motion = np.eye(4)
    if joint.get("type") in ("revolute", "continuous"):
        motion[:3, :3] = Rotation.from_rotvec(q * along / np.linalg.norm(along)).as_matrix()
    elif joint.get("type") == "prismatic":
        motion[:3, 3] = q * along / np.linalg.norm(along)
    return T @ motion


def _origin(element: ElementTree.Element) -> np.ndarray:
    T, origin = np.eye(4), element.find("origin")
    if origin is not None:
        T[:3, 3] = np.array((origin.get("xyz") or "0 0 0").split(), float)
        T[:3, :3] = Rotation.from_euler("xyz", np.array((origin.get("rpy") or "0 0 0").split(), float)).as_matrix()
    return T


def _extents(path: Path, root: ElementTree.Element, body: Embodiment) -> Iterator[str]:
    for link in root.findall("link"):
        name = link.get("name", "")
        expected = _bounds(path, link)
        if expected is None or name not in body.body_names:
            continue
        ours = link_mesh(body.model, np.flatnonzero(body.model.geom_bodyid == body.body_id(name)))
        off = np.abs(ours.bounds - expected).max()
        if off > EXTENT_M:
            yield f"link {name} reaches {1e3 * off:.1f} mm farther or less far"


def _bounds(path: Path, link: ElementTree.Element) -> np.ndarray | None:
    """(2, 3) of all shapes of a link in its frame; None where there is none, or a file is not there."""
    points = []
    for shape in (*link.findall("visual"), *link.findall("collision")):
        geometry = shape.find("geometry")
        if geometry is not None and len(geometry):
            points.append(trimesh.transform_points(_vertices(path, geometry[0]), _origin(shape)))
    return np.stack([np.concatenate(points).min(0), np.concatenate(points).max(0)]) if points else None


def _vertices(path: Path, shape: ElementTree.Element) -> np.ndarray:
    if shape.tag == "box":
        return trimesh.creation.box(np.array(shape.get("size", "").split(), float)).vertices
    if shape.tag == "sphere":
        return float(shape.get("radius", 0)) * np.vstack([np.eye(3), -np.eye(3)])
    if shape.tag in ("cylinder", "capsule"):
        radius, half = float(shape.get("radius", 0)), float(shape.get("length", 0)) / 2
        half += radius * (shape.tag == "capsule")
        return trimesh.creation.cylinder(radius, 2 * half, sections=128).vertices
    name = shape.get("filename", "")
    scale = np.array((shape.get("scale") or "1 1 1").split(), float)
    for folder in (path.parent, *path.parents):
        file = folder / name.removeprefix("file://").removeprefix("package://").removeprefix("model://").lstrip("/")
        if file.is_file():
            mesh: Any = trimesh.load(file, force="mesh", process=False)
            if not len(mesh.faces):
                raise NotComparableError(f"trimesh finds nothing in {name}")
            return scale * mesh.vertices[np.unique(mesh.faces)]
    raise NotComparableError(f"{name} is not where its name says")


def _numbers(root: ElementTree.Element, body: Embodiment) -> Iterator[str]:
    said = " ".join(body.notes)
    limits = dict(zip(body.joint_names, zip(body.lower, body.upper, strict=True), strict=True))
    for joint in root.findall("joint"):
        limit, name = joint.find("limit"), joint.get("name", "")
        if joint.get("type") in ("revolute", "prismatic") and limit is not None and name in limits:
            expected = [float(limit.get(end, 0)) for end in ("lower", "upper")]
            if (
                not np.allclose(limits[name], expected, atol=1e-6)
                and expected[0] < expected[1]
                and repr(name) not in said
            ):
                yield f"joint {name} has limits of {limits[name][0]:.4g} to {limits[name][1]:.4g} for {expected}"
    for link in root.findall("link"):
        mass, name = link.find("inertial/mass"), link.get("name", "")
        if mass is not None and name in body.body_names:
            ours = body.model.body_mass[body.body_id(name)]
            if abs(ours - float(mass.get("value", 0))) > MASS * max(ours, 1e-3) and repr(name) not in said:
                yield f"link {name} has {ours:.4g} kg for {mass.get('value')}"


def _against_mujoco(path: Path, body: Embodiment) -> Iterator[str]:
    try:
        theirs = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise NotComparableError(f"MuJoCo itself does not open it: {one_line(error)}") from error
    ours, rng = body.model, np.random.default_rng(0)
    data, other = mujoco.MjData(ours), mujoco.MjData(theirs)
    names = {theirs.joint(j).name for j in range(theirs.njnt)} & {*body.joint_names}
    for _ in range(POSES):
        data.qpos[:] = _random(body, rng)
        for name in names:
            other.joint(name).qpos[:] = data.joint(name).qpos
        mujoco.mj_kinematics(ours, data)
        mujoco.mj_kinematics(theirs, other)
        for link in range(1, ours.nbody):
            name = ours.body(link).name
            found = mujoco.mj_name2id(theirs, mujoco.mjtObj.mjOBJ_BODY, name)
            if found > 0 and (off := np.linalg.norm(data.xpos[link] - other.xpos[found])) > POSE_M:
                yield f"link {name} is {1e3 * off:.1f} mm off"
                return
    for name in names:
        ranges = [each.joint(name).range for each in (ours, theirs)]
        if theirs.joint(name).limited and not np.allclose(*ranges, atol=1e-6):
            yield f"joint {name} has limits of {ranges[0]} for {ranges[1]}"
    for link in range(1, ours.nbody):
        found = mujoco.mj_name2id(theirs, mujoco.mjtObj.mjOBJ_BODY, ours.body(link).name)
        if found > 0 and abs(ours.body_mass[link] - theirs.body_mass[found]) > MASS * max(ours.body_mass[link], 1e-3):
            yield f"link {ours.body(link).name} has {ours.body_mass[link]:.4g} kg for {theirs.body_mass[found]:.4g}"


def judge(path: Path) -> dict[str, str]:
    """What becomes of a description, and why."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            body = load(path)
            found = [*altered(path, body)]
    except CEIError as error:
        return {"becomes": "refused", "why": str(error)}
    except NotComparableError as error:
        return {"becomes": "not compared", "why": str(error)}
    if found:
        said = "; ".join(body.notes)
        return {"becomes": "altered", "why": "; ".join(found[:5]), "notes": said}
    return {"becomes": "right", "why": "; ".join(body.notes)}


def folder_of(name: str) -> Path:
    """Where a set is.

    Raises:
        SystemExit: it is not here.
    """
    if name == "shared":
        folder = Path(__file__).resolve().parents[2] / "shared/robots"
    elif name == "robosuite":
        spec = importlib.util.find_spec(name)
        folder = Path(spec.origin).parent / "models/assets" if spec and spec.origin else Path(name)
    else:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            name = str(importlib.metadata.distribution(name).locate_file(f"cmeel.prefix/share/{name}/robots"))
        folder = Path(name)
    if not folder.is_dir():
        raise SystemExit(f"the descriptions of {name} are not here; see --help.")
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=SETS)
    parser.add_argument("--results", type=Path, default=Path("results/robots"))
    arguments = parser.parse_args()
    folders = {name: folder_of(name) for name in arguments.sets}
    rows: list[dict[str, str]] = []
    for name, folder in folders.items():
        use_package_path([folder])
        for path in tqdm(descriptions(folder), name):
            found = {key: text.replace(f"{folder}{os.sep}", "") for key, text in judge(path).items()}
            rows.append({"set": name, "file": path.relative_to(folder).as_posix(), **found})
    table = Table("set", *KINDS)
    counts: dict[str, dict[str, int]] = {}
    for name in folders:
        count = Counter(row["becomes"] for row in rows if row["set"] == name)
        counts[name] = {kind: count[kind] for kind in KINDS}
        table.add_row(name, *map(str, counts[name].values()))
    Console().print(table)
    for row in rows:
        if row["becomes"] != "right":
            print(f"{row['becomes']}: {row['set']}, {row['file']}: {row['why']}")
    save(arguments.results / "census.json", {"seeds": [0, 0], "counts": counts, "descriptions": rows})


if __name__ == "__main__":
    main()
