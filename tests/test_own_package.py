"""A package of one's own (`examples/own_package`), built and put on the path: its solver, step, format and task are found and used.

Also what is refused: contracts that are not kept.
"""

import json
import os
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cei_converters.conversion.encode import Encode
from cei_converters.conversion.episode import Recorded
from cei_converters.conversion.gate import Gate
from cei_converters.conversion.steps import Judge, OnRecorded, Retarget
from cei_converters.dataset.cameras import Pictures
from cei_converters.dataset.columns import encode
from cei_converters.dataset.encoded import encode_episode
from cei_converters.dataset.picture_encoding import encode_pictures
from cei_converters.dataset.schema import PRIVILEGED_STATE
from cei_converters.dataset.writer import DatasetWriter, Header
from cei_converters.sources.reader import DatasetReader
from cei_envs.environment import CEIEnv
from cei_envs.experts import Expert
from cei_envs.tasks.pick_cube import PickCubeEnv
from cei_gym import plugins
from cei_gym.alignment import InitialisationOptions, Solver, SolverOptions
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.transfer import Transfer

PACKAGE = Path(__file__).parents[1] / "examples/own_package"
ROBOT, TARGET = "Panda-PandaGripper", "UR5e-PandaGripper"
FRAMES = 8


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the package is installed: its wheel, unpacked on the path."""
    folder = tmp_path_factory.mktemp("own_package")
    build = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--skip-dependency-check",
        "--outdir",
        str(folder),
    ]
    subprocess.run([*build, str(PACKAGE)], check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        file.extractall(folder / "site")
    path = [str(folder / "site"), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path)}


def run(environment: dict[str, str], *command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes in the package's own format."""
    folder, body = tmp_path_factory.mktemp("csv"), load_embodiment(ROBOT)
    (folder / "robot.txt").write_text(ROBOT)
    for episode in range(2):
        qpos = body.home + np.linspace(0, 0.1, FRAMES)[:, None] * (np.arange(len(body.home)) == episode)
        np.savetxt(folder / f"episode_{episode}.csv", qpos, delimiter=",")
    return folder


def convert(environment: dict[str, str], recordings: Path, new: Path, *options: str):
    common = [f"--dataset.root={recordings}", f"--target={TARGET}", "--init.starts=8", "--init.basins=1"]
    names = ["--dataset.repo_id=lab/csv", "--new_repo_id=me/new", f"--new_root={new}"]
    return run(environment, "-m", "cei_converters.start", "convert", *names, *common, "--allow_unreachable", *options)


def test_its_format_is_read_its_step_and_solver_are_used(
    installed: dict[str, str], recordings: Path, tmp_path: Path
) -> None:
    new = tmp_path / "new"
    result = convert(
        installed, recordings, new, "--steps=[quiet_start]", "--solver.backend=gradient", "--solver.iterations=5"
    )
    assert result.returncode == 0, result.stderr
    reader = DatasetReader("me/new", new)
    assert len(reader) == 2 and reader.embodiment.name == TARGET
    options = json.loads((new / "meta/cei.json").read_text())["provenance"]["options"]
    assert options["steps"] == ["quiet_start"] and options["solver"]["backend"] == "gradient"
    assert json.loads((new / "meta/cei.json").read_text())["provenance"]["versions"]["lab-cei"] == "0.1.0"
    for index in range(2):
        shown = reader.record(index)["source_frames"]
        assert shown[:5] == [0] * 5 and shown[-1] == FRAMES - 1
        assert len(reader.read(index)) == len(shown) >= FRAMES + 5


def test_its_task_is_recorded_by_its_expert(installed: dict[str, str], tmp_path: Path) -> None:
    root = tmp_path / "touched"
    options = ["--env=CEI-TouchCube-Panda-PandaGripper", "--episodes=1", "--repo_id=me/touched", f"--root={root}"]
    result = run(installed, "-m", "cei_converters.start", "record", *options)
    assert result.returncode == 0, result.stderr
    assert DatasetReader("me/touched", root).read(0).task == "Touch the cube."
    benchmark = ["--tasks=TouchCube", "--targets=UR5e-Inspire", "--episodes=1", "--seed=0"]
    folders = [f"--results={tmp_path / 'results'}", f"--work={tmp_path / 'work'}"]
    result = run(installed, "-m", "cei_converters.start", "benchmark.command", "replay", *benchmark, *folders)
    assert result.returncode == 0, result.stderr
    table = (tmp_path / "results/replay.md").read_text()
    assert "| TouchCube | Panda-PandaGripper (source) | 1 of 1 |" in table, table
    assert re.search(r"\| TouchCube \| UR5e-Inspire \| [01] of 1 \|", table), table
    code = "import gymnasium as gym, cei_gym; print(gym.spec('CEI-TouchCube-IIWA-Inspire').max_episode_steps)"
    assert run(installed, "-c", code).stdout.split()[-1] == "200"


