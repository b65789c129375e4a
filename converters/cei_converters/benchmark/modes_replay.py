"""Replaying the same demonstrations in both motions, and how far the hands of the two are turned from each other."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cei_converters.benchmark.cells import Cell
from cei_converters.benchmark.jobs import JOINTS_ONLY, record_source, recorded_seeds, root_of
from cei_converters.benchmark.modes_stages import PATTERNS, TASK, TWO_MODES
from cei_converters.benchmark.policy_stages import repo_id
from cei_converters.benchmark.real_tasks import GRIPPER, HAND
from cei_converters.cli import DatasetConfig, parse
from cei_converters.conversion.config import ConvertConfig
from cei_converters.convert import convert
from cei_converters.replay import ReplayConfig, replay
from cei_converters.simulation.stage import Stage
from cei_converters.sources.reader import DatasetReader
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.kinematics import KinematicTree

NAME, PICTURE = "modes_replay.json", "modes.png"
BOTH = ("pattern_1", "pattern_2")
MOMENTS = ("start", "midway", "end")
_ENLARGED = 2


def settings(seeds: range) -> dict[str, Any]:
    """What a finished replay must have been made with to count."""
    return {"task": TASK, "source": GRIPPER, "target": HAND, "seeds": [seeds[0], seeds[-1]], "options": [*TWO_MODES]}


def replay_modes(seeds: range, work: Path, picture: Path) -> dict[str, Any]:
    """Record demonstrations, convert them to each motion, replay them; draw one in the middle of its pull in both.

    Args:
        seeds: of the demonstrations.
        work: folder for datasets.
        picture: PNG to write.

    Returns:
        `source_seeds`, those that the expert succeeds with; `patterns`, the replay of each; `angles_deg`, (n, 3) between the hands of the two, at
        `MOMENTS` of each demonstration.

    Raises:
        CEIError: as `convert` and `replay`; there is only one motion.
    """
    record_source(TASK, work, seeds, GRIPPER)
    recorded = root_of(Cell(TASK, GRIPPER), work)
    readers = {pattern: _converted(recorded, work, pattern) for pattern in BOTH}
    found = {
        pattern: replay(ReplayConfig(DatasetConfig(reader.repo_id, reader.root), video_episodes=0))
        for pattern, reader in readers.items()
    }
    kept = ("env", "embodiment", "episodes", "successes", "failures", "results")
    patterns = {pattern: {name: result[name] for name in kept} for pattern, result in found.items()}
    both = [
        all(entry["success"] for entry in entries)
        for entries in zip(*(result["results"] for result in found.values()), strict=True)
    ]
    seeds_of = recorded_seeds(recorded)
    shown = both.index(True) if True in both else 0
    _draw(list(readers.values()), shown, seeds_of[shown], picture)
    angles = [_angles_deg(*(reader.read(i, clouds=False) for reader in readers.values())) for i in range(len(both))]
    return {"source_seeds": seeds_of, "patterns": patterns, "angles_deg": np.round(angles, 1).tolist()}


def _converted(recorded: Path, work: Path, pattern: str) -> DatasetReader:
    """The demonstrations in one motion, made anew."""
    root = work / f"modes-{pattern}"
    shutil.rmtree(root, ignore_errors=True)
    options = [
        *(f"--dataset.repo_id={repo_id(recorded.parent)}", f"--dataset.root={recorded}", f"--target={HAND}"),
        *(f"--new_repo_id={repo_id(root)}", f"--new_root={root}", "--allow_unreachable", *JOINTS_ONLY),
        *(*TWO_MODES, *PATTERNS[pattern]),
    ]
    convert(parse(ConvertConfig, options, "cei-convert", ""))
    return DatasetReader(repo_id(root), root)


def _angles_deg(one: Demonstration, other: Demonstration) -> list[float]:
    """By how much the hands of two motions of a demonstration are turned from each other, at `MOMENTS`."""
    embodiment = load_embodiment(HAND)
    tree = KinematicTree(embodiment)

    def hands(made: Demonstration) -> Rotation:
        moments = [0, (len(made) - 1) // 2, len(made) - 1]
        return Rotation.from_matrix(tree.forward(made.qpos[moments])[:, embodiment.end_effector_root, :3, :3])

    return np.degrees((hands(one) * hands(other).inv()).magnitude()).tolist()


def _draw(readers: list[DatasetReader], episode: int, seed: int, path: Path) -> None:
    """Both motions of an episode, which is of a seed, replayed, when the source had half opened the drawer."""
    from PIL import Image

    from cei_converters.cli.outputs import PICTURE as PNG
    from cei_converters.cli.outputs import Outputs
    from cei_converters.simulation.video import side_by_side

    views: list[list[Array]] = []
    with Stage(f"CEI-{TASK}-{HAND}") as stage:
        for reader in readers:
            made = reader.read(episode, clouds=False)
            pictures = stage.play(made, filmed=True)[1]
            shown = pictures[min(_half_open(made), len(pictures) - 1)]
            views.append([np.repeat(np.repeat(shown, _ENLARGED, axis=0), _ENLARGED, axis=1)])
    labels = [f"{pattern.replace('_', ' ')}, seed {seed}, the drawer half open" for pattern in BOTH]
    file = Outputs().file("the picture", path, PNG)
    assert file is not None
    with file.whole() as partial:
        Image.fromarray(side_by_side(views, labels)[0]).save(partial, format="PNG")


def _half_open(made: Demonstration) -> int:
    """The first frame in which the source had opened the drawer half as far as it does."""
    assert made.environment_state is not None
    opening_m = made.environment_state[:, made.environment_state_names.index("drawer.opening_m")]
    return int((opening_m >= opening_m.max() / 2).argmax())
