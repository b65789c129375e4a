"""A policy of converted data on a robot: joints by name and unit, clouds from its depth, and what is refused before anything moves."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
import warm
from conversions import record_cubes
from lerobot.policies.utils import prepare_observation_for_inference
from lerobot.processor import PolicyProcessorPipeline
from lerobot.robots import make_robot_from_config

from cei_converters import convert
from cei_converters.dataset.metadata import Metadata
from cei_converters.sources.joint_map import JointGroup, JointMap
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.wrapper import CrossEmbodimentWrapper
from lerobot_robot_cei import CEIRobotConfig, RobotClouds, TrainedOn, deploy
from lerobot_robot_cei.deploy import needs
from lerobot_robot_cei.joints import RobotJoints

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "examples"))
import simulated_robot  # noqa: E402

TARGET = "IIWA-Inspire"
ENV = f"CEI-PickCube-{TARGET}"
FEW = ("--init.starts=64", "--init.basins=2", "--clouds.points=128", "--workers=1")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two demonstrations of a Panda, converted; a policy that has seen them four times."""
    folder = tmp_path_factory.mktemp("robot")
    record_cubes(folder / "panda", 2, 0)
    moved = ("--dataset.repo_id=me/panda", f"--dataset.root={folder / 'panda'}", f"--target={TARGET}")
    assert convert.main([*moved, *FEW, "--new_repo_id=me/iiwa", f"--new_root={folder / 'iiwa'}"]) == 0
    data = ("--dataset.repo_id=me/iiwa", "--dataset.root=iiwa", "--num_workers=0", "--batch_size=4", "--steps=2")
    small = (
        "--policy.type=dp3",
        "--policy.down_dims=[16,32]",
        "--policy.points=64",
        "--policy.scheduler_warmup_steps=1",
    )
    warm.script(
        "lerobot-train",
        *data,
        *small,
        "--policy.device=cpu",
        "--policy.push_to_hub=false",
        "--output_dir=out",
        cwd=folder,
    )
    return folder


@pytest.fixture
def known(folder: Path) -> TrainedOn:
    return TrainedOn.load(checkpoint(folder))


def checkpoint(folder: Path) -> Path:
    return folder / "out/checkpoints/last/pretrained_model"


def rollout(folder: Path, *options: str, **robot: object) -> subprocess.CompletedProcess[str]:
    own = json.dumps({"type": "simulated", "env": ENV, **robot})
    return warm.script(
        "lerobot-rollout",
        *(f"--policy.path={checkpoint(folder)}", "--robot.discover_packages_path=simulated_robot", "--fps=20"),
        *("--duration=2", "--device=cpu", "--play_sounds=false", "--return_to_initial_position=false"),
        *(
            options
            or (
                "--robot.type=cei",
                f"--robot.trained_on={checkpoint(folder)}",
                "--robot.unit=deg",
                f"--robot.robot={own}",
            )
        ),
        cwd=folder,
    )


def test_a_checkpoint_knows_its_robot(folder: Path, known: TrainedOn) -> None:
    of_data = TrainedOn.load(folder / "iiwa")
    assert known.encode() == of_data.encode() == TrainedOn.decode(known.encode(), "here").encode()
    assert (known.metadata.embodiment, known.fps, known.cloud_shape) == (TARGET, 20, (128, 3))
    assert known.embodiment().joint_names == tuple(name.removesuffix(".pos_rad") for name in known.joint_names)
    config = json.loads((checkpoint(folder) / "config.json").read_text())
    assert config["action_feature_names"] == [f"{name}.pos" for name in known.embodiment().joint_names]


def test_a_checkpoint_knows_how_long_its_demonstrations_steps_took(folder: Path, known: TrainedOn) -> None:
    said = known.metadata.step_time_s
    assert said is not None and said == Metadata.load(folder / "iiwa").step_time_s
    assert said.robots == ("Panda-PandaGripper",) and said.waits
    waiting = known.waiting()
    assert waiting is not None and said.sentence(20) in waiting and "--robot.wait_s=0.25;" in waiting
    assert "\n".join(needs(known)).count(waiting) == 1
    older = {name: value for name, value in known.encode().items() if name != "step_time_s"}
    assert TrainedOn.decode(older, "here").waiting() is None
    in_time = replace(known, metadata=replace(known.metadata, step_time_s=replace(said, in_time=1.0, max=0.05)))
    assert in_time.waiting() is None and "as 20 frames a second say" in "\n".join(needs(in_time))


