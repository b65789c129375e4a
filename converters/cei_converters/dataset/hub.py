"""Upload a finished dataset, its own card included."""

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from cei_converters.dataset.home import CODEBASE_VERSION
from cei_gym.errors import CEIError, one_line

if TYPE_CHECKING:
    from huggingface_hub import Discussion, HfApi

_MAIN = "main"
_TITLE = "Upload a dataset with CEI-Gym"
_ABOUT = "How it was made is in its card, README.md."
_RIGHT = {401: "; run `hf auth login` or set HF_TOKEN", 403: "; the token must be allowed to write there"}
_DATA = ["data/*", "meta/*", "videos/*", "images/*"]  # what is left of an older dataset here goes


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


def check_destination(push_to_hub: bool, private: bool, branch: str | None, pull_request: bool) -> None:
    """Check options of an upload, and that it could be authorised.

    Raises:
        CEIError: they make no sense together, or there is no token.
    """
    if branch is not None and pull_request:
        raise CEIError("--branch and --pull_request are two ways not to change main; give one.")
    if (private or branch is not None or pull_request) and not push_to_hub:
        raise CEIError("--private, --branch and --pull_request are of no use without --push_to_hub.")
    if push_to_hub:
        check_login()


def push(
    root: Path, repo_id: str, *, private: bool = False, branch: str | None = None, pull_request: bool = False
) -> str:
    """Upload a dataset, so that the repository holds it and no data of another; on main, tag it with LeRobot's format version.

    An upload that was interrupted goes on when it is repeated: large files are stored by their content before the commit
    that refers to them, and those that have arrived are not sent again. (`upload_large_folder` would commit parts of a
    dataset as it goes, make no pull requests, and leave its own files in the folder; `LeRobotDataset.push_to_hub` would
    replace our card with its template and an invented license.)

    Args:
        root: the dataset's folder.
        repo_id: its name, `<user>/<name>`; made if there is none.
        private: make it private.
        branch: upload to this branch instead of main; made from main if there is none.
        pull_request: upload to a pull request instead, the one that an interrupted upload has begun or a new one.

    Returns:
        Where to see it.

    Raises:
        CEIError: the hub refused, or a private dataset would become public; the local dataset stays.
    """
    from huggingface_hub import HfApi

    api = HfApi()
    try:
        url = api.create_repo(repo_id, repo_type="dataset", private=private or None, exist_ok=True)
        if private and not api.dataset_info(repo_id).private:
            raise CEIError(
                f"{repo_id} exists and is public; make it private first, leave out --private, or choose a name."
            )
        revision = branch or _MAIN
        if branch is not None and branch != _MAIN:
            api.create_branch(repo_id, branch=branch, repo_type="dataset", exist_ok=True)
            url = f"{url}/tree/{branch}"
        if pull_request:
            request = _pull_request(api, repo_id)
            revision, url = str(request.git_reference), request.url
        api.upload_folder(
            repo_id=repo_id,
            folder_path=root,
            repo_type="dataset",
            revision=revision,
            commit_message=_TITLE,
            delete_patterns=_DATA,
        )
        if revision == _MAIN:
            _tag(api, repo_id)
    except CEIError:
        raise
    except Exception as error:  # network, authorisation, quota: the hub's client has no common class
        raise CEIError(f"{repo_id} could not be uploaded ({_reason(error)}); the dataset is in {root}.") from error
    return str(url)


def _reason(error: Exception) -> str:
    """Why an upload failed, on one line, and what would be right if it was refused."""
    from huggingface_hub.errors import HfHubHTTPError

    if isinstance(error, RuntimeError) and isinstance(error.__cause__, Exception):  # of a thread that sent a file
        error = error.__cause__
    if not isinstance(error, HfHubHTTPError):
        return one_line(error)
    status = error.response.status_code
    return f"the hub answers {status}: {one_line(error.server_message or error).rstrip('.')}" + _RIGHT.get(status, "")


def _pull_request(api: "HfApi", repo_id: str) -> "Discussion":
    """Ours that is neither merged nor closed yet, or a new one: the hub makes it a draft."""
    me = api.whoami()["name"]
    ours = api.get_repo_discussions(repo_id, author=me, discussion_type="pull_request", repo_type="dataset")
    for request in ours:
        if request.title == _TITLE and request.status in ("draft", "open"):
            return request
    return api.create_pull_request(repo_id, title=_TITLE, description=_ABOUT, repo_type="dataset")


def _tag(api: "HfApi", repo_id: str) -> None:
    """Move the tag that LeRobot loads to what was just uploaded."""
    from huggingface_hub.errors import RevisionNotFoundError

    with contextlib.suppress(RevisionNotFoundError):
        api.delete_tag(repo_id, tag=CODEBASE_VERSION, repo_type="dataset")
    api.create_tag(repo_id, tag=CODEBASE_VERSION, repo_type="dataset")
