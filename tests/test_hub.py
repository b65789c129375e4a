"""Uploads, to a hub on this machine that speaks the real one's protocol."""

import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import killed
import pytest
import yaml
from hub_server import TOKEN, Hub, Refused, Repository

from cei_converters import convert, record
from cei_converters.dataset.card import write_card
from cei_converters.dataset.hub import push
from cei_converters.dataset.license import FIELDS, copy_license_files, source_license
from cei_converters.dataset.metadata import Metadata
from cei_gym.errors import CEIError

NAME = "me/out"


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    with Hub() as hub:
        monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", hub.url)
        monkeypatch.setattr("huggingface_hub.constants.HF_HUB_DISABLE_XET", True)
        monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", False)
        monkeypatch.setenv("HF_TOKEN", TOKEN)
        yield hub


@pytest.fixture(scope="module")
def source(source: Path) -> Path:
    """With a license, which its card says."""
    root = source
    card = root / "README.md"
    card.write_text(card.read_text().replace("---\n", "---\nlicense: cc-by-4.0\n", 1))
    return root


@pytest.fixture(scope="module")
def dataset(source: Path) -> Path:
    """A converted dataset."""
    root = source.with_name("converted")
    assert convert.main(killed.arguments(source, root)) == 0
    return root


def files(root: Path) -> dict[str, bytes]:
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def holds(repository: Repository, root: Path, revision: str = "main") -> bool:
    """Whether a revision holds a folder byte for byte, and no other data."""
    return {path: data for path, data in repository.files(revision).items() if path != ".gitattributes"} == files(root)


def stored(hub: Hub) -> list[str]:
    """Large files that were sent, by their hash."""
    return [asked.rpartition("/")[2] for asked in hub.log if asked.startswith("PUT")]


# -- what arrives --------------------------------------------------------------------------------------------------------


def test_the_repository_becomes_the_folder(hub: Hub, dataset: Path) -> None:
    before = files(dataset)
    assert push(dataset, NAME) == f"{hub.url}/datasets/{NAME}"
    repository = hub.repositories[NAME]
    assert holds(repository, dataset)
    assert not repository.private
    assert repository.oid("v3.0") == repository.oid("main")
    assert len(repository.titles) == 1
    assert files(dataset) == before  # nothing is left in it


def test_another_dataset_is_replaced_and_the_tag_moves(hub: Hub, dataset: Path, source: Path) -> None:
    push(source, NAME)
    repository = hub.repositories[NAME]
    first = repository.oid("v3.0")
    repository.files()["data/chunk-000/file-007.parquet"] = b"of a larger dataset"
    repository.files()["notes.md"] = b"by hand"
    push(dataset, NAME)
    assert repository.files().pop("notes.md") == b"by hand"
    assert holds(repository, dataset)
    assert first != repository.oid("v3.0") == repository.oid("main")


def test_a_branch_is_made_and_main_and_tag_stay(hub: Hub, dataset: Path, source: Path) -> None:
    push(source, NAME)
    for _ in range(2):
        assert push(dataset, NAME, branch="new/hand").endswith("/tree/new/hand")
    repository = hub.repositories[NAME]
    assert holds(repository, dataset, "new/hand")
    assert holds(repository, source)
    assert repository.oid("v3.0") == repository.oid("main")
    push(dataset, NAME, branch="main")
    assert holds(repository, dataset, "v3.0")


def test_a_pull_request_is_gone_on_with_until_it_is_closed(hub: Hub, dataset: Path, source: Path) -> None:
    push(source, NAME)
    repository = hub.repositories[NAME]
    hub.refuse = {"commit/refs": 403}
    with pytest.raises(CEIError, match="refused by the test"):
        push(dataset, NAME, pull_request=True)
    hub.refuse = {}
    for _ in range(2):
        assert push(dataset, NAME, pull_request=True) == f"{hub.url}/datasets/{NAME}/discussions/1"
    assert holds(repository, dataset, "refs/pr/1")
    assert holds(repository, source)
    assert holds(repository, source, "v3.0")
    repository.requests[0]["status"] = "closed"
    assert push(dataset, NAME, pull_request=True).endswith("/2")
    assert holds(repository, dataset, "refs/pr/2")


