"""The formats that demonstrations come in: which one a path holds."""

from itertools import islice
from pathlib import Path
from typing import Any, NoReturn

from cei_converters.dataset import schema
from cei_converters.dataset.locate import INFO_PATH
from cei_converters.sources.calibration import Calibration
from cei_converters.sources.joint_map import load_joint_map
from cei_converters.sources.recording import Recordings
from cei_converters.sources.source import Source
from cei_gym import plugins
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line


def open_source(
    repo_id: str,
    root: str | Path | None = None,
    *,
    embodiment: str | None = None,
    T_world_base: Array | None = None,
    calibration: Calibration | None = None,
    joint_map: str | Path | None = None,
    joints_only: bool = False,
) -> Source:
    """Open recorded episodes of any format that is read.

    A package reads formats of its own by an entry point of the group `cei_gym.sources`.

    Args:
        repo_id: name of the dataset.
        root: its folder or file; default: LeRobot's cache, else the hub.
        embodiment: of a dataset that does not say it, nor its joint map.
        T_world_base: (4, 4) base pose for such a dataset; default: identity.
        calibration: of its depth cameras.
        joint_map: YAML that tells which of its columns are which joints.
        joints_only: whether nothing that cameras saw is read, so that they need no calibration.

    Raises:
        CEIError: whatever is wrong with it, in one line.
    """
    mapped = None if joint_map is None else load_joint_map(joint_map)
    if mapped is not None and embodiment is not None and mapped.embodiment not in (None, embodiment):
        raise CEIError(f"{joint_map} is a map of {mapped.embodiment}, not of {embodiment}; leave --source out.")
    options: dict[str, Any] = {
        "embodiment": embodiment or (mapped and mapped.embodiment),
        "T_world_base": T_world_base,
        "calibration": calibration,
        "joint_map": mapped,
    }
    kind = format_of(root)
    if kind not in (LEROBOT, HDF5, ZARR):
        source = _load(kind)(repo_id, str(root), **options)
        if lacking := [name for name in _SAID if not hasattr(source, name)]:
            raise CEIError(f"source {kind!r} does not say {', '.join(lacking)}, which a Source says of its dataset.")
        return source
    if kind == HDF5:
        from cei_converters.sources.robomimic import RobomimicSource

        return RobomimicSource(repo_id, str(root), **options)
    if kind == ZARR:
        from cei_converters.sources.zarr_source import ZarrSource

        return ZarrSource(repo_id, str(root), **options)
    from cei_converters.sources.reader import DatasetReader

    return DatasetReader(repo_id, root, **options, joints_only=joints_only)


def find_root(repo_id: str, root: str | Path | None = None) -> Path:
    """The folder or file that `open_source` reads: of LeRobot's formats the v3.0 folder, be it the cache's or a copy.

    Raises:
        CEIError: there is none.
    """
    if root is not None and format_of(root) != LEROBOT:
        return Path(root)
    from cei_converters.dataset.locate import locate

    return locate(repo_id, root)


def read_recordings(
    repo_id: str, root: str | Path | None, most: int, state: str = schema.STATE, action: str | None = schema.ACTION
) -> Recordings:
    """Columns of some episodes, spread over the dataset; of LeRobot's formats, HDF5 or zarr.

    Args:
        repo_id, root: see `open_source`.
        most: how many episodes to read.
        state, action: LeRobot's features to look at.

    Raises:
        CEIError: it cannot be read, or has no features to choose.
    """
    kind = format_of(root)
    if kind != LEROBOT and (state != schema.STATE or action not in (None, schema.ACTION)):
        raise CEIError(f"{root} has none of LeRobot's features to look at; leave out --state and --action.")
    if kind not in (LEROBOT, HDF5, ZARR):
        raise CEIError(f"{root} is read by {kind!r} of an installed package, which says itself what its columns are.")
    if kind == HDF5:
        from cei_converters.sources.robomimic_file import recordings

        return recordings(Path(str(root)), most)
    if kind == ZARR:
        from cei_converters.sources.zarr_source import recordings

        return recordings(Path(str(root)), most)
    from cei_converters.sources.reader import recordings

    return recordings(repo_id, root, most, state, action)


