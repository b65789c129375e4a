"""Where a robot description lives, which folder it is trusted with, and where its ROS packages are.

What a description names must lie inside its root: the topmost of
- its own folder, and the one above where the two look like a package without its `package.xml` (`urdf/` beside `meshes/`);
- the nearest folder above that is a ROS package (has a `package.xml`);
- the folder of the YAML that names it, if it lies in there;
- the package of the package path, or the Python package, that it was found in;
- the model's folder, or the repository, of a description that goes by another project's name (`named`).
"""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path

from cei_gym.embodiment.named import find_named
from cei_gym.errors import CEIError
from cei_gym.extras import install_command
from cei_gym.untrusted_xml import load_xml

SCHEME = "package://"

PACKAGE_PATH = "CEI_GYM_PACKAGE_PATH"
"""Environment variable with folders that ROS packages are looked for in, separated as in PATH."""

_DESCRIPTIONS = ("urdf", "mjcf", "xml", "xacro", "sdf", "robot", "robots", "model", "models")
_BESIDE_THEM = ("meshes", "mesh", "assets", "textures", "materials", "media")
_MOST_FOLDERS, _DEEPEST = 20_000, 3  # how far a package is looked for


@dataclass(frozen=True)
class Place:
    """A description's file, and what it may read.

    Attributes:
        path: the file.
        root: folder that everything it names must stay inside.
        packages: folders that ROS packages are looked for in.
        xacro_args: arguments of a xacro that come with its name.
    """

    path: Path
    root: Path
    packages: tuple[Path, ...] = ()
    xacro_args: dict[str, str] = field(default_factory=dict[str, str])

    def inside(self, path: Path, what: str) -> Path:
        """`path`, resolved.

        Raises:
            CEIError: it leaves the root, or is there but no file.
        """
        return within(self.root, path, what)

    def relative(self, path: Path) -> str:
        """`path` from the root, or from the package that it is in: the same wherever those lie."""
        if path.is_relative_to(self.root):
            return os.path.relpath(path, self.root)
        package = next((folder for folder in path.parents if (folder / "package.xml").is_file()), path.parent)
        return os.path.relpath(path, package)

    def package(self, name: str) -> Path:
        """Folder of a ROS package: one around the description, however it is called if its `package.xml` has the name, one in the
        root, or one of the package path.

        Raises:
            CEIError: there is none.
        """
        around = [p for p in self.path.parents if p.is_relative_to(self.root)]
        for folder in around:
            if _package_name(folder) == name:
                return folder
        for folder in around:
            if folder.name == name:
                return folder
        if found := _package_in((self.root, *self.packages), name):
            return found
        raise CEIError(
            f"package {name[:60]!r}: no enclosing folder is named {name[:60]!r} or has a package.xml that says so; say where the package is"
            f" with --package_path=<folder that it is in> (or {PACKAGE_PATH}, or `package_path` in the YAML)."
        )


def locate(uri: str, folder: Path, trusted: Iterable[Path] = (), package_path: Iterable[Path] = ()) -> Place:
    """Find a description.

    Args:
        uri: `package://<package>/<path>`, a ROS package of the package path or an installed Python package;
            `robot_descriptions:<name>` or `mujoco_menagerie:<name>`, which are downloaded if need be; or a path.
        folder: what a relative path starts from.
        trusted: folders whose contents the description may read if it lies inside.
        package_path: folders that ROS packages are looked for in, besides those of the environment.

    Raises:
        CEIError: the package is not there, the file is missing, or it lies outside its package; or it cannot be downloaded.
    """
    packages = (*package_path, *environment_packages())
    arguments: dict[str, str] = {}
    if (named := find_named(uri)) is not None:
        packages, arguments = (*named.packages, *packages), named.xacro_args
        root = named.root
        path = within(root, named.path, uri)
    elif uri.startswith(SCHEME):
        name, _, inside = uri.removeprefix(SCHEME).partition("/")
        root = _package_in(packages, name) or package_root(name)
        path = within(root, root / inside, uri)
    else:
        path = resolved(folder.expanduser() / Path(uri).expanduser(), uri)
        root = _root(path, trusted, packages)
    if not path.is_file():
        raise CEIError(f"no robot description at {uri!r} (looked for {path.name} in {path.parent}).{_closest(path)}")
    return Place(path, root.resolve(), tuple(packages), arguments)


def package_root(package: str) -> Path:
    """Folder of an installed Python package, found without importing it."""
    if not package.isidentifier():  # of a dotted name, find_spec would import the first part
        raise CEIError(f"a description reads {SCHEME}<python package>/<path>; {package[:60]!r} is no package's name.")
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise CEIError(
            f"package {package!r} is not installed; its robot descriptions are needed: {install_command(package)}, or, for a "
            "ROS package, --package_path=<folder that it is in>."
        )
    return Path(next(iter(spec.submodule_search_locations)))


def use_package_path(folders: Iterable[str | Path] | None) -> None:
    """Look for ROS packages in these folders from now on, in this process and those that it starts.

    Raises:
        CEIError: one is no folder.
    """
    if folders is not None:
        found = [_existing(folder, "--package_path") for folder in map(str, folders)]
        os.environ[PACKAGE_PATH] = os.pathsep.join(map(str, found))


