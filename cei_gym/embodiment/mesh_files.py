"""Mesh files as untrusted input: what MuJoCo reads right goes to it as it is, everything else through trimesh.

MuJoCo reads binary STL, its own MSH, and of an OBJ the first object alone. The rest (OBJ of several objects, text STL, PLY, OFF, glTF,
COLLADA) becomes one surface in an MSH: a binary format without STL's limit of 200,000 triangles that no library writes.
"""

import io
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any
from xml.etree.ElementTree import Element, tostring

import numpy as np
import trimesh
from trimesh.resolvers import Resolver

from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_json
from cei_gym.untrusted_xml import load_xml

FORMATS = (".stl", ".obj", ".msh", ".ply", ".off", ".glb", ".gltf", ".dae")
MAX_BYTES = 128_000_000
MAX_TRIANGLES = 1_000_000

_MUJOCO_STL_TRIANGLES = 200_000
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_MAX_NUMBERS = 30 * MAX_TRIANGLES  # that a glTF may hold


@dataclass(frozen=True)
class MeshFile:
    """A mesh as MuJoCo is given it.

    Attributes:
        content: a file of the kind that `suffix` names.
        suffix: ".stl", ".obj" or ".msh".
        vertices: (V, 3) as they are in the file, in its own units.
        triangles: how many it has.
    """

    content: bytes
    suffix: str
    vertices: Array
    triangles: int


def read_mesh(content: bytes, name: str, beside: Callable[[str], bytes], plain: bool = True) -> MeshFile:
    """Read a mesh.

    Args:
        content: of the file.
        name: of the file; its suffix, in upper or lower case, tells its format.
        beside: content of another file, named relative to this one (the buffers of a glTF).
        plain: whether an OBJ that looks as if MuJoCo read it right goes to it as it is.

    Raises:
        CEIError: it is no such file, too large, or not finite; without the name, which the caller knows.
    """
    suffix = PurePosixPath(name).suffix.lower()
    if suffix not in FORMATS:
        raise CEIError(f"a mesh can be {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, not {suffix or 'without a suffix'}")
    mesh = _as_it_is(content, suffix, plain) or _by_trimesh(content, suffix, beside)
    if not len(mesh.vertices) or not mesh.triangles:
        raise CEIError("there is no triangle in it")
    if mesh.triangles > MAX_TRIANGLES:
        raise CEIError(f"it has {mesh.triangles} triangles; {MAX_TRIANGLES} are allowed, so simplify it")
    if not np.isfinite(mesh.vertices).all():
        raise CEIError("it has coordinates that are not finite")
    return mesh


def _as_it_is(content: bytes, suffix: str, plain: bool) -> MeshFile | None:
    """A file that MuJoCo reads right; None if it is not such a one."""
    if suffix == ".stl":
        return _binary_stl(content)
    if suffix == ".msh":
        return _msh(content)
    return _plain_obj(content) if suffix == ".obj" and plain else None


def _binary_stl(content: bytes) -> MeshFile | None:
    count = int.from_bytes(content[80:84], "little")
    if len(content) != 84 + _STL.itemsize * count or not 0 < count <= MAX_TRIANGLES:
        if not content[:512].lstrip().startswith(b"solid"):
            raise CEIError(f"it is no STL: {len(content)} bytes are not those of its {count} triangles")
        return None  # as text
    corners = np.frombuffer(content, _STL, count, 84)["corners"].reshape(-1, 3)
    if count > _MUJOCO_STL_TRIANGLES:
        return _as_msh(trimesh.Trimesh(corners, np.arange(3 * count).reshape(-1, 3), process=False))
    return MeshFile(content, ".stl", corners, count)


def _msh(content: bytes) -> MeshFile:
    counts = [int(n) for n in np.frombuffer(content[:16].ljust(16, b"\0"), "<i4")]
    vertices, normals, texture, triangles = counts
    size = 16 + 4 * (3 * vertices + 3 * normals + 2 * texture + 3 * triangles)
    if min(counts) < 0 or vertices == 0 or size != len(content):
        raise CEIError("it is no MSH as MuJoCo writes them")
    return MeshFile(content, ".msh", np.frombuffer(content, "<f4", 3 * vertices, 16).reshape(-1, 3), triangles)