def test_its_pictures_are_stored_as_the_features_are_and_said_to_be_painted(
    installed: dict[str, str], tmp_path: Path
) -> None:
    body, size = load_embodiment(ROBOT), (32, 48, 3)
    names = ["height", "width", "channels"]
    features = {
        f"observation.images.{kind}": {"dtype": kind, "shape": size, "names": names} for kind in ("image", "video")
    }
    video = "observation.images.video"
    shown = np.zeros((FRAMES, *size), np.uint8)
    shown[..., 0] = 25 * np.arange(FRAMES)[:, None, None]  # red, frame by frame more
    painted = encode_pictures(Pictures(features=features, painted=dict.fromkeys(features, shown)), 20.0, tmp_path)
    scene = Scene(np.eye(4), (), np.array([[-2.0, -2.0, -1.0], [2.0, 2.0, 2.0]]), table_z_m=-0.5)
    qpos = body.home + np.linspace(0, 2.0, FRAMES)[:, None] * (
        np.arange(len(body.home)) == 0
    )  # too fast: frames repeat
    action = np.concatenate([qpos[1:], qpos[-1:]])
    demonstration = Demonstration(ROBOT, 20.0, qpos, action, scene, "turn")
    header = Header.of(demonstration)
    with DatasetWriter("me/red", tmp_path / "red", cameras=features) as writer:
        own = encode_episode(encode(demonstration), header.features, "turn")
        for _ in range(2):
            writer.append(header, own.joined(painted))
    options = ["--dataset.repo_id=me/red", f"--dataset.root={tmp_path / 'red'}", f"--target={TARGET}"]
    new = ["--new_repo_id=me/grey", f"--new_root={tmp_path / 'grey'}", "--steps=[grey_pictures]", "--workers=3"]
    few = ["--init.starts=8", "--init.basins=1", "--allow_unreachable", "--shard_episodes=1"]  # two processes
    result = run(installed, "-m", "cei_converters.start", "convert", *options, *new, *few)
    assert result.returncode == 0, result.stderr
    assert "show the source robot, unless a step paints others: " in result.stdout and "Svt" not in result.stderr
    reader = DatasetReader("me/grey", tmp_path / "grey")
    for index in range(2):
        frames = np.array(reader.record(index)["source_frames"])
        assert reader.record(index)["painted"] == sorted(features) and len(frames) > FRAMES
        pictures = reader.pictures(index)
        expected = np.rint(0.299 * shown[frames, :, :, :1]).astype(int)
        for key, within in zip(features, (0, 3), strict=True):  # a video loses some
            assert np.abs(pictures.decode(key) - expected).max() <= within
        np.testing.assert_allclose(pictures.statistics[video]["mean"].ravel(), [expected.mean() / 255] * 3, atol=1e-3)
    card = (tmp_path / "grey/README.md").read_text()
    assert f"In 2 of 2 episodes pictures of `{video}` were painted, by steps of a package (`grey_pictures`)." in card
    assert "still show" not in card


def test_what_cuts_a_demonstration_cuts_its_pictures() -> None:
    key, feature = "observation.images.front", {"dtype": "image", "shape": (2, 2, 3)}
    pictures = Pictures(features={key: feature}).paint(key, np.zeros((FRAMES, 2, 2, 3), np.uint8))
    pictures.at(np.arange(3)).check_frames(3, repeated=True)
    with pytest.raises(CEIError, match=rf"^{key} has {FRAMES} frames, where the demonstration has 3; what cuts one"):
        pictures.check_frames(3, repeated=True)
    with pytest.raises(CEIError, match=r"^unknown camera 'left'\. Valid: observation.images.front\.$"):
        pictures.paint("left", np.zeros((FRAMES, 2, 2, 3), np.uint8))
    with pytest.raises(CEIError, match=r"is painted as float64 of shape \(8, 2, 2, 3\); it should be uint8 of shape"):
        pictures.paint(key, np.zeros((FRAMES, 2, 2, 3)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--steps=[loud_start]"],
            "unknown step 'loud_start'. Did you mean 'quiet_start'? Valid: grey_pictures, quiet_start.",
        ),
        (
            ["--solver.backend=gradients"],
            "unknown solver.backend 'gradients'. Did you mean 'gradient'? Valid: auto, numba, torch, paper, gradient.",
        ),
    ],
)
def test_what_nobody_offers_is_refused_with_what_there_is(
    options: list[str], message: str, installed: dict[str, str], recordings: Path, tmp_path: Path
) -> None:
    result = convert(installed, recordings, tmp_path / "new", *options)
    assert result.returncode and message in " ".join(result.stderr.split())
    assert not (tmp_path / "new").exists()


