"""Find a dataset's folder and check its version, before anything heavy is imported."""

from pathlib import Path

from cei_converters.hub import check_repo_id
from cei_converters.metadata import METADATA_PATH
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_json

INFO_PATH = "meta/info.json"
_V21_TO_V30 = (
    "python -m lerobot.scripts.convert_dataset_v21_to_v30 --repo-id={repo_id} --root={root} --push-to-hub=false"
)
_V20_TO_V21 = "python -m lerobot.datasets.v21.convert_dataset_v20_to_v21 --repo-id={repo_id}"


def locate(repo_id: str, root: str | Path | None, revision: str | None = None) -> Path:
    """Folder of a v3.0 dataset: `root`, else LeRobot's cache, else downloaded from the hub.

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
    _check_version(folder, repo_id)
    return folder


def locate_metadata(dataset: str) -> Path:
    """Folder with a dataset's `meta/cei.json`, given the dataset's folder or its repo id; nothing else is downloaded.

    Raises:
        CEIError: there is none.
    """
    from lerobot.utils.constants import HF_LEROBOT_HOME

    for folder in (Path(dataset), HF_LEROBOT_HOME / dataset):
        if (folder / METADATA_PATH).is_file():
            return folder
    if Path(dataset).exists():
        raise CEIError(f"{dataset} is no dataset of CEI-Gym: {METADATA_PATH} is missing.")
    check_repo_id(dataset)
    from huggingface_hub import hf_hub_download

    try:
        return Path(hf_hub_download(dataset, METADATA_PATH, repo_type="dataset")).parents[1]
    except Exception as error:  # network, authorisation, unknown names: the hub's client has no common class
        raise CEIError(
            f"no dataset {dataset!r}: it is no folder, not in {HF_LEROBOT_HOME}, and {METADATA_PATH} could not be fetched "
            f"from the hub ({one_line(error)})."
        ) from error


def _cached_or_downloaded(repo_id: str, revision: str | None) -> Path:
    from lerobot.utils.constants import HF_LEROBOT_HOME, HF_LEROBOT_HUB_CACHE

    check_repo_id(repo_id)
    if (HF_LEROBOT_HOME / repo_id / INFO_PATH).is_file():
        return HF_LEROBOT_HOME / repo_id
    from huggingface_hub import snapshot_download
    from lerobot.datasets.dataset_metadata import CODEBASE_VERSION

    try:
        return Path(
            snapshot_download(
                repo_id,
                repo_type="dataset",
                revision=revision or CODEBASE_VERSION,
                cache_dir=HF_LEROBOT_HUB_CACHE,
                allow_patterns=["meta/*", "data/*", "videos/*", "README.md"],
            )
        )
    except Exception as error:  # network, authorisation, unknown names: the hub's client has no common class
        raise CEIError(
            f"dataset {repo_id!r} is neither in {HF_LEROBOT_HOME} nor could it be fetched from the hub "
            f"({one_line(error)}); for a local one set --dataset.root."
        ) from error


def read_info(root: Path) -> dict:
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


def _check_version(root: Path, repo_id: str) -> None:
    version = str(read_info(root).get("codebase_version", "unknown"))
    if version == "v3.0":
        return
    upgrade = _V21_TO_V30.format(repo_id=repo_id, root=root)
    if version == "v2.1":
        raise CEIError(f"{root} is a v2.1 dataset, v3.0 is needed; convert it with: {upgrade}")
    if version == "v2.0":
        first = _V20_TO_V21.format(repo_id=repo_id)
        raise CEIError(
            f"{root} is a v2.0 dataset, v3.0 is needed; convert it to v2.1 with LeRobot 0.3.3 ({first}), "
            f"then with: {upgrade}"
        )
    raise CEIError(f"{root} has codebase_version {version!r}, v3.0 is needed.")
