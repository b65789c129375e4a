"""MJCF to `mujoco.MjSpec`: what describes a robot is kept, every file in memory."""

from pathlib import PurePosixPath
from xml.etree.ElementTree import Element, tostring

import mujoco

from cei_gym.embodiment.assets import Assets
from cei_gym.embodiment.elements import check_counts, check_numbers
from cei_gym.embodiment.includes import Document
from cei_gym.errors import CEIError

_LEFT_OUT = ("option", "size", "visual", "statistic", "custom", "sensor", "keyframe", "lengthrange")
"""Of a simulation, not of a robot. Some ask for memory or time without bound, some switch contacts or gravity off."""

_REFUSED = {
    **dict.fromkeys(("replicate", "composite", "flexcomp"), "write out what it stands for"),
    **dict.fromkeys(("attach", "model"), "write the model in its place"),
    **dict.fromkeys(("plugin", "extension"), "leave it out, with what needs it"),
    **dict.fromkeys(
        ("deformable", "flex", "skin", "hfield"), "a robot here is rigid links of meshes and simple shapes"
    ),
}
"""Element -> what to do instead. A few bytes of most of them ask for any amount of memory, or open files."""

_ATTRIBUTES_LEFT_OUT = ("user", "nsample", "delay", "interp", "actdim", "content_type", "xmlns")
_COMPILER_LEFT_OUT = (
    *("meshdir", "texturedir", "assetdir", "strippath"),  # done here
    *("discardvisual", "fusestatic"),  # would drop what a camera sees, or links by name
    "saveinertial",
)
_JOINT_ACTUATORS = ("motor", "position", "general", "velocity", "intvelocity", "damper")
_TEXTURE_FILES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")


def read_mjcf(tree: Element, assets: Assets) -> mujoco.MjSpec:
    """Parse an MJCF.

    Args:
        tree: its root element; changed.
        assets: what its meshes and textures are put into.

    Raises:
        CEIError: it cannot be used.
        ValueError: MuJoCo refuses it.
    """
    document = Document(tree, assets.place)
    for element in tree.iter():
        if element.tag in _REFUSED:
            raise CEIError(f"<{element.tag}> is not allowed in a robot description; {_REFUSED[element.tag]}.")
    _strip(tree)
    check_counts(tree)
    check_numbers(tree)
    folders = _folders(tree)
    for mesh in list(tree.iterfind("asset/mesh")):
        _read_mesh(mesh, document, folders, assets)
    for texture in tree.iterfind("asset/texture"):
        _read_texture(texture, document, folders, assets)
    _drop_repeated(tree)
    _refuse_files(tree, assets)
    return mujoco.MjSpec.from_string(tostring(tree, encoding="unicode"), assets=assets.contents)


def _strip(tree: Element) -> None:
    for parent in tree.iter():
        for child in list(parent):
            on_other = parent.tag == "actuator" and (child.tag not in _JOINT_ACTUATORS or "joint" not in child.attrib)
            if child.tag in _LEFT_OUT or on_other:
                parent.remove(child)
    for element in tree.iter():
        for name in list(element.attrib):
            if name in _ATTRIBUTES_LEFT_OUT or name.startswith("xmlns:"):
                del element.attrib[name]


def _folders(tree: Element) -> dict[str, str]:
    """Where meshes and textures are: the last `<compiler>` that says so counts, as in MuJoCo."""
    folders = {"mesh": "", "texture": "", "strip": "false"}
    for compiler in tree.iterfind("compiler"):
        assetdir = compiler.get("assetdir")
        for kind in ("mesh", "texture"):
            if (folder := compiler.get(f"{kind}dir", assetdir)) is not None:
                folders[kind] = folder
        folders["strip"] = compiler.get("strippath", folders["strip"])
        for name in _COMPILER_LEFT_OUT:
            compiler.attrib.pop(name, None)
    return folders


def _read_mesh(mesh: Element, document: Document, folders: dict[str, str], assets: Assets) -> None:
    if mesh.get("builtin", "none") != "none":
        raise CEIError(
            f"<mesh builtin={mesh.get('builtin', '')[:40]!r}> is not allowed in a robot description; put it into a file."
        )
    if (file := mesh.get("file")) is None:
        return
    name = _file(file, folders)
    if "name" not in mesh.attrib:
        mesh.set("name", PurePosixPath(name).stem)  # as MuJoCo has it
    mesh.set("file", assets.mesh(document.find(mesh, folders["mesh"], name), file))


def _read_texture(texture: Element, document: Document, folders: dict[str, str], assets: Assets) -> None:
    if "file" in texture.attrib and "name" not in texture.attrib:
        texture.set("name", PurePosixPath(_file(texture.attrib["file"], folders)).stem)  # as MuJoCo has it
    for attribute in _TEXTURE_FILES:
        if (file := texture.get(attribute)) is not None:
            path = document.find(texture, folders["texture"], _file(file, folders))
            texture.set(attribute, assets.texture(path, file))
    if texture.get("builtin", "none") != "none":
        sides = 6 if texture.get("type", "cube") != "2d" else 1
        try:
            width, height = (int(texture.get(side, "0")) for side in ("width", "height"))
        except ValueError:
            raise CEIError(f"texture {texture.get('name', '')!r}: its width or height is no number.") from None
        assets.count_texels(sides * max(width, 0) * max(width, height, 0), texture.get("name", ""))


def _file(file: str, folders: dict[str, str]) -> str:
    file = file.replace("\\", "/")
    return PurePosixPath(file).name if folders["strip"] == "true" else file


def _drop_repeated(tree: Element) -> None:
    """A mesh that is declared twice in the same words is one."""
    for asset in tree.iterfind("asset"):
        seen = set()
        for mesh in asset.findall("mesh"):
            words = tuple(sorted(mesh.items()))
            if mesh.get("name") and words in seen:
                asset.remove(mesh)
            seen.add(words)


def _refuse_files(tree: Element, assets: Assets) -> None:
    """Nothing names a file that is not in memory."""
    for element in tree.iter():
        for name, value in element.items():
            if name.startswith("file") and value not in assets.contents:
                raise CEIError(f"<{element.tag} {name}={value[:60]!r}>: only meshes and textures are read from files.")
