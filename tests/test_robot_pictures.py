"""A policy that looks at painted pictures, on a robot: LeRobot's ACT, in whose preprocessor the robot is painted over itself."""

import json
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
import warm
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.act.processor_act import make_act_pre_post_processors
from lerobot.policies.utils import prepare_observation_for_inference
from lerobot.processor import PolicyProcessorPipeline

from cei_converters import convert, record
from cei_gym.environment import robot_environment
from cei_gym.errors import CEIError
from cei_gym.wrapper import CrossEmbodimentWrapper
from lerobot_robot_cei import RobotPictures, TrainedOn, deploy

ROOT = Path(__file__).parents[1]
SOURCE, TARGET = "Panda-PandaGripper", "IIWA-Inspire"
ENV = f"CEI-PickCube-{TARGET}"
FRONT = "observation.images.front"
STATE, ACTION = "observation.state", "action"


def act(folder: Path, *cameras: str, size: tuple[int, int, int] = (3, 120, 160)) -> Path:
    """A checkpoint of an ACT that has learnt nothing."""
    pictures = {f"observation.images.{name}": PolicyFeature(FeatureType.VISUAL, size) for name in cameras}
    config = ACTConfig(
        input_features={STATE: PolicyFeature(FeatureType.STATE, (19,)), **pictures},
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (19,))},
        pretrained_backbone_weights=None,
        device="cpu",
        dim_model=32,
        n_heads=2,
        dim_feedforward=32,
        chunk_size=4,
        n_action_steps=4,
    )
    torch.manual_seed(0)
    flat = {"mean": torch.zeros(19), "std": torch.ones(19), "min": -torch.ones(19), "max": torch.ones(19)}
    shade = {
        "mean": torch.zeros(3, 1, 1),
        "std": torch.ones(3, 1, 1),
        "min": torch.zeros(3, 1, 1),
        "max": torch.ones(3, 1, 1),
    }
    processors = make_act_pre_post_processors(config, {STATE: flat, ACTION: flat} | dict.fromkeys(pictures, shade))
    ACTPolicy(config).save_pretrained(folder)
    for processor in processors:
        processor.save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`painted`, of one demonstration; `act`, and `ours`, its copy that paints."""
    folder = tmp_path_factory.mktemp("pictures")
    recorded = ["--episodes=1", "--colours", "--repo_id=me/r", f"--root={folder}/recorded"]
    assert record.main([f"--env=CEI-PickCube-{SOURCE}", *recorded]) == 0
    given = ["--dataset.repo_id=me/r", f"--dataset.root={folder}/recorded", f"--target={TARGET}", "--cameras.paint"]
    assert convert.main([*given, "--new_repo_id=me/painted", f"--new_root={folder}/painted"]) == 0
    act(folder / "act", "front")
    assert deploy.main([*options(folder, "act"), "--paint", f"--new_policy={folder}/ours"]) == 0
    return folder


def options(folder: Path, policy: str) -> list[str]:
    return [f"--policy={folder / policy}", f"--trained_on={folder / 'painted'}"]


def steps(checkpoint: Path) -> list[Any]:
    return list(PolicyProcessorPipeline.from_pretrained(checkpoint, "policy_preprocessor.json").steps)


def test_a_copy_of_the_checkpoint_paints(folder: Path) -> None:
    before, after = steps(folder / "act"), steps(folder / "ours")
    assert [type(step) for step in after] == [*map(type, before[:2]), RobotPictures, *map(type, before[2:])]
    assert after[2].cameras == ["front"]
    assert TrainedOn.load(folder / "ours").metadata.embodiment == TARGET
    assert sorted(path.name for path in (folder / "ours").iterdir()) == sorted(
        path.name for path in (folder / "act").iterdir()
    )


def test_pictures_on_a_robot_are_those_of_the_wrapper_to_the_bit(folder: Path) -> None:
    """As LeRobot hands observations to policies: uint8 pictures and whole millimetres."""
    step = next(step for step in steps(folder / "ours") if isinstance(step, RobotPictures))
    known = TrainedOn.load(folder / "ours")
    env: Any = CrossEmbodimentWrapper(gym.make(ENV, pixels=True, colours=True), paint=True)
    inner = robot_environment(env)
    env.action_space.seed(0)
    shown, _ = env.reset(seed=0, options={"agent_pos": known.starts[0].astype(np.float32)})
    painted = []
    for _ in range(12):
        depth_mm = np.rint(inner.depth_m()["front"] * 1000).astype(np.uint16)[..., None]
        seen = {STATE: shown["agent_pos"], FRONT: inner.rgb()["front"], f"{FRONT}_depth": depth_mm}
        ready = prepare_observation_for_inference(seen, torch.device("cpu"), "", "")
        given = ready[FRONT].clone()
        made = step.observation(ready)[FRONT]
        painted.append(bool((made != given).any()))
        expected = torch.from_numpy(shown["pixels"]["front"]).permute(2, 0, 1)[None] / 255
        assert torch.equal(made, expected)
        shown, *_ = env.step(env.action_space.sample() * 0.05 + 0.95 * shown["agent_pos"])
    env.close()
    assert any(painted)
    step.reset()
    with pytest.raises(CEIError, match=r"no demonstration starts where the robot stands|outside its limits"):
        step.observation({**ready, STATE: ready[STATE] + 1.5})


def test_a_checkpoint_that_paints_drives_a_robot(folder: Path) -> None:
    own = json.dumps({"type": "simulated", "env": ENV, "stands_at": str(folder / "ours"), "pictures": True})
    result = warm.script(
        "lerobot-rollout",
        *(f"--policy.path={folder / 'ours'}", "--robot.discover_packages_path=simulated_robot", "--fps=20"),
        *("--duration=1", "--device=cpu", "--play_sounds=false", "--return_to_initial_position=false"),
        *("--robot.type=cei", f"--robot.trained_on={folder / 'ours'}", "--robot.unit=deg", f"--robot.robot={own}"),
        cwd=folder,
    )
    assert result.returncode == 0, result.stdout[-2000:]
    assert "From observation to action:" in result.stdout


@pytest.mark.parametrize(
    ("cameras", "more", "said"),
    [
        (["front"], [], "--calibration or --paint, and --new_policy, go together"),
        (["front", "wrist"], ["--paint"], r"observation.images.wrist is of no calibrated camera (front)"),
        ([], ["--paint"], "the policy looks at no pictures"),
    ],
)
def test_what_cannot_be_painted_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], cameras: list[str], more: list[str], said: str
) -> None:
    checkpoint = tmp_path / "act"
    if cameras:
        act(checkpoint, *cameras)
    else:
        shutil.copytree(folder / "act", checkpoint)
        config = json.loads((checkpoint / "config.json").read_text())
        del config["input_features"][FRONT]
        (checkpoint / "config.json").write_text(json.dumps(config))
    new = f"--new_policy={tmp_path / 'new'}"
    assert deploy.main([f"--policy={checkpoint}", f"--trained_on={folder / 'painted'}", *more, new]) in (1, 2)
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_pictures_of_another_size_than_the_cameras_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    checkpoint = act(tmp_path / "act", "front", size=(3, 64, 64))
    given = [f"--policy={checkpoint}", f"--trained_on={folder / 'painted'}", "--paint"]
    assert deploy.main([*given, f"--new_policy={tmp_path / 'new'}"]) == 1
    assert "observation.images.front are (3, 64, 64), its camera's (3, 120, 160)" in capsys.readouterr().err


def test_a_checkpoint_that_does_not_say_what_it_was_trained_on_is_told_so(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert deploy.main([f"--policy={folder / 'act'}", "--paint", f"--new_policy={tmp_path / 'new'}"]) == 1
    assert "Name the dataset that it was trained on instead (cei-deploy: --trained_on)" in capsys.readouterr().err


def test_data_that_are_not_painted_are_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = ["--dataset.repo_id=me/r", f"--dataset.root={folder}/recorded", f"--target={TARGET}"]
    assert convert.main([*given, "--new_repo_id=me/plain", f"--new_root={tmp_path}/plain"]) == 0
    policy = [f"--policy={folder / 'act'}", f"--trained_on={tmp_path / 'plain'}", f"--new_policy={tmp_path / 'new'}"]
    assert deploy.main([*policy, "--paint"]) == 1
    assert "plain are not painted (cei-convert --cameras.paint)" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_painting_twice_is_painting_once(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A copy of a copy has one step that paints."""
    assert deploy.main([f"--policy={folder / 'ours'}", "--paint", f"--new_policy={tmp_path / 'again'}"]) == 0
    assert "are painted is not said; it is taken to be so" in capsys.readouterr().out
    assert len(steps(tmp_path / "again")) == len(steps(folder / "ours"))


@pytest.mark.parametrize(("cameras", "said"), [([], "should be some of front"), (["wrist"], "'wrist'.*front")])
def test_strangers_steps_are_checked(folder: Path, cameras: list[str], said: str) -> None:
    known = TrainedOn.load(folder / "ours")
    with pytest.raises(CEIError, match=said):
        RobotPictures(known.encode(), cameras)
