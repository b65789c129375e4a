"""Where a robot description lives: `package://` names and safe paths inside one folder."""

from importlib.util import find_spec
from pathlib import Path

from cei_gym.errors import CEIError

SCHEME = "package://"


def package_root(package: str) -> Path:
    """Folder of an installed Python package, found without importing it."""
    if not package.isidentifier():  # of a dotted name, find_spec would import the first part
        raise CEIError(f"a description reads {SCHEME}<python package>/<path>; {package[:60]!r} is no package's name.")
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise CEIError(
            f"package {package!r} is not installed; its robot descriptions are needed: pip install {package}."
        )
    return Path(next(iter(spec.submodule_search_locations)))


def resolve(uri: str, relative_to: Path) -> tuple[Path, Path]:
    """Resolve a description's address.

    Args:
        uri: `package://<python package>/<path>`, or a path relative to `relative_to`.
        relative_to: folder of the file that names the address.

    Returns:
        The file, and the folder that it and its meshes must stay inside.

    Raises:
        CEIError: the package is not installed, the file is missing, or it lies outside its package.
    """
    if uri.startswith(SCHEME):
        package, _, inside = uri.removeprefix(SCHEME).partition("/")
        root = package_root(package)
        path = within(root, root / inside, uri)
    else:
        path = _resolved(relative_to / uri, uri)
        root = path.parent
    if not path.is_file():
        raise CEIError(f"no robot description at {uri!r} (looked for {path.name} in {path.parent}).")
    return path, root


def within(root: Path, path: Path, what: str) -> Path:
    """`path` resolved, refused if it leaves `root` or is there but no file (a description is untrusted input)."""
    resolved = _resolved(path, what)
    if not resolved.is_relative_to(root.resolve()):
        raise CEIError(f"{what!r} points outside its folder {root.name!r}; only files inside it are read.")
    if resolved.exists() and not resolved.is_file():
        raise CEIError(f"{what!r} is no file.")
    return resolved


def _resolved(path: Path, what: str) -> Path:
    try:
        resolved = path.resolve()
        resolved.exists()
    except (OSError, RuntimeError, ValueError) as error:  # too long, a loop of links, a null byte
        raise CEIError(f"{what[:60]!r} is no path to a file: {str(error)[:60]}.") from error
    return resolved