def test_what_is_private_stays_private(hub: Hub, dataset: Path) -> None:
    push(dataset, NAME, private=True)
    push(dataset, NAME, private=True)
    assert hub.repositories[NAME].private
    hub.repositories["me/public"] = Repository()
    with pytest.raises(CEIError, match="me/public exists and is public"):
        push(dataset, "me/public", private=True)
    assert not hub.repositories["me/public"].titles


# -- what goes wrong -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("status", "where", "message"),
    [
        (401, "", "401: Invalid username or password; run `hf auth login` or set HF_TOKEN"),
        (403, "PUT /store", "403: refused by the test; the token must be allowed to write there"),
        (
            403,
            f"POST /api/datasets/{NAME}/commit",
            "403: refused by the test; the token must be allowed to write there",
        ),
        (500, "POST /api/repos/create", "500: refused by the test"),
    ],
)
def test_what_the_hub_refuses_is_told_in_one_line(
    status: int, where: str, message: str, hub: Hub, dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = files(dataset)
    if where:
        hub.refuse = {where: status}
    else:
        monkeypatch.setenv("HF_TOKEN", "hf_wrong")
    with pytest.raises(CEIError) as refusal:
        push(dataset, NAME)
    assert (
        str(refusal.value) == f"{NAME} could not be uploaded (the hub answers {message}); the dataset is in {dataset}."
    )
    assert files(dataset) == before


def test_somebody_elses_name(hub: Hub, dataset: Path) -> None:
    with pytest.raises(CEIError, match="the hub answers 403: You don't have the rights to create"):
        push(dataset, "you/out")


def test_nobody_answers(hub: Hub, dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(CEIError, match="could not be uploaded"):
        push(dataset, NAME)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--push_to_hub", "--branch=a", "--pull_request"], "two ways not to change main; give one."),
        (["--branch=a"], "of no use without --push_to_hub"),
        (["--pull_request"], "of no use without --push_to_hub"),
    ],
)
def test_options(options: list[str], message: str, source: Path, tmp_path: Path, capsys: Any) -> None:
    assert convert.main(killed.arguments(source, tmp_path / "out", *options)) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# -- the command ---------------------------------------------------------------------------------------------------------


def test_an_upload_that_is_killed_goes_on(hub: Hub, source: Path, tmp_path: Path, capsys: Any) -> None:
    first, waiting, gone = threading.Lock(), threading.Event(), threading.Event()

    def take_one(_: int) -> None:
        if first.acquire(blocking=False):
            return
        waiting.set()
        gone.wait(60)
        raise Refused(500, "the client is gone")

    hub.before_storing = take_one
    args = killed.arguments(source, tmp_path / "out", "--push_to_hub")
    command = [sys.executable, "-m", "cei_converters.convert", *args]
    process = subprocess.Popen(command, env=os.environ | hub.environment(tmp_path / "cache"), stdout=subprocess.DEVNULL)
    try:
        assert waiting.wait(120)
        while not hub.large:  # the one that was taken is on its way
            assert process.poll() is None
    finally:
        process.kill()
        process.wait()
        gone.set()
    (arrived,) = hub.large
    assert not hub.repositories[NAME].titles  # nobody sees half a dataset
    assert (tmp_path / "out").exists()

    hub.before_storing = lambda _: None
    hub.log.clear()
    assert convert.main([*args, "--resume"]) == 0
    printed = capsys.readouterr().out
    assert "is finished; nothing is left to do but to upload it." in printed
    assert f"Uploaded to {hub.url}/datasets/{NAME}." in printed
    assert holds(hub.repositories[NAME], tmp_path / "out")
    assert hub.repositories[NAME].oid("v3.0") == hub.repositories[NAME].oid("main")
    assert stored(hub)
    assert arrived not in stored(hub)


