"""What a worker does: record a task's source demonstrations; convert them for a target and replay them."""

import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cei_converters.benchmark.cells import SOURCE, VARIANTS, Cell
from cei_converters.cli import DatasetConfig, SourceConfig, parse
from cei_converters.conversion.config import ConvertConfig
from cei_converters.convert import convert
from cei_converters.dataset.metadata import METADATA_PATH, Metadata
from cei_converters.dataset.provenance import git_commit
from cei_converters.dataset.records import Records
from cei_converters.record import RecordConfig, record
from cei_converters.replay import ReplayConfig, replay
from cei_gym.errors import CEIError

# Nothing but joints is replayed, and they do not depend on the clouds that a policy would see: a third of a conversion.
JOINTS_ONLY = ("--clouds.robot_points=256", "--clouds.points=16")


def record_source(task: str, folder: Path, seeds: range, source: str = SOURCE) -> list[int]:
    """Record the source's demonstrations of a task, unless this very commit already has.

    Returns:
        Seeds that the expert failed with, which are left out.

    Raises:
        CEIError: it failed with all.
    """
    root = root_of(Cell(task, source), folder)
    if not _is_current(root):
        shutil.rmtree(root.parent, ignore_errors=True)
        record_successes(RecordConfig(f"CEI-{task}-{source}", _repo_id(root), root, len(seeds), seeds[0]))
    return sorted(set(seeds) - set(recorded_seeds(root)))


def record_successes(config: RecordConfig) -> None:
    """Record demonstrations, without those that the expert fails with.

    Raises:
        CEIError: it fails with all, or cannot be asked.
    """
    try:
        record(config)
    except CEIError:  # the expert failed; what did succeed is there
        if config.root is None or not config.root.exists():
            raise


def recorded_seeds(root: Path) -> list[int]:
    """The seeds of a recorded dataset's demonstrations."""
    return [record["seed"] for record in Records(root)]


def run_cell(
    cell: Cell,
    folder: Path,
    keep_dataset: bool,
    source: str = SOURCE,
    stock: bool = True,
    film: Path | None = None,
    perturb: int = 0,
) -> dict[str, Any]:
    """Convert the source's demonstrations and replay them; with stock physics too if the method is not varied.

    Args:
        cell: what to run.
        folder: holds the source's dataset, and the cell's own while it runs.
        keep_dataset: leave the cell's own there.
        source: whose demonstrations they are.
        stock: whether to replay with stock physics at all.
        film: MP4 of one demonstration, source and target side by side, with a contact sheet (PNG) of the same name; None for none.
        perturb: how often to replay each slightly otherwise, too.

    Returns:
        The cell's JSON but for what `Results` and the command add.

    Raises:
        CEIError: as `convert` and `replay`.
    """
    recorded, root = root_of(Cell(cell.task, source), folder), root_of(cell, folder)
    seconds: dict[str, float] = {}
    found: dict[str, Any] = {"source_seeds": recorded_seeds(recorded)}
    if root != recorded:
        shutil.rmtree(root.parent, ignore_errors=True)  # left by a run that was stopped
        options = [
            *(f"--dataset.repo_id={_repo_id(recorded)}", f"--dataset.root={recorded}", f"--target={cell.target}"),
            *(f"--new_repo_id={_repo_id(root)}", f"--new_root={root}", "--allow_unreachable", "--workers=1"),
            *(() if keep_dataset else JOINTS_ONLY),
            *VARIANTS[cell.variant],
        ]
        converted = _timed(seconds, "convert", lambda: convert(parse(ConvertConfig, options, "cei-convert", "")))
        found["alignment"] = converted["results"]
        if "verify" in converted:
            found["verify"] = converted["verify"]
    dataset = DatasetConfig(_repo_id(root), root)
    found["replay"] = _timed(
        seconds, "replay", lambda: replay(ReplayConfig(dataset, perturb=perturb, video_episodes=0))
    )
    if stock and cell.variant == "cei":
        config = ReplayConfig(dataset, stock_physics=True, video_episodes=0)
        found["stock_replay"] = _timed(seconds, "stock_replay", lambda: replay(config))
    if film is not None:
        beside = SourceConfig(_repo_id(recorded), recorded)
        replay(ReplayConfig(dataset, beside, episodes=_shown(found["replay"]), video=film, video_episodes=1))
    if root != recorded and not keep_dataset:
        shutil.rmtree(root.parent)
    return found | {"seconds": {k: round(s, 1) for k, s in seconds.items()}}


def _shown(replayed: dict[str, Any]) -> str:
    """The episode to film: the shortest that succeeds, or that there is."""
    results = replayed["results"]
    return str(min(results, key=lambda entry: (not entry["success"], entry["steps"]))["episode"])


def root_of(cell: Cell, folder: Path) -> Path:
    """A cell's dataset, in a folder of its own."""
    return folder / cell.name / "dataset"


def _repo_id(root: Path) -> str:
    return f"cei-benchmark/{root.parent.name}"


def _is_current(root: Path) -> bool:
    """Whether a recorded dataset is there and no code has changed since; one that was converted does not count."""
    commit = git_commit()
    if not (root / METADATA_PATH).exists() or (commit or "").endswith("-dirty"):
        return False
    provenance = Metadata.load(root).provenance
    return provenance.source is None and provenance.git_commit == commit


def _timed[Result](seconds: dict[str, float], name: str, call: Callable[[], Result]) -> Result:
    start = time.perf_counter()
    result = call()
    seconds[name] = time.perf_counter() - start
    return result
