"""What `test_resume` runs in processes that it kills. A fork server imports this, so that each of them starts ready."""

import os
import tempfile
from pathlib import Path

import numpy as np

from cei_converters import convert
from cei_converters.dataset.writer import DatasetWriter
from cei_gym.demonstration import Camera, Demonstration, Scene
from cei_gym.embodiment import load_embodiment

ROBOT, EPISODES, FRAMES = "Panda-PandaGripper", 5, 6


def demonstration(index: int = 0, random: np.random.Generator | None = None) -> Demonstration:
    """A short one, with depth."""
    body, random = load_embodiment(ROBOT), random or np.random.default_rng(0)
    K = np.array([[20.0, 0.0, 4.0], [0.0, 20.0, 4.0], [0.0, 0.0, 1.0]])
    scene = Scene(np.eye(4), (Camera("front", 8, 8, K, np.eye(4)),), np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]))
    qpos = body.home + np.cumsum(random.normal(0, 0.01, (FRAMES + index, len(body.home))), axis=0)
    depth_m = {"front": random.uniform(0.2, 1.0, (len(qpos), 8, 8)).astype(np.float32)}
    return Demonstration(ROBOT, 20.0, qpos, qpos, scene, f"task {index % 2}", depth_m=depth_m)


def write_source(root: Path) -> None:
    """A small dataset with depth."""
    random = np.random.default_rng(0)
    with DatasetWriter("me/pick", root) as writer:
        for index in range(EPISODES):
            writer.add(demonstration(index, random))


def arguments(source: Path, root: Path, *more: str) -> list[str]:
    """Of `cei-convert`, a shard an episode, with few starts: the quickest that goes through everything. What more is given wins."""
    names = [
        "--dataset.repo_id=me/pick",
        f"--dataset.root={source}",
        "--target=UR5e-PandaGripper",
        "--new_repo_id=me/out",
    ]
    quick = ["--init.starts=8", "--init.basins=1", "--shard_episodes=1", "--allow_unreachable", "--workers=1"]
    given = {option.partition("=")[0] for option in more}
    return [*names, f"--new_root={root}", *(o for o in quick if o.partition("=")[0] not in given), *more]


def run(args: list[str], log: Path) -> None:
    """`cei-convert`, what it prints in a file."""
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1)
    os.dup2(file, 2)
    raise SystemExit(convert.main(args))


def _warm_up() -> None:
    with tempfile.TemporaryDirectory() as folder:
        write_source(Path(folder, "source"))
        convert.main(arguments(Path(folder, "source"), Path(folder, "out")))


if __name__ == "killed" and os.environ.get("CEI_WARM"):
    _warm_up()
