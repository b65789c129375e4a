"""Upload a finished dataset, its own card included."""

import contextlib
from pathlib import Path

from cei_gym.errors import CEIError, one_line


def check_repo_id(repo_id: str) -> None:
    """Check a dataset's name.

    Raises:
        CEIError: it is not `<user>/<name>`.
    """
    from huggingface_hub.errors import HFValidationError
    from huggingface_hub.utils import validate_repo_id

    try:
        validate_repo_id(repo_id)
    except HFValidationError as error:
        raise CEIError(f"dataset name {repo_id!r} should read <user>/<name>: {one_line(error)}") from error


def check_login() -> None:
    """Check that an upload could be authorised.

    Raises:
        CEIError: there is no token.
    """
    from huggingface_hub import get_token

    if get_token() is None:
        raise CEIError("--push_to_hub needs a login; run `hf auth login` or set HF_TOKEN.")


def push(root: Path, repo_id: str, *, private: bool = False) -> None:
    """Upload a dataset and tag it with LeRobot's format version.

    `LeRobotDataset.push_to_hub` would replace our card with its template and an invented license.

    Raises:
        CEIError: the hub refused; the local dataset stays.
    """
    from huggingface_hub import HfApi
    from huggingface_hub.errors import HfHubHTTPError, RevisionNotFoundError
    from lerobot.datasets.dataset_metadata import CODEBASE_VERSION

    api = HfApi()
    try:
        api.create_repo(repo_id, repo_type="dataset", private=private, exist_ok=True)
        api.upload_folder(repo_id=repo_id, folder_path=root, repo_type="dataset")
        # LeRobot loads this tag, so it has to move to what was just uploaded
        with contextlib.suppress(RevisionNotFoundError):
            api.delete_tag(repo_id, tag=CODEBASE_VERSION, repo_type="dataset")
        api.create_tag(repo_id, tag=CODEBASE_VERSION, repo_type="dataset")
    except (HfHubHTTPError, OSError) as error:
        raise CEIError(f"{repo_id} could not be uploaded ({one_line(error)}); the dataset is in {root}.") from error
