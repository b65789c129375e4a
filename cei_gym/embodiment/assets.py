"""The files that a description names, read once and checked, in memory under names of their own."""

import io
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from zlib import crc32

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.mesh_files import MAX_BYTES, MeshFile, read_mesh
from cei_gym.embodiment.resources import Place, read_file
from cei_gym.errors import CEIError, one_line

MAX_TOTAL_BYTES = 512_000_000
MAX_TOTAL_TRIANGLES = 4_000_000
MAX_TEXELS = 16_000_000

_FLAT = 1e-6  # thickness over length
_SAME_MM = 1.0  # how far a compiled mesh may be from its file
_LARGEST_M = 5.0  # no link is larger
_SMALLEST_M = 1e-4
_FINE_HULL = 5000  # vertices beyond which a convex hull takes MuJoCo seconds


@dataclass
class Assets:
    """Meshes and textures of one description.

    A key is made of a file's place and content, so that files that share a name do not share a key, in one description or in two.

    Attributes:
        place: where the description is.
        plain: as in `read_mesh`.
        contents: key to content, as MuJoCo takes them.
        meshes: key to mesh.
        names: key to the name that the description has for it.
    """

    place: Place
    plain: bool = True
    contents: dict[str, bytes] = field(default_factory=dict[str, bytes])
    meshes: dict[str, MeshFile] = field(default_factory=dict[str, MeshFile])
    names: dict[str, str] = field(default_factory=dict[str, str])
    _known: dict[tuple[Path, str], str] = field(default_factory=dict[tuple[Path, str], str])
    _sizes: dict[Path, int] = field(default_factory=dict[Path, int])
    _texels: int = 0

    def mesh(self, path: Path, name: str, variant: str = "") -> str:
        """Key of a mesh.

        Args:
            path: its file, inside the root.
            name: what the description calls it, for messages.
            variant: what else tells two uses of one file apart, such as their scale.

        Raises:
            CEIError: it cannot be read, or is too large.
        """
        use = (path, f"mesh {variant}")
        if use not in self._known:
            content = read_file(path, name, MAX_BYTES)
            try:
                mesh = read_mesh(content, path.name, lambda beside: self._beside(path, beside), self.plain)
            except CEIError as error:
                raise CEIError(f"mesh {name!r}: {error}.") from None
            except MemoryError:
                raise CEIError(f"mesh {name!r}: it needs too much memory.") from None
            self._known[use] = key = self._add(path, mesh.content, mesh.suffix, variant)
            self.meshes[key], self.names[key] = mesh, name
        return self._known[use]

    def texture(self, path: Path, name: str) -> str:
        """Key of a texture, as PNG.

        Raises:
            CEIError: it cannot be read, or has too many texels.
        """
        from PIL import Image

        use = (path, "texture")
        if use not in self._known:
            content = read_file(path, name, MAX_BYTES)
            try:
                with Image.open(io.BytesIO(content)) as image:
                    self._sizes[path] = image.width * image.height
                    self.count_texels(0 if image.format == "PNG" else self._sizes[path], name)
                    if image.format != "PNG":
                        written = io.BytesIO()
                        image.convert("RGB").save(written, "PNG")
                        content = written.getvalue()
            except CEIError:
                raise
            except Exception as error:  # Pillow's readers fail on nonsense in many ways
                raise CEIError(f"texture {name!r} cannot be read: {one_line(error, 80)}.") from None
            self._known[use] = self._add(path, content, ".png", "")
        self.count_texels(self._sizes[path], name)
        return self._known[use]

    def count_texels(self, texels: int, name: str) -> None:
        """Add to the number of texels.

        Raises:
            CEIError: there are too many.
        """
        self._texels += texels
        if not 0 <= texels <= self._texels <= MAX_TEXELS:
            raise CEIError(f"texture {name!r}: textures have more than {MAX_TEXELS} texels.")

    def prepare(self, spec: mujoco.MjSpec) -> list[str]:
        """Check sizes of a parsed description's meshes, bound the work on their convex hulls, and have flat ones touch nothing: they
        have no hull.

        Returns:
            Sentences about flat ones.

        Raises:
            CEIError: a mesh is of a size that no link has.
        """
        flat, triangles = set(), {}
        for mesh in spec.meshes:
            file = self.meshes.get(mesh.file)
            triangles[mesh.name] = len(mesh.userface) // 3 if file is None else file.triangles
            vertices = np.reshape(mesh.uservert, (-1, 3)) if file is None else file.vertices
            if file is not None:
                self._check_size(mesh.file, np.ptp(vertices, axis=0), np.asarray(mesh.scale))
            if len(vertices) > _FINE_HULL and not 0 < mesh.maxhullvert <= _FINE_HULL:
                mesh.maxhullvert = _FINE_HULL
            if len(vertices) and _is_flat(vertices * mesh.scale):
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
                flat.add(mesh.name)
        notes = []
        in_geoms = sum(triangles.get(geom.meshname, 0) for geom in spec.geoms)
        if max(in_geoms, sum(triangles.values())) > MAX_TOTAL_TRIANGLES:
            raise CEIError(
                f"its meshes, in all their uses, have more than {MAX_TOTAL_TRIANGLES} triangles; simplify them."
            )
        for geom in spec.geoms:
            if geom.meshname in flat and geom.type == mujoco.mjtGeom.mjGEOM_MESH and (geom.contype or geom.conaffinity):
                geom.contype = geom.conaffinity = 0
                notes.append(f"geom {geom.name!r} is flat; it is seen, and touches nothing.")
        return notes

    def _check_size(self, key: str, extents: Array, scale: Array) -> None:
        size_m, unscaled_m = float(np.max(extents * np.abs(scale))), float(extents.max())
        if size_m > _LARGEST_M:
            wanted = " ".join(f"{s / 1000:g}" for s in scale)
            raise CEIError(
                f'mesh {self.names[key]!r} is {size_m:.3g} m long, which no link is; with scale="{wanted}" (millimetres) it is'
                f" {size_m:.3g} mm."
            )
        if size_m < _SMALLEST_M and (np.abs(scale) < 1).any() and unscaled_m > 10 * _SMALLEST_M:
            raise CEIError(
                f'mesh {self.names[key]!r} is {1000 * size_m:.2g} mm long, which no link is; with scale="1 1 1" (metres) it is'
                f" {unscaled_m:.3g} m."
            )

    def _beside(self, path: Path, name: str) -> bytes:
        return read_file(self.place.inside(path.parent / name, name), name, MAX_BYTES)

    def _add(self, path: Path, content: bytes, suffix: str, variant: str) -> str:
        told_apart = f"{self.place.relative(path)} {variant} {len(content)} {crc32(content)}"
        digest = blake2b(told_apart.encode(), digest_size=8).hexdigest()
        stem = "".join(c if c.isascii() and c.isalnum() else "_" for c in path.stem[:40])
        key = f"{stem}-{digest}{suffix}"
        self.contents[key] = content
        if sum(map(len, self.contents.values())) > MAX_TOTAL_BYTES:
            raise CEIError(f"its files have more than {MAX_TOTAL_BYTES} bytes.")
        return key