def test_an_upload_that_is_refused_goes_on(hub: Hub, source: Path, tmp_path: Path, capsys: Any) -> None:
    args = killed.arguments(source, tmp_path / "out", "--push_to_hub", "--branch=try")
    hub.refuse = {"commit": 403}
    assert convert.main(args) == 1
    error = capsys.readouterr().err.splitlines()[-1]  # the client's progress bars are above
    assert error.startswith(f"error: {NAME} could not be uploaded (")
    assert error.endswith(f"); the dataset is in {tmp_path / 'out'}. The same command with --resume goes on.")
    hub.refuse = {}
    hub.log.clear()
    assert convert.main([*args, "--resume"]) == 0
    assert holds(hub.repositories[NAME], tmp_path / "out", "try")
    assert not stored(hub)
    assert "v3.0" not in hub.repositories[NAME].tags


def test_a_recording_goes_to_a_branch(hub: Hub, tmp_path: Path) -> None:
    root = tmp_path / "pick"
    args = ["--env=CEI-PickCube-Panda-PandaGripper", "--episodes=1", f"--repo_id={NAME}", f"--root={root}"]
    assert record.main([*args, "--branch=raw"]) == 1
    assert record.main([*args, "--push_to_hub", "--branch=raw"]) == 0
    assert holds(hub.repositories[NAME], root, "raw")
    assert "v3.0" not in hub.repositories[NAME].tags


# -- the card ------------------------------------------------------------------------------------------------------------


def test_the_card_says_what_there_is_to_know(dataset: Path) -> None:
    card = (dataset / "README.md").read_text()
    for text in (
        "UR5e-PandaGripper",
        "converted from **Panda-PandaGripper** (`me/pick`)",
        "Directional Chamfer Distance",
        "`--solver.lambda_m`",
        "| `fidelity` |",
        "![Scores of all episodes, and the worst ones](meta/quality.png)",
        "| license of the source | `cc-by-4.0` |",
        "@article{wu2026cei,",
    ):
        assert text in card
    data = yaml.safe_load(card.split("---")[1])
    assert {"LeRobot", "cross-embodiment"} <= set(data["tags"])
    assert data["license"] == "cc-by-4.0"


@pytest.mark.parametrize(
    "license",
    [
        {},
        {"license": "cc-by-4.0"},
        {"license": ["mit", "cc-by-4.0"]},
        {"license": "other", "license_name": "lab", "license_link": "https://example.org/license"},
    ],
)
def test_licenses_are_carried_over_and_never_invented(license: dict[str, Any], dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text(f"---\n{yaml.safe_dump({'tags': ['LeRobot'], **license})}---\n# A dataset\n")
    assert source_license(tmp_path) == license
    shutil.copytree(dataset / "meta", tmp_path / "meta")
    metadata = Metadata.load(dataset)
    assert metadata.provenance.source is not None
    origin = replace(metadata.provenance.source, **(dict.fromkeys(FIELDS) | license))
    replace(metadata, provenance=replace(metadata.provenance, source=origin)).save(tmp_path)
    write_card(tmp_path, NAME, Metadata.load(tmp_path))
    assert source_license(tmp_path) == license
    card = (tmp_path / "README.md").read_text()
    row = next(line for line in card.splitlines() if line.startswith("| license of the source |"))
    assert ("none is named" in row) == (not license)
    if "license_link" in license:
        assert license["license_link"] in row


def test_license_files_are_carried_over_but_no_links_to_what_is_not_the_datasets(tmp_path: Path) -> None:
    cache, root, made = tmp_path / "datasets--me--pick", tmp_path / "pick", tmp_path / "made"
    snapshot = cache / "snapshots" / "abc"
    for folder in (cache / "blobs", snapshot, root, made):
        folder.mkdir(parents=True)
    (tmp_path / "secret").write_text("secret")
    (cache / "blobs/1").write_text("its license")
    (snapshot / "LICENSE").symlink_to("../../blobs/1")  # as the hub's cache has files
    (snapshot / "NOTICE").symlink_to("../../../secret")
    (root / "LICENSE.txt").write_text("another")
    (root / "NOTICE").symlink_to(tmp_path / "secret")
    copy_license_files(snapshot, made)
    copy_license_files(root, made)
    assert {path.name: path.read_text() for path in made.iterdir()} == {
        "LICENSE": "its license",
        "LICENSE.txt": "another",
    }