def test_without_the_package_its_format_is_none(recordings: Path, tmp_path: Path) -> None:
    result = convert(dict(os.environ), recordings, tmp_path / "new")
    assert result.returncode and len(result.stderr.splitlines()) == 1
    assert "meta/info.json" in result.stderr


def test_where_a_step_has_cut_a_recording_its_worst_frame_is_still_the_sources() -> None:
    body = load_embodiment(ROBOT)
    qpos = body.home + np.linspace(0, 0.4, FRAMES)[:, None] * (np.arange(len(body.home)) == 0)
    scene = Scene(np.eye(4), (), np.array([[-2.0, -2.0, -1.0], [2.0, 2.0, 2.0]]))
    whole = Demonstration(ROBOT, 20.0, qpos, qpos, scene)
    cut = whole.at(np.array([0, 0, 0, *range(FRAMES)]))
    transfer = Transfer(body, load_embodiment(TARGET), init=InitialisationOptions(starts=8, basins=1))
    made = Retarget(transfer, None, 1, False, ())(Recorded(0, 0, cut))
    judged = Judge(Gate(), True, False, False)(made)
    reader = SimpleNamespace(record=lambda index: {})
    worst = Encode(reader, TARGET, PRIVILEGED_STATE, 1, True, None)(judged).outcome.worst  # pyright: ignore
    frames = made.demonstration.source_frames
    assert frames is not None and frames[3] == 0
    for frame in range(len(made.demonstration)):
        fidelity = replace(judged.fidelity, frame=frame)
        found = Encode(reader, TARGET, PRIVILEGED_STATE, 1, True, None)(replace(judged, fidelity=fidelity))  # pyright: ignore
        np.testing.assert_array_equal(found.outcome.worst.qpos_source, qpos[frames[frame]])
    np.testing.assert_array_equal(worst.qpos_source, qpos[frames[worst.frame]])


# -- contracts ------------------------------------------------------------------------------------------------------


def test_what_lacks_a_part_is_not_made() -> None:
    class Lazy(Solver):
        def track(self, *args, **kwargs):
            raise NotImplementedError

    class Idle(OnRecorded):
        pass

    class Silent(Expert):
        def plan(self, agent_pos, environment_state):
            return np.zeros((1, 1))

    class Endless(CEIEnv):
        task, task_text, state_names = "Endless", "Go on.", ()

    for kind, missing in ((Lazy, "track_all"), (Idle, "__call__"), (Silent, "describe"), (Endless, "is_done")):
        with pytest.raises(TypeError, match=rf"abstract.*{missing}"):
            kind(None)  # pyright: ignore


def test_a_task_without_words_is_not_made() -> None:
    methods = {name: getattr(PickCubeEnv, name) for name in CEIEnv.__abstractmethods__}
    Mute = type("Mute", (CEIEnv,), {**methods, "task": "Mute", "state_names": ()})
    with pytest.raises(CEIError, match=r"^Mute has no task_text; a task says it"):
        Mute(ROBOT)


class Point:
    """An entry point."""

    def __init__(self, name: str, value: str) -> None:
        self.name, self.value = name, value

    def load(self) -> object:
        module, _, attribute = self.value.partition(":")
        return getattr(__import__(module, fromlist=[attribute]), attribute)


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch):
    def offer(*points: Point) -> None:
        monkeypatch.setattr(plugins, "found", lambda group: points)
        plugins.offered.cache_clear()

    yield offer
    plugins.offered.cache_clear()


def test_two_packages_that_offer_one_name_are_refused(offered) -> None:
    offered(Point("fast", "json:dumps"), Point("fast", "json:loads"))
    with pytest.raises(CEIError, match=r"^two packages offer 'fast' of cei_gym.solvers: .*; uninstall one\.$"):
        SolverOptions(backend="fast")


def test_what_cannot_be_imported_or_is_something_else_is_refused(offered) -> None:
    offered(Point("gone", "no_such_module:Solver"), Point("other", "json:JSONDecoder"))
    with pytest.raises(CEIError, match=r"^solver 'gone' cannot be imported from no_such_module:Solver: No module"):
        plugins.load("cei_gym.solvers", "gone", Solver, "solver")
    with pytest.raises(
        CEIError, match=r"^solver 'other', json:JSONDecoder, should be a cei_gym.alignment.solvers.solver.Solver\.$"
    ):
        plugins.load("cei_gym.solvers", "other", Solver, "solver")