@pytest.mark.parametrize("channels", [3, 6])
def test_clouds_on_a_robot_are_those_of_the_wrapper_to_the_bit(folder: Path, known: TrainedOn, channels: int) -> None:
    steps = PolicyProcessorPipeline.from_pretrained(checkpoint(folder), "policy_preprocessor.json")
    (step,) = (step for step in steps.steps if isinstance(step, RobotClouds))
    if channels == 6:
        step = RobotClouds(replace(known, cloud_shape=(128, 6)).encode())
    env = CrossEmbodimentWrapper(gym.make(ENV, colours=channels == 6), clouds=known.clouds())
    seen, _ = env.reset(seed=3, options={"agent_pos": known.starts[0].astype(np.float32)})
    random = np.random.default_rng(0)
    for _ in range(4):
        depth_mm = np.rint(env.get_wrapper_attr("depth_m")()["front"] * 1000).astype(np.uint16)[..., None]
        frame = {"observation.state": seen["agent_pos"], "observation.images.front_depth": depth_mm}
        if channels == 6:
            frame["observation.images.front"] = env.get_wrapper_attr("rgb")()["front"]
        given = prepare_observation_for_inference(frame, torch.device("cpu"))
        cloud = step.observation(given)["observation.point_cloud"]
        np.testing.assert_array_equal(cloud.numpy().reshape(-1, channels), seen["point_cloud"])
        action = seen["agent_pos"] + random.uniform(-0.05, 0.05, len(seen["agent_pos"])).astype(np.float32)
        seen, *_ = env.step(action)
    env.close()
    ready = {"observation.point_cloud": torch.zeros(1, 384), "observation.state": torch.zeros(1, 19)}
    assert step.observation(ready) is ready


def test_a_policy_of_recorded_clouds_sees_what_its_environment_shows(folder: Path) -> None:
    step = RobotClouds.of_dataset(folder / "panda")
    assert step is not None
    env = gym.make("CEI-PickCube-Panda-PandaGripper")
    seen, _ = env.reset(seed=5)
    depth_mm = np.rint(env.get_wrapper_attr("depth_m")()["front"] * 1000).astype(np.uint16)[..., None]
    frame = {"observation.state": seen["agent_pos"], "observation.images.front_depth": depth_mm}
    cloud = step.observation(prepare_observation_for_inference(frame, torch.device("cpu")))["observation.point_cloud"]
    np.testing.assert_array_equal(cloud.numpy().reshape(-1, 3), seen["point_cloud"])
    env.close()