def _plain_obj(content: bytes) -> MeshFile | None:
    """An OBJ with triangles of one object alone, written so plainly that no two readers disagree; None if it is not such a one."""
    text = np.frombuffer(b"\n" + content + b"\n  ", np.uint8)
    begins = np.flatnonzero(text == ord("\n"))[:-1] + 1  # of lines
    kinds, faces = text[begins], np.flatnonzero(text[begins] == ord("f"))
    odd = np.isin(kinds, np.frombuffer(b" \t\0", np.uint8)).any() or b"\\" in content
    if odd or not len(faces) or np.isin(kinds[faces[0] :], np.frombuffer(b"oglpc", np.uint8)).any():
        return None
    points = np.flatnonzero((kinds == ord("v")) & np.isin(text[begins + 1], np.frombuffer(b" \t", np.uint8)))
    if not len(points) or points[-1] - points[0] + 1 != len(points):
        return None
    rows = text[begins[points[0]] : begins[points[-1] + 1]].copy()
    rows[begins[points] - begins[points[0]]] = ord(" ")  # the v
    blank = np.isin(rows, np.frombuffer(b" \t\n\v\f\r", np.uint8))
    try:
        numbers = np.fromstring(rows.tobytes(), sep=" ")
    except (ValueError, DeprecationWarning):
        return None
    # What is no number ends the reading, with a warning; to turn that into an error would be for all threads of the process.
    if len(numbers) != np.count_nonzero(blank[:-1] & ~blank[1:]):
        return None
    if len(numbers) % len(points) or len(numbers) < 3 * len(points):
        return None
    return MeshFile(content, ".obj", numbers.reshape(len(points), -1)[:, :3], len(faces))


def _by_trimesh(content: bytes, suffix: str, beside: Callable[[str], bytes]) -> MeshFile:
    unit_m = 1.0
    if suffix == ".dae":
        content, unit_m = _safe_collada(content)
    elif suffix in (".glb", ".gltf"):
        _check_gltf(content, suffix)
    elif suffix == ".ply":
        _check_ply(content)
    resolver = _Beside(beside) if suffix == ".gltf" else None
    options: dict[str, Any] = {}
    if suffix == ".dae":
        options["ignore_broken"] = False
    elif suffix != ".ply":
        options["skip_materials"] = True
    try:
        scene = trimesh.load_scene(io.BytesIO(content), suffix[1:], resolver, process=False, **options)
        surfaces = {key: part for key, part in scene.geometry.items() if isinstance(part, trimesh.Trimesh)}
        parts = [scene.graph[node][1] for node in scene.graph.nodes_geometry]
        triangles = sum(len(surfaces[part].faces) for part in parts if part in surfaces)
        if triangles > MAX_TRIANGLES:
            raise CEIError(f"it has {triangles} triangles; {MAX_TRIANGLES} are allowed, so simplify it")
        mesh = scene.to_mesh()
    except (CEIError, MemoryError):
        raise
    except Exception as error:  # readers of some ten formats, each of which fails on nonsense in its own way
        raise CEIError(f"it cannot be read as {suffix[1:].upper()}: {one_line(error, 80)}") from None
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise CEIError("there is no triangle in it")
    return _as_msh(mesh.apply_scale(unit_m) if unit_m != 1.0 else mesh)


def _as_msh(mesh: trimesh.Trimesh) -> MeshFile:
    """One surface, without vertices that are there twice or belong to no triangle."""
    if len(mesh.faces) > MAX_TRIANGLES:
        raise CEIError(f"it has {len(mesh.faces)} triangles; {MAX_TRIANGLES} are allowed, so simplify it")
    if not np.isfinite(mesh.vertices).all():
        raise CEIError("it has coordinates that are not finite")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.remove_unreferenced_vertices()
    vertices, faces = mesh.vertices.astype("<f4"), mesh.faces.astype("<i4")
    header = np.array([len(vertices), 0, 0, len(faces)], "<i4")
    return MeshFile(header.tobytes() + vertices.tobytes() + faces.tobytes(), ".msh", vertices, len(faces))


