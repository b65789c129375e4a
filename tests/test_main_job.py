"""The main job through the commands themselves: record, convert, replay, and what they leave behind."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from conversions import record_cubes
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.envs.factory import make_env_pre_post_processors

from cei_converters import convert, pads, record, replay
from cei_converters.dataset.metadata import Metadata
from cei_converters.dataset.records import Records
from cei_converters.dataset.starts import find_starts
from cei_converters.simulation.environment import open_environment
from cei_converters.sources.reader import DatasetReader
from cei_envs.rollout import NEW_ROLLOUT
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.pointcloud import CloudOptions, CloudSynthesiser, frame_points
from cei_gym.wrapper import CrossEmbodimentWrapper
from lerobot_env_cei import CEIEnvConfig
from lerobot_policy_dp3 import DP3Config

SOURCE, TARGET = "Panda-PandaGripper", "IIWA-Inspire"
EPISODES = 2


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recorded and a converted dataset, their JSON results, and a replay."""
    folder = tmp_path_factory.mktemp("job")
    record_cubes(folder / "source", EPISODES, 3, f"--json={folder / 'record.json'}")
    assert convert.main([*source_options(folder), *target_options(folder), f"--json={folder / 'convert.json'}"]) == 0
    options = ["--dataset.repo_id=me/target", f"--dataset.root={folder / 'target'}", f"--json={folder / 'replay.json'}"]
    beside = ["--source.repo_id=me/source", f"--source.root={folder / 'source'}"]
    video = [f"--video={folder / 'film.mp4'}", "--video_episodes=1"]
    assert replay.main([*options, *beside, *video]) == 0
    return folder


def source_options(folder: Path) -> list[str]:
    return ["--dataset.repo_id=me/source", f"--dataset.root={folder / 'source'}"]


def target_options(folder: Path, name: str = "target") -> list[str]:
    return [f"--target={TARGET}", f"--new_repo_id=me/{name}", f"--new_root={folder / name}"]


def result(job: Path, name: str) -> dict:
    return json.loads((job / f"{name}.json").read_text())


def test_the_transferred_demonstrations_lift_the_cube_in_physics(job: Path) -> None:
    replayed = result(job, "replay")
    assert replayed["episodes"] == len(replayed["results"]) == EPISODES
    assert replayed["successes"] == EPISODES
    assert replayed["env"] == f"CEI-PickCube-{TARGET}"


def test_the_recorded_demonstrations_replay_to_the_frame(job: Path, tmp_path: Path) -> None:
    options = [*source_options(job), "--video_episodes=0", f"--json={tmp_path / 'r.json'}"]
    assert replay.main(options) == 0
    replayed = json.loads((tmp_path / "r.json").read_text())
    assert replayed["successes"] == EPISODES
    assert [entry["steps"] for entry in replayed["results"]] == [entry["frames"] for entry in replayed["results"]]


def test_states_and_actions_fit_the_target_and_its_limits(job: Path) -> None:
    source, target = (DatasetReader(f"me/{n}", job / n) for n in ("source", "target"))
    embodiment = load_embodiment(TARGET)
    assert target.embodiment.name == TARGET
    for i in range(EPISODES):
        before, after = source.read(i), target.read(i)
        before = before.at(
            np.array(target.record(i).get("source_frames", range(len(before))))
        )  # the target may take longer
        assert len(before) == len(after)
        for values in (after.qpos, after.action):
            assert values.shape[1] == len(embodiment.joint_names)
            assert np.all(values >= embodiment.lower - 1e-5)
            assert np.all(values <= embodiment.upper + 1e-5)
        assert after.environment_state is not None
        np.testing.assert_array_equal(after.environment_state, before.environment_state)
        assert after.point_cloud_world is not None
        assert after.point_cloud_world.shape == (len(after), 1024, 3)


def test_the_cube_stays_in_the_synthesised_cloud_and_the_source_robot_does_not(job: Path) -> None:
    before, after = (
        DatasetReader("me/source", job / "source").read(0),
        DatasetReader("me/target", job / "target").read(0),
    )
    assert after.point_cloud_world is not None
    assert before.environment_state is not None
    cube = before.environment_state[0, :3]
    near = np.linalg.norm(after.point_cloud_world[0] - cube, axis=1) < 0.04
    assert near.sum() >= 5
    assert after.depth_m == {}