class MeshDiffersError(CEIError):
    """A compiled mesh is not what its file shows."""


def check_compiled(spec: mujoco.MjSpec, model: mujoco.MjModel, assets: list[Assets]) -> None:
    """Compare the extents of compiled meshes with those of their files.

    Args:
        spec: what was compiled.
        model: the result.
        assets: of the descriptions in it.

    Raises:
        MeshDiffersError: one differs by more than a millimetre.
    """
    files = {key: (each, mesh) for each in assets for key, mesh in each.meshes.items()}
    for declared in spec.meshes:
        if declared.file not in files:
            continue
        each, file = files[declared.file]
        mesh = model.mesh(declared.name)
        vertices = model.mesh_vert[model.mesh_vertadr[mesh.id] :][: model.mesh_vertnum[mesh.id]]
        faces = model.mesh_face[model.mesh_faceadr[mesh.id] :][: model.mesh_facenum[mesh.id]]
        compiled = _rotated(vertices[np.unique(faces)], model.mesh_quat[mesh.id]) + model.mesh_pos[mesh.id]
        conjugate = np.asarray(declared.refquat) * [1, -1, -1, -1]
        expected = _rotated(file.vertices - declared.refpos, conjugate) * declared.scale
        off_mm = 1000 * max(
            np.abs(compiled.min(0) - expected.min(0)).max(), np.abs(compiled.max(0) - expected.max(0)).max()
        )
        if not off_mm <= _SAME_MM:
            raise MeshDiffersError(
                f"mesh {each.names[declared.file]!r} of {each.place.path.name} comes out {off_mm:.3g} mm off what its file shows;"
                " has it points that belong to no triangle?"
            )


def _is_flat(vertices: Array) -> bool:
    deviations = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(vertices.T)), 0))
    return len(vertices) > 3 and deviations[0] < _FLAT * deviations[2]


def _rotated(points: Array, quat_wxyz: Array) -> Array:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat_wxyz / np.linalg.norm(quat_wxyz))
    return points @ matrix.reshape(3, 3).T