def test_a_robot_with_other_order_and_unit_is_driven_by_names(folder: Path, known: TrainedOn) -> None:
    done = rollout(folder, stands_at=str(folder / "iiwa"))
    assert done.returncode == 0, done.stdout[-3000:]
    assert "The task is not done." in done.stdout
    assert re.search(r"From observation to action: \d+ ms, 99 % within \d+ ms \(\d+ actions\)", done.stdout)
    assert "keys don't match" not in done.stdout


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        ({"lacks": "joint_3"}, "the policy moves joint_1, joint_2, joint_3"),
        ({}, "no demonstration starts where the robot stands (within 0.2 rad, or 0.02 m, of each joint). Move joint_"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_moves(folder: Path, robot: dict, said: str) -> None:
    done = rollout(folder, **robot)
    assert done.returncode != 0
    assert said in done.stdout.splitlines()[-1]


def test_a_robot_that_is_not_asked_for_its_names_is_refused_too(folder: Path, known: TrainedOn) -> None:
    bare = ("--robot.type=simulated", f"--robot.env={ENV}", f"--robot.stands_at={checkpoint(folder)}")
    done = rollout(folder, *bare)
    assert done.returncode != 0
    assert "the policy knows 19 joints" in done.stdout.splitlines()[-1]


def test_joints_by_name_in_any_order_and_back() -> None:
    robot = load_embodiment(TARGET)
    leads = [robot.joint_names[q] for q in robot.coupled.independent]
    values = [f"{name}.pos" for name in reversed(leads)]
    joints = RobotJoints(robot, [*values, "speed.vel"], values, unit="deg")
    qpos = robot.coupled.expand(np.random.default_rng(0).uniform(*robot.independent_limits))
    told = joints.command(qpos)
    assert sorted(told) == sorted(values)
    assert told[f"{leads[2]}.pos"] == pytest.approx(np.degrees(qpos[robot.joint_names.index(leads[2])]))
    np.testing.assert_allclose(joints.qpos(told), qpos, atol=1e-12)
    far = joints.command(qpos + 100.0)
    np.testing.assert_allclose([far[f"{name}.pos"] for name in leads], np.degrees(robot.independent_limits[1]))


def test_a_hand_with_a_motor_in_each_joint_is_told_what_follows() -> None:
    robot = load_embodiment(TARGET)
    values = [f"{name}.pos" for name in robot.joint_names]
    joints = RobotJoints(robot, values, values, unit="deg")
    told = joints.command(robot.closed)
    np.testing.assert_allclose([told[name] for name in values], np.degrees(robot.closed), atol=1e-9)


def test_a_joint_map_of_datasets_reads_the_robot_too() -> None:
    robot = load_embodiment("Panda-PandaGripper")
    arm = [f"axis_{i}" for i in range(7)]
    groups = [
        JointGroup("arm", arm, "deg", [1, -1, 1, 1, 1, 1, 1], 0.1),
        JointGroup("end_effector", ["grip"], "normalised", range=[0, 100]),
    ]
    joints = RobotJoints(robot, [*arm, "grip"], [*arm, "grip"], JointMap(groups))
    told = joints.command(robot.home)
    assert told["axis_1"] == pytest.approx(-np.degrees(robot.home[1] - 0.1))
    assert told["grip"] == pytest.approx(100)  # open
    np.testing.assert_allclose(joints.qpos(told), robot.home, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"joint_names": 3}, "joint_names should be names"),
        ({"starts": [[0.0]]}, "starts should be rows of 19 joint positions"),
        ({"starts": [[float("nan")] * 19]}, "starts should be rows of 19"),
        ({"fps": "20"}, "fps should be above 0"),
        ({"cloud_shape": [64, 3]}, r"clouds have 128 points, but cloud_shape is \(64, 3\)"),
        ({"cloud_shape": [128, 4]}, r"cloud_shape should be \(N, 3 or 6\)"),
        ({"cei": {"format_version": "9.0"}}, "format_version is 9.0"),
        ({"step_time_s": {"mean": 3}}, "step_time_s: "),
        ({"step_time_s": "slow"}, "step_time_s should be a JSON object"),
    ],
)
def test_what_strangers_say_of_their_policy_is_checked(known: TrainedOn, change: dict, said: str) -> None:
    with pytest.raises(CEIError, match=said):
        RobotClouds({**known.encode(), **change})


def test_fingers_that_slide_are_held_to_less(folder: Path) -> None:
    panda = TrainedOn.load(folder / "panda")
    robot = panda.embodiment()
    assert panda.complaint(panda.starts[0], robot, 0.2) is None
    closed = panda.starts[0].copy()
    closed[robot.n_arm :] = robot.closed[robot.n_arm :]
    assert "Move finger_joint1 from 0.000 to 0.04" in str(panda.complaint(closed, robot, 0.2))


def test_depth_of_another_size_unit_or_place_is_refused(known: TrainedOn) -> None:
    step = RobotClouds(known.encode())
    state = torch.as_tensor(known.starts[:1], dtype=torch.float32)

    def cloud(
        depth: torch.Tensor, key: str = "observation.images.front_depth", qpos: torch.Tensor = state
    ) -> torch.Tensor:
        return step.observation({"observation.state": qpos, key: depth})["observation.point_cloud"]

    table_m = torch.full((1, 1, 120, 160), 1.2)
    assert cloud(table_m).shape == (1, 384)
    for wrong, said in (
        (
            lambda: cloud(torch.zeros(1, 1, 60, 80)),
            r"gives images of 160x120.*here is observation.images.front_depth \(1, 60, 80\)",
        ),
        (lambda: cloud(table_m, "observation.images.wrist"), "here is observation.images.wrist"),
        (lambda: cloud(1000 * table_m), "reaches 1200; as fractions it should be in m"),
        (lambda: cloud(table_m, qpos=state[:, :7]), "the policy knows 19 joints"),
    ):
        with pytest.raises(CEIError, match=said):
            wrong()
    step.reset()
    with pytest.raises(CEIError, match="the cameras see 0 points in the workspace"):
        cloud(torch.full((1, 1, 120, 160), 40.0))
    with pytest.raises(CEIError, match=r"outside its limits .* are joints in another order, or unit"):
        cloud(table_m, qpos=torch.rad2deg(state))