GROUP = "cei_gym.sources"
"""Entry points of formats that packages read: each a `Source` with `recognises`, made with the arguments of `open_source`."""
LEROBOT, HDF5, ZARR = "LeRobot", "HDF5", "zarr"
_SAID = ("repo_id", "root", "embodiment", "scene", "fps", "carried", "dropped")
_HDF5_SUFFIXES = (".hdf5", ".h5", ".hdf")
_PACKED = (".zip", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".7z", ".zst")
_MARKS = (".zgroup", "zarr.json")
_FEW = 100  # entries of a folder that are looked at


def format_of(root: str | Path | None) -> str:
    """Which format a path holds; LeRobot's where it is its own business to say what is missing.

    Raises:
        CEIError: it holds none, but what it holds, or what is near it, says what was meant.
    """
    if root is None:
        return LEROBOT
    path = Path(root)
    if path.is_file() and (path.suffix.lower() in _HDF5_SUFFIXES or _starts_as_hdf5(path)):
        return HDF5
    if any((path / mark).is_file() for mark in _MARKS):
        return ZARR
    if path.exists() and not (path / INFO_PATH).is_file() and (offered := _offered(path)) is not None:
        return offered
    if path.is_file():
        _refuse_file(path)
    if path.is_dir() and not (path / INFO_PATH).is_file():
        _refuse_folder(path)
    return LEROBOT


def _offered(path: Path) -> str | None:
    """The name of an installed package's format that a path is in, if any; ours come first."""
    return next((name for name in plugins.offered(GROUP) if _load(name).recognises(path)), None)


def _load(name: str) -> Any:
    return plugins.load(GROUP, name, Source, "source")


def _refuse_file(path: Path) -> NoReturn:
    """Say what a file is that is no dataset.

    Raises:
        CEIError: always.
    """
    if path.suffix.lower() in _PACKED:
        raise CEIError(f"{path} is packed; unpack it, and give --dataset.root the folder or file that comes out.")
    for folder in (path.parent, *path.parent.parents):
        if (folder / INFO_PATH).is_file() or any((folder / mark).is_file() for mark in _MARKS):
            raise CEIError(f"{path} is a file of a dataset; give --dataset.root the dataset's folder, {folder}.")
    raise CEIError(
        f"{path} is of no format that is read: folders of LeRobot, HDF5 of robosuite and robomimic, zarr of DP3 and DemoGen."
        + (f" And what installed packages read: {', '.join(names)}." if (names := plugins.offered(GROUP)) else "")
    )


def _refuse_folder(path: Path) -> None:
    """Say which of the things in a folder, or above it, was meant.

    Raises:
        CEIError: there is one.
    """
    try:
        inside = sorted(entry for entry in islice(path.iterdir(), _FEW) if not entry.name.startswith("."))
    except OSError as error:
        raise CEIError(f"{path} cannot be read: {one_line(error)}.") from error
    files = [entry for entry in inside if entry.is_file() and entry.suffix.lower() in _HDF5_SUFFIXES]
    folders = [
        entry
        for entry in inside
        if entry.is_dir() and ((entry / INFO_PATH).is_file() or any((entry / mark).is_file() for mark in _MARKS))
    ]
    above = [
        folder
        for folder in path.absolute().parents
        if (folder / INFO_PATH).is_file() or any((folder / mark).is_file() for mark in _MARKS)
    ]
    if meant := [*files, *folders, *above[:1]]:
        others = f" (or {', '.join(entry.name for entry in meant[1:4])})" if len(meant) > 1 else ""
        raise CEIError(f"{path} is a folder, and no dataset by itself; give --dataset.root={meant[0]}{others}.")


def _starts_as_hdf5(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(8) == b"\x89HDF\r\n\x1a\n"
    except OSError:
        return False
