"""Find a dataset's folder and check its version, before anything heavy is imported."""

import contextlib
from pathlib import Path
from typing import Any

from cei_converters.dataset.home import CODEBASE_VERSION, lerobot_home
from cei_converters.dataset.hub import check_repo_id
from cei_converters.dataset.metadata import METADATA_PATH
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_json

INFO_PATH = "meta/info.json"


def locate(repo_id: str, root: str | Path | None, revision: str | None = None) -> Path:
    """Folder of a v3.0 dataset: `root`, else LeRobot's cache, else downloaded from the hub; of an older one, its v3.0 copy.

    Raises:
        CEIError: there is none, or it is of another version.
    """
    if root is not None:
        folder = Path(root)
        if not (folder / INFO_PATH).is_file():
            raise CEIError(
                f"no LeRobot dataset in {folder}: {INFO_PATH} is missing; set --dataset.root to the folder "
                "that holds meta/ and data/, or leave it out to fetch --dataset.repo_id."
            )
    else:
        folder = _cached_or_downloaded(repo_id, revision)
    return _as_v30(folder)


def locate_metadata(dataset: str) -> Path:
    """Folder with what describes a dataset (`meta/info.json`, and `meta/cei.json` if it has one), given its folder or its repo id;
    nothing else is downloaded.

    Raises:
        CEIError: there is none.
    """
    for folder in (Path(dataset), lerobot_home() / dataset):
        if any((folder / path).is_file() for path in (INFO_PATH, METADATA_PATH)):
            return folder
    if Path(dataset).exists():
        raise CEIError(f"{dataset} is no LeRobot dataset: {INFO_PATH} is missing.")
    check_repo_id(dataset)
    from huggingface_hub import hf_hub_download
    from huggingface_hub.errors import EntryNotFoundError

    try:
        info = hf_hub_download(dataset, INFO_PATH, repo_type="dataset")
        with contextlib.suppress(EntryNotFoundError):  # an edited dataset has none
            hf_hub_download(dataset, METADATA_PATH, repo_type="dataset")
        return Path(info).parents[1]
    except Exception as error:  # network, authorisation, unknown names: the hub's client has no common class
        raise CEIError(
            f"no dataset {dataset!r}: it is no folder, not in {lerobot_home()}, and {INFO_PATH} could not be fetched "
            f"from the hub ({one_line(error)})."
        ) from error


def _cached_or_downloaded(repo_id: str, revision: str | None) -> Path:
    check_repo_id(repo_id)
    home = lerobot_home()
    if (home / repo_id / INFO_PATH).is_file():
        return home / repo_id
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import RevisionNotFoundError

    def download(revision: str) -> Path:
        patterns = ["meta/*", "data/*", "videos/*", "README.md", "LICENSE*", "NOTICE*"]
        cache = {"cache_dir": home / "hub", "allow_patterns": patterns}
        return Path(snapshot_download(repo_id, repo_type="dataset", revision=revision, **cache))

    try:
        try:
            return download(revision or CODEBASE_VERSION)
        except RevisionNotFoundError:
            if revision is not None:
                raise
            return download("main")  # of an older format
    except Exception as error:  # network, authorisation, unknown names: the hub's client has no common class
        raise CEIError(
            f"dataset {repo_id!r} is neither in {home} nor could it be fetched from the hub "
            f"({one_line(error)}); for a local one set --dataset.root."
        ) from error


def read_info(root: Path) -> dict[str, Any]:
    """`meta/info.json` as a dict.

    Raises:
        CEIError: it is no JSON object.
    """
    try:
        info = load_json((root / INFO_PATH).read_text())
    except (OSError, ValueError) as error:
        raise CEIError(f"{root / INFO_PATH} cannot be read: {error}.") from error
    if not isinstance(info, dict):
        raise CEIError(f"{root / INFO_PATH} should be a JSON object.")
    return info


def _as_v30(root: Path) -> Path:
    version = str(read_info(root).get("codebase_version", "unknown"))
    if version == CODEBASE_VERSION:
        return root
    from cei_converters.dataset import legacy

    if version not in legacy.VERSIONS:
        raise CEIError(
            f"{root} has codebase_version {version!r}; {CODEBASE_VERSION}, {' and '.join(legacy.VERSIONS)} are read."
        )
    return legacy.upgrade(root, version)