@pytest.mark.parametrize(
    ("robot", "options", "said"),
    [
        ({"type": "nothing"}, {"unit": "deg"}, "should be JSON with the lab's robot's type"),
        ({"type": "cei"}, {"unit": "deg"}, "should be JSON with the lab's robot's type"),
        ({"type": "simulated", "env": ENV, "colour": 3}, {"unit": "deg"}, "colour"),
        ({"type": "simulated", "env": ENV}, {}, "say in which unit the robot's joints are, rad or deg"),
        (
            {"type": "simulated", "env": ENV},
            {"unit": "deg", "trained_on": "."},
            "neither a checkpoint .* nor a dataset",
        ),
        ({"type": "simulated", "env": ENV}, {"unit": "deg", "trained_on": "me/none"}, "nor a checkpoint of the hub"),
        ({"type": "simulated", "env": ENV}, {"unit": "deg", "trained_on": "no//folder"}, "nor a checkpoint of the hub"),
        ({"type": "simulated", "env": ENV}, {"unit": "deg", "wait_s": -1.0}, "wait_s=-1"),
    ],
)
def test_wrong_options_are_one_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch, robot: dict, options: dict, said: str
) -> None:
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    with pytest.raises((CEIError, ValueError), match=said):
        make_robot_from_config(CEIRobotConfig(**{"robot": robot, "trained_on": str(checkpoint(folder)), **options}))


class Slow:
    """In the place of methods of a simulated robot: goes a tenth of its way each time that it is looked at."""

    action_features: dict[str, type]

    last: "Slow"

    def connect(self, calibrate: bool = True) -> None:
        Slow.last = self
        self.at = dict.fromkeys(self.action_features, 0.0)
        self.target, self.looks = dict(self.at), 0

    def get_observation(self) -> dict[str, float]:
        self.looks += 1
        self.at = {name: at + (self.target[name] - at) / 10 for name, at in self.at.items()}
        return dict(self.at)

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        self.target = dict(action)
        return action


@pytest.mark.parametrize(("wait_s", "looks"), [(0.0, 1), (0.03, 4), (30.0, 60)])
def test_it_waits_for_slow_joints_as_long_as_it_is_told(
    folder: Path, monkeypatch: pytest.MonkeyPatch, wait_s: float, looks: int
) -> None:
    for name in ("connect", "get_observation", "send_action"):
        monkeypatch.setattr(simulated_robot.SimulatedRobot, name, getattr(Slow, name))
    own = {"type": "simulated", "env": ENV}
    config = CEIRobotConfig(robot=own, trained_on=str(folder / "iiwa"), unit="deg", start_tolerance=9.0, wait_s=wait_s)
    robot = make_robot_from_config(config)
    robot.connect()
    names = list(robot.action_features)
    wanted = load_embodiment(TARGET).coupled.expand(np.full(13, 0.5))
    sent = robot.send_action(dict(zip(names, wanted.tolist(), strict=True)))
    np.testing.assert_allclose([*sent.values()], wanted)
    slow = Slow.last
    assert slow.looks <= looks
    reached = max(abs(slow.at[name] - slow.target[name]) for name in slow.at)
    assert (np.radians(reached) < 0.02) == (wait_s == 30.0)


@pytest.mark.parametrize(("wait_s", "times"), [(0.0, 1), (0.25, 0)])
def test_a_robot_that_does_not_wait_as_the_demonstrations_did_says_so(
    folder: Path, known: TrainedOn, monkeypatch: pytest.MonkeyPatch, wait_s: float, times: int
) -> None:
    said: list[str] = []
    monkeypatch.setattr("logging.warning", lambda text, *values: said.append(text % values))
    monkeypatch.setattr(simulated_robot.SimulatedRobot, "connect", Slow.connect)
    own = {"type": "simulated", "env": ENV}
    config = CEIRobotConfig(robot=own, trained_on=str(checkpoint(folder)), unit="deg", wait_s=wait_s)
    make_robot_from_config(config).connect()
    assert said.count(str(known.waiting())) == len(said) == times


@pytest.mark.parametrize(
    ("rate", "wait_s", "complains"),
    [
        (20.0, 0.0, False),
        (13.0, 0.0, True),
        (13.0, 0.25, False),
        (20.0, 0.25, False),
        (5.0, 0.25, True),
        (30.0, 0.25, True),
    ],
)
def test_another_rate_than_the_demonstrations_is_told(
    folder: Path, monkeypatch: pytest.MonkeyPatch, rate: float, wait_s: float, complains: bool
) -> None:
    said: list[str] = []
    monkeypatch.setattr("logging.warning", lambda text, *values: said.append(text % values))
    for name in ("connect", "get_observation", "send_action"):
        monkeypatch.setattr(simulated_robot.SimulatedRobot, name, getattr(Slow, name))
    monkeypatch.setattr("lerobot_robot_cei.cei.sleep", lambda seconds: None)
    own = {"type": "simulated", "env": ENV}
    config = CEIRobotConfig(robot=own, trained_on=str(folder / "iiwa"), unit="deg", start_tolerance=9.0, wait_s=wait_s)
    robot, now = make_robot_from_config(config), [0.0]
    robot.connect()
    said.clear()
    wanted = dict.fromkeys(robot.action_features, 0.0)
    monkeypatch.setattr("lerobot_robot_cei.cei.monotonic", lambda: now[0])
    for _ in range(20):
        robot.send_action(wanted)
        now[0] += 1 / rate
    assert [text.startswith(f"Actions come at {rate:.1f} a second") for text in said if "Actions" in text] == [
        True
    ] * complains