def environment_packages() -> tuple[Path, ...]:
    """Folders of the environment's package path.

    Raises:
        CEIError: one is no folder.
    """
    return tuple(
        _existing(folder, PACKAGE_PATH) for folder in os.environ.get(PACKAGE_PATH, "").split(os.pathsep) if folder
    )


def packages_beside(yaml_folder: Path, folders: Iterable[str]) -> tuple[Path, ...]:
    """Folders of a YAML's own package path. It may come from a stranger, too, so it extends to what is beside and below it only.

    Raises:
        CEIError: one is no folder, or lies elsewhere.
    """
    found: list[Path] = []
    for folder in folders:
        path = _existing(str(yaml_folder / folder), "package_path")
        if not path.is_relative_to(yaml_folder.resolve()):
            raise CEIError(
                f"package_path: {folder!r} is not below the YAML's own folder; give others with --package_path or {PACKAGE_PATH}."
            )
        found.append(path)
    return tuple(found)


def within(root: Path, path: Path, what: str) -> Path:
    """`path` resolved, refused if it leaves `root` or is there but no file (a description is untrusted input)."""
    place = resolved(path, what)
    if not place.is_relative_to(root.resolve()):
        raise CEIError(f"{what!r} points outside its folder {root.resolve().name!r}; only files inside it are read.")
    if place.exists() and not place.is_file():
        raise CEIError(f"{what!r} is no file.")
    return place


def resolved(path: Path, what: str) -> Path:
    """`path` without links and `..`.

    Raises:
        CEIError: it cannot be a path: too long, a loop of links, a null byte.
    """
    try:
        place = path.resolve()
        place.exists()
    except (OSError, RuntimeError, ValueError) as error:
        raise CEIError(f"{what[:60]!r} is no path to a file: {str(error)[:60]}.") from error
    return place


def read_file(path: Path, what: str, most_bytes: int) -> bytes:
    """Content of a file inside its root.

    Raises:
        CEIError: it is missing, too large, or cannot be read.
    """
    try:
        if (size := path.stat().st_size) > most_bytes:
            raise CEIError(f"{what!r} has {size} bytes; {most_bytes} are allowed.")
        return path.read_bytes()
    except FileNotFoundError:
        raise CEIError(f"no such file: {what!r}.{_closest(path)}") from None
    except OSError as error:
        raise CEIError(f"{what!r} cannot be read: {error.strerror}.") from None


def _root(path: Path, trusted: Iterable[Path], packages: Iterable[Path]) -> Path:
    own = path.parent
    roots = [own, *(folder.resolve() for folder in trusted)]
    if own.name.lower() in _DESCRIPTIONS and any((own.parent / name).is_dir() for name in _BESIDE_THEM):
        roots.append(own.parent)
    roots += [next((p for p in path.parents if (p / "package.xml").is_file()), own)]
    for folder in packages:
        if path.is_relative_to(folder) and path.parent != folder:
            roots.append(folder / path.relative_to(folder).parts[0])
    return min((root for root in roots if path.is_relative_to(root)), key=lambda root: len(root.parts))


def _package_in(folders: Iterable[Path], name: str) -> Path | None:
    """A ROS package in one of the folders, or one that is such a folder; not by a link that leads out of it."""
    for folder in folders:
        named = folder if folder.name == name else folder / name
        if name.strip(".") and "/" not in name and _is_folder(named) and named.resolve().is_relative_to(folder):
            return named.resolve()
    return next((folder for folder in _walk(folders) if _package_name(folder) == name), None)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError):  # too long, a null byte
        return False


def _walk(folders: Iterable[Path]) -> Iterator[Path]:
    """Folders and those in them, the nearest first, not into packages."""
    level, count = list(folders), 0
    for _ in range(_DEEPEST + 1):
        deeper: list[Path] = []
        for folder in level:
            yield folder
            count += 1
            if count > _MOST_FOLDERS:
                return
            if not (folder / "package.xml").exists():
                deeper += _subfolders(folder)
        level = deeper


def _subfolders(folder: Path) -> list[Path]:
    try:
        return sorted(Path(entry.path) for entry in os.scandir(folder) if entry.is_dir(follow_symlinks=False))
    except OSError:
        return []


def _package_name(folder: Path) -> str | None:
    """What a folder's `package.xml` says that the package is called."""
    path = folder / "package.xml"
    try:
        if not path.is_file() or path.is_symlink():
            return None
        name = load_xml(read_file(path, "package.xml", 1_000_000)).findtext("name")
    except (CEIError, OSError, ValueError):  # some other program's file
        return None
    return name and name.strip()


def _existing(folder: str, option: str) -> Path:
    path = resolved(Path(folder).expanduser(), folder)
    if not path.is_dir():
        raise CEIError(f"{option}: no such folder: {folder}.")
    return path


def _closest(path: Path) -> str:
    try:
        names = [entry.name for entry in os.scandir(path.parent)]
    except OSError:
        return ""
    same = [name for name in names if name.lower() == path.name.lower()]
    close = same or get_close_matches(path.name, names, n=1, cutoff=0.8)
    return f" Did you mean {close[0]!r}?" if close else ""