def test_the_same_conversion_makes_the_same_dataset_with_any_number_of_workers(job: Path) -> None:
    assert convert.main([*source_options(job), *target_options(job, "serial"), "--workers=1"]) == 0
    one, more = (DatasetReader("me/any", job / name) for name in ("serial", "target"))
    for i in range(EPISODES):
        before, after = one.read(i), more.read(i)
        np.testing.assert_array_equal(after.qpos, before.qpos)
        np.testing.assert_array_equal(after.action, before.action)
        np.testing.assert_array_equal(after.point_cloud_world, before.point_cloud_world)


@pytest.fixture(scope="module")
def coloured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A demonstration seen by two noisy cameras, in colour."""
    root = tmp_path_factory.mktemp("colours") / "coloured"
    record_cubes(root, 1, 3, "--colours", "--cameras=[front,left]", "--depth_noise=kinect")
    return root


def live(reader: DatasetReader, wrapped: bool = False):
    """The environment of a dataset as its first episode goes, step by step: the environment, and its observation."""
    recorded, made = reader.read(0), reader.metadata.environment if reader.metadata else None
    assert made is not None and made.id is not None and recorded.environment_state is not None
    env = gym.make(made.id, **made.kwargs)
    env = CrossEmbodimentWrapper(env) if wrapped else env
    start = {"agent_pos": recorded.qpos[0], "environment_state": recorded.environment_state[0]}
    observation, _ = env.reset(seed=reader.record(0)["seed"], options=start)
    for action in recorded.action:
        yield env, observation
        observation, *_ = env.step(action.astype(np.float32))
    env.close()


def test_what_cei_convert_has_stored_is_what_its_steps_make_of_live_images(coloured: Path, tmp_path: Path) -> None:
    """Bit for bit: noise, colours, millimetres, mask, samples and thinning, across two datasets on disk."""
    root = tmp_path / "target"
    options = ["--dataset.repo_id=me/coloured", f"--dataset.root={coloured}", f"--target={TARGET}"]
    assert convert.main([*options, "--new_repo_id=me/target", f"--new_root={root}", "--transfer.stretch=1"]) == 0
    source, stored = DatasetReader("me/coloured", coloured), DatasetReader("me/target", root).read(0)
    steps = CloudSynthesiser(source.embodiment, load_embodiment(TARGET))
    shown = []
    for t, (env, observation) in enumerate(live(source)):
        images, pictures = env.get_wrapper_attr("depth_m")(), env.get_wrapper_attr("rgb")()
        points = frame_points(source.scene, images, pictures, None, colours=True)
        assert points is not None
        kept = steps.remove(points, source.scene, observation["agent_pos"].astype(float))
        shown.append(steps.add(kept, stored.scene, stored.qpos[t]))
    assert stored.point_cloud_world is not None
    np.testing.assert_array_equal(np.stack(shown), stored.point_cloud_world)


def test_the_wrapper_shows_what_these_steps_make(coloured: Path) -> None:
    """Bit for bit, of a dataset's depth on disk and of the same episode live."""
    reader = DatasetReader("me/coloured", coloured)
    recorded, steps = reader.read(0), CloudSynthesiser(reader.embodiment, reader.embodiment)
    shown = [observation["point_cloud"] for _, observation in live(reader, wrapped=True)]
    expected = []
    for t, qpos in enumerate(recorded.qpos):
        images, pictures = ({name: each[t] for name, each in of.items()} for of in (recorded.depth_m, recorded.rgb))
        points = frame_points(reader.scene, images, pictures, None, colours=True)
        assert points is not None
        expected.append(steps.add(steps.remove(points, reader.scene, qpos), reader.scene, qpos))
    assert expected[0].shape == (1024, 6)
    np.testing.assert_array_equal(np.stack(shown), np.stack(expected))