class _Beside(Resolver):
    """Gives trimesh files beside a mesh, as far as they may be read."""

    def __init__(self, read: Callable[[str], bytes]) -> None:
        self._read = read

    def get(self, name: str) -> bytes:
        return self._read(name)

    def write(self, name: str, data: object) -> None:
        raise CEIError("nothing is written")

    def keys(self) -> list[str]:
        return []

    def namespaced(self, namespace: str) -> "_Beside":
        del namespace
        return self


def _check_ply(content: bytes) -> None:
    """Refuse a PLY that claims more elements than it has bytes."""
    head = content[:10_000].partition(b"end_header")[0].split(b"\n")
    claimed = [line.split()[-1] for line in head if line.startswith(b"element ")]
    if any(not n.isdigit() or len(n) > 12 or int(n) > len(content) for n in claimed):
        raise CEIError("it is cut short, or its header is wrong")


def _check_gltf(content: bytes, suffix: str) -> None:
    """Refuse a glTF that claims more numbers than a mesh may have."""
    text = content
    if suffix == ".glb":
        if content[:4] != b"glTF" or len(content) < 20:
            raise CEIError("it is no binary glTF")
        text = content[20 : 20 + int.from_bytes(content[12:16], "little")]
    try:
        accessors = load_json(text.decode()).get("accessors", [])
        claimed = sum(int(accessor.get("count", 0)) for accessor in accessors)
    except (CEIError, ValueError, TypeError, AttributeError, OverflowError, json.JSONDecodeError):
        raise CEIError("its glTF header cannot be read") from None
    if claimed > _MAX_NUMBERS:
        raise CEIError(f"it claims {claimed} numbers; {_MAX_NUMBERS} are allowed")


_COLLADA_PARTS = ("asset", "library_geometries", "library_nodes", "library_visual_scenes", "scene")
_NO_GEOMETRY = ("bind_material", "extra", "instance_light", "instance_camera")


def _safe_collada(content: bytes) -> tuple[bytes, float]:
    """A COLLADA's geometry alone, for a parser that would follow entities, and the unit in m.

    Its `up_axis` is left alone, as by ROS's tools.
    """
    tree = load_xml(content, MAX_BYTES)
    if tree.tag.rpartition(":")[2] != "COLLADA":
        raise CEIError(f"it is no COLLADA: its root element is <{tree.tag[:40]}>")
    for parent in list(tree.iter()):
        for part in list(parent):
            if (parent is tree and part.tag not in _COLLADA_PARTS) or part.tag in _NO_GEOMETRY:
                parent.remove(part)
    if odd := next(
        (tag for tag in ("instance_controller", "spline", "convex_mesh") if tree.find(f".//{tag}") is not None), None
    ):
        raise CEIError(f"its <{odd}> is not supported; export it as triangles")
    meter = next((unit.get("meter", "1") for unit in tree.iterfind("asset/unit")), "1")
    try:
        unit_m = float(meter)
    except ValueError:
        unit_m = math.nan
    if not 0 < unit_m < math.inf:
        raise CEIError(f"its unit is {meter[:40]!r} m")
    instances = {element.get("id", ""): element for element in tree.iter("node")}
    known: dict[Element, float] = {}
    try:
        drawn = sum(_drawn(node, instances, known) for node in tree.iterfind("library_visual_scenes/visual_scene/node"))
    except RecursionError:
        drawn = math.inf
    if drawn > 10_000:
        raise CEIError("its nodes refer to each other too often")
    return tostring(tree), unit_m


def _drawn(node: Element, instances: dict[str, Element], known: dict[Element, float]) -> float:
    """How many geometries a node stands for, references followed; infinitely many if it is part of itself."""
    if node not in known:
        known[node] = math.inf
        known[node] = (
            sum(1 for _ in node.iterfind("instance_geometry"))
            + sum(_drawn(child, instances, known) for child in node.iterfind("node"))
            + sum(
                _drawn(instances[target], instances, known)
                for link in node.iterfind("instance_node")
                if (target := link.get("url", "").removeprefix("#")) in instances
            )
        )
    return known[node]