def test_targets_beyond_limits_are_told_at_them_and_that_is_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr("logging.warning", lambda text, *values: said.append(text % values))
    for name in ("connect", "get_observation", "send_action"):
        monkeypatch.setattr(simulated_robot.SimulatedRobot, name, getattr(Slow, name))
    own = {"type": "simulated", "env": ENV}
    config = CEIRobotConfig(robot=own, trained_on=str(folder / "iiwa"), unit="deg", start_tolerance=9.0)
    robot, body = make_robot_from_config(config), load_embodiment(TARGET)
    robot.connect()
    u = np.full(13, 0.5)
    u[0] = body.independent_limits[1][0] + 0.25
    for _ in range(3):
        robot.send_action(dict(zip(robot.action_features, body.coupled.expand(u).tolist(), strict=True)))
    told = "The target of joint_1 is 0.250 beyond its limit, and is told at the limit."
    assert said.count(told) == 1
    monkeypatch.setattr(simulated_robot.SimulatedRobot, "disconnect", lambda self: None)
    robot.disconnect()
    assert said[-1] == "Told at their limits, as targets were beyond, of 3 actions: joint_1 3."


CAMERA = """cameras:
  {name}:
    width: 640
    height: 480
    K: {{fx: 579.4, fy: 579.4, cx: 319.5, cy: 239.5}}
    T_world_camera: {{position: [0.0, 0.0, 1.45], quaternion_wxyz: [0.0, 0.7071, 0.7071, 0.0]}}
"""


def test_a_copy_of_the_checkpoint_knows_the_labs_cameras(
    folder: Path, known: TrainedOn, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cameras.yaml").write_text(CAMERA.format(name="front"))
    options = [f"--policy={checkpoint(folder)}", f"--calibration={tmp_path / 'cameras.yaml'}"]
    assert deploy.main([*options, f"--new_policy={tmp_path / 'ours'}", f"--json={tmp_path / 'needs.json'}"]) == 0
    said = capsys.readouterr().out
    assert "Depth front_depth, 640x480, whole mm; the camera stands at [0.0, 0.0, 1.45] m" in said
    assert "  joint_1.pos  -2.967 to 2.967 rad, starts at " in said and "(joint_r_index_distal.pos)" in said
    assert TrainedOn.decode(json.loads((tmp_path / "needs.json").read_text()), "needs.json").cloud_shape == (128, 3)
    copied, before = TrainedOn.load(tmp_path / "ours"), sorted(path.name for path in checkpoint(folder).iterdir())
    assert sorted(path.name for path in (tmp_path / "ours").iterdir()) == before
    assert copied.metadata.scene.cameras[0].width == 640
    assert copied.joint_names == known.joint_names
    step = PolicyProcessorPipeline.from_pretrained(tmp_path / "ours", "policy_preprocessor.json").steps[2]
    observed = {
        "observation.state": torch.as_tensor(known.starts[:1]),
        "observation.images.front_depth": torch.full((1, 1, 480, 640), 0.6),
    }
    assert step.observation(observed)["observation.point_cloud"].shape == (1, 384)

    for wrong, why in (
        ([*options, f"--new_policy={tmp_path / 'ours'}"], "ours already exists"),
        ([options[0], f"--new_policy={tmp_path / 'more'}"], "--calibration or --paint, and --new_policy, go together"),
        ([f"--policy={folder / 'iiwa'}", options[1], f"--new_policy={tmp_path / 'more'}"], "iiwa is no checkpoint"),
        ([f"--policy={tmp_path}"], "neither a checkpoint"),
    ):
        assert deploy.main(wrong) != 0
        assert why in capsys.readouterr().err
    (tmp_path / "cameras.yaml").write_text(CAMERA.format(name="wrist"))
    assert deploy.main([*options, f"--new_policy={tmp_path / 'more'}"]) == 1
    assert "cameras.yaml has camera wrist; the policy's data are of front" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cameras.yaml", "needs.json", "ours"]