def test_colours_are_converted_and_pictures_pass_through(coloured: Path) -> None:
    root = coloured.with_name("target")
    options = ["--dataset.repo_id=me/coloured", f"--dataset.root={coloured}", f"--target={TARGET}"]
    assert convert.main([*options, "--new_repo_id=me/target", f"--new_root={root}"]) == 0
    before, after = (DatasetReader("me/any", folder) for folder in (coloured, root))
    assert set(before.cameras) == set(after.cameras) == {"observation.images.front", "observation.images.left"}
    cloud = after.read(0).point_cloud_world
    assert cloud is not None
    assert cloud.shape[1:] == (1024, 6)
    cube = before.read(0).environment_state[0, :3]
    red = cloud[0][np.linalg.norm(cloud[0, :, :3] - cube, axis=1) < 0.03][:, 3:]
    assert len(red) > 5
    assert np.median(red[:, 0] - red[:, 1:].max(axis=1)) > 0.1  # robosuite's cube is red


@pytest.mark.parametrize("clouds", [[], ["--clouds.points=300", "--clouds.tau_m=0.01", "--clouds.colours=false"]])
def test_lerobots_environment_is_the_datasets_own(coloured: Path, clouds: list[str]) -> None:
    """Cameras, noise, options of clouds, start: all as the dataset has them."""
    root = coloured.with_name(f"own-{len(clouds)}")
    options = ["--dataset.repo_id=me/coloured", f"--dataset.root={coloured}", f"--target={TARGET}", *clouds]
    assert convert.main([*options, "--new_repo_id=me/own", f"--new_root={root}"]) == 0
    stored = DatasetReader("me/own", root).read(0)
    config = CEIEnvConfig(dataset=str(root), render=False)
    assert config.task == f"PickCube-{TARGET}"
    vector = config.create_envs(1)["cei"][0]
    own, _ = vector.reset(seed=[3], options={NEW_ROLLOUT: True})
    assert np.abs(own["agent_pos"][0] - stored.qpos[0]).max() < 0.1  # noise of the start
    assert np.abs(load_embodiment(TARGET).home - stored.qpos[0]).max() > 0.3
    assert stored.point_cloud_world is not None
    assert stored.point_cloud_world[0].shape == own["point_cloud"][0].shape == config.features["point_cloud"].shape
    given = {"observation.point_cloud": torch.from_numpy(own["point_cloud"])}
    before, _ = make_env_pre_post_processors(config, DP3Config(device="cpu"))  # policies see it as the dataset has it
    lies = LeRobotDataset("me/own", root).features["observation.point_cloud"]["shape"]
    assert before(given)["observation.point_cloud"].shape == (1, *lies) == (1, own["point_cloud"][0].size)
    seen = vector.envs[0].get_wrapper_attr("scene")
    for camera, other in zip(seen.cameras, stored.scene.cameras, strict=True):
        np.testing.assert_allclose(camera.T_world_camera, other.T_world_camera)
    wrapper = vector.envs[0].env
    assert isinstance(wrapper, CrossEmbodimentWrapper)
    assert wrapper.clouds == CloudOptions(**({"points": 300, "tau_m": 0.01, "colours": False} if clouds else {}))
    vector.close()
    # Recorded clouds are the cameras' own, and so are those of an environment that is made like theirs.
    assert CEIEnvConfig(dataset=str(coloured)).augment is False


def test_bad_datasets_of_lerobots_environment_get_one_line(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    with pytest.raises(CEIError, match=rf"^--env.task=StackCube-{TARGET}, but dataset .* is of PickCube-{TARGET}"):
        CEIEnvConfig(dataset=str(job / "target"), task=f"StackCube-{TARGET}")
    with pytest.raises(CEIError, match=r"^give --env.dataset, what the policy was trained on, or --env.task="):
        CEIEnvConfig()
    with pytest.raises(CEIError, match=r"is no LeRobot dataset: meta/info.json is missing\.$"):
        CEIEnvConfig(dataset=str(tmp_path))
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/info.json").write_text('{"features": {"action": {}}}')
    with pytest.raises(
        CEIError, match=r"is no dataset of CEI-Gym: meta/cei.json is missing\. If it was edited: cei-restore"
    ):
        CEIEnvConfig(dataset=str(tmp_path))
    with pytest.raises(CEIError, match=r"^no dataset 'nobody/nothing': .* could not be fetched from the hub"):
        CEIEnvConfig(dataset="nobody/nothing")
    known = Metadata.load(job / "target")
    for name in ("start_posq", "embodiment"):
        spoilt = replace(known, environment=replace(known.environment, kwargs={name: 0}))
        spoilt.save(tmp_path)
        line = (
            rf"^unknown argument of CEI-PickCube-{TARGET} '{name}'\..* Valid: max_hold_ticks, image_width, .*start_qpos"
        )
        with pytest.raises(CEIError, match=line):
            CEIEnvConfig(dataset=str(tmp_path))
        with pytest.raises(CEIError, match=line):
            open_environment(str(spoilt.environment.id), **spoilt.environment.kwargs)


def test_stock_lerobot_reads_the_converted_dataset(job: Path) -> None:
    dataset = LeRobotDataset("me/target", root=job / "target")
    assert dataset.num_episodes == EPISODES
    assert dataset.meta.robot_type == TARGET
    sample = dataset[len(dataset) - 1]
    assert sample["observation.point_cloud"].shape == (3072,)
    assert set(dataset.meta.stats) >= {"observation.state", "action"}


def test_metadata_and_card_say_how_it_was_made(job: Path) -> None:
    metadata = json.loads((job / "target" / "meta" / "cei.json").read_text())
    provenance = metadata["provenance"]
    assert provenance["source"]["embodiment"] == SOURCE
    assert set(provenance["pads"]) == {SOURCE, TARGET}
    assert provenance["options"]["contact"]["squeeze_m"] == pytest.approx(0.01)
    assert provenance["options"]["basins"][0]["cost"] < 0
    assert provenance["versions"]["lerobot"]
    assert [record["seed"] for record in Records(job / "target")] == [3, 4]
    card = (job / "target" / "README.md").read_text()
    assert "[More Information Needed]" not in card
    assert "cross-embodiment" in card


def test_the_environment_starts_where_each_motion_does(job: Path, tmp_path: Path) -> None:
    def starts(root: Path) -> tuple[np.ndarray, list[np.ndarray]]:
        reader = DatasetReader("me/any", root)
        assert reader.metadata is not None
        found = np.array(reader.metadata.environment.kwargs["start_qpos"])
        return found, [reader.read(i).qpos[0] for i in range(EPISODES)]

    found, first = starts(job / "target")
    assert len(found) == 1
    assert np.abs(found[0] - first).max() < 0.3  # the starts differ by what the recorded ones do
    two = ["--init.modes=2", "--new_repo_id=me/two", f"--new_root={tmp_path / 'two'}"]
    assert convert.main([*source_options(job), f"--target={TARGET}", *two]) == 0
    found, first = starts(tmp_path / "two")
    np.testing.assert_allclose(found, first, atol=1e-4)
    assert np.abs(found[0] - found[1]).max() > 0.5
    assert find_starts(tmp_path / "two") == found.tolist()  # where only the frames are left to say so
    assert find_starts(job / "target") == starts(job / "target")[0].tolist()


def test_film_and_contact_sheet_are_there(job: Path) -> None:
    import av

    with av.open(str(job / "film.mp4")) as film:
        stream = film.streams.video[0]
        assert (stream.width, stream.height) == (644, 240)
        assert stream.frames > 20
    assert (job / "film.png").stat().st_size > 10_000


def test_nothing_is_overwritten(job: Path, capsys: pytest.CaptureFixture) -> None:
    before = sorted((job / "target").rglob("*"))
    assert convert.main([*source_options(job), *target_options(job)]) == 1
    assert "already exists" in capsys.readouterr().err
    env = f"--env=CEI-PickCube-{SOURCE}"
    assert record.main([env, "--episodes=1", "--repo_id=me/source", f"--root={job / 'source'}"]) == 1
    assert "already exists" in capsys.readouterr().err
    assert sorted((job / "target").rglob("*")) == before


def test_a_dry_run_writes_nothing(job: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    options = [*source_options(job), f"--target={TARGET}", "--episodes=1", "--dry_run", f"--json={tmp_path / 'c.json'}"]
    assert convert.main(options) == 0
    found = json.loads((tmp_path / "c.json").read_text())
    assert found["episodes"] == 1
    assert found["results"][0]["episode"] == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.json"]
    assert "pad distance" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--env=CEI-PickCube-IIWA-Inspir", "--repo_id=me/x"],
            "unknown end-effector 'Inspir'. Did you mean 'Inspire'?",
        ),
        (["--env=CEI-StackCube-IIWA-Inspire", "--repo_id=me/x"], "no scripted expert"),
        (["--env=CEI-PickCube-Panda-PandaGripper", "--repo_id=me/x", "--episodes=0"], "at least 1"),
    ],
)
def test_record_says_what_is_wrong_in_one_line(
    options: list[str], message: str, tmp_path: Path, complaint: Callable
) -> None:
    assert record.main([*options, f"--root={tmp_path / 'x'}"]) in (1, 2)
    assert message in complaint()
    assert list(tmp_path.iterdir()) == []


def test_replay_refuses_another_robots_environment(job: Path, capsys: pytest.CaptureFixture) -> None:
    options = [*source_options(job), f"--env=CEI-PickCube-{TARGET}", "--video_episodes=0"]
    assert replay.main(options) == 1
    assert f"is of {SOURCE}, but CEI-PickCube-{TARGET} has a {TARGET}" in capsys.readouterr().err


def test_a_target_moved_out_of_reach_is_refused_with_its_frames(
    job: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """A base a metre and a half farther away: the converter names the frames and leaves nothing."""
    far = tmp_path / "far"
    copy_with_base_shifted(job / "source", far, 1.5)
    options = ["--dataset.repo_id=me/far", f"--dataset.root={far}", *target_options(tmp_path)]
    assert convert.main(options) == 1
    error = capsys.readouterr().err
    # whose clouds still show it where it stood
    assert f"the clouds show {SOURCE} 1.50 m from where its joints and its base pose say" in error
    position = np.array(error.partition("with its base at ")[2].partition(". If")[0].split(",")[:3], float)
    np.testing.assert_allclose(position, Metadata.load(job / "source").scene.T_world_base[:3, 3], atol=0.02)
    assert convert.main([*options, "--check_clouds=false", "--target_pose=0,0,0.912"]) == 1
    error = capsys.readouterr().err
    assert f"{TARGET} does not follow the source in episode 0, frames 0-" in error
    assert not (tmp_path / "target").exists()


def copy_with_base_shifted(source: Path, target: Path, metres: float) -> None:
    import shutil

    shutil.copytree(source, target)
    metadata = json.loads((target / "meta/cei.json").read_text())
    metadata["scene"]["T_world_base"][0][3] += metres
    (target / "meta/cei.json").write_text(json.dumps(metadata))
    info = json.loads((target / "meta/info.json").read_text())
    for key in ("observation.state", "action"):
        info["features"][key]["info"]["cei"]["scene"] = metadata["scene"]
    (target / "meta/info.json").write_text(json.dumps(info))


@pytest.mark.parametrize("end_effector", ["Inspire", "PandaGripper"])
def test_pads_draws_a_picture(end_effector: str, tmp_path: Path) -> None:
    from PIL import Image

    output = tmp_path / "pads.png"
    json_path = tmp_path / "pads.json"
    assert pads.main([f"--end_effector={end_effector}", f"--output={output}", f"--json={json_path}"]) == 0
    assert sum(json.loads(json_path.read_text())["pads"].values()) == 128
    picture = np.asarray(Image.open(output)).astype(int)
    saturation = picture.max(axis=2) - picture.min(axis=2)
    assert (saturation > 120).sum() > 200  # coloured pads on a grey hand
    assert pads.main([f"--end_effector={end_effector}", f"--output={output}"]) == 1  # it is there
    framed = [f"--end_effector={end_effector}", f"--output={output}", "--frames", "--overwrite"]
    assert pads.main(framed) == 0
    assert (np.asarray(Image.open(output)).astype(int) != picture).any(axis=2).sum() > 1000
