"""Through `lerobot-train` and `lerobot-eval` themselves, on a small converted dataset."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import warm
from conversions import record_cubes
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.policies.factory import make_policy, make_policy_config
from lerobot.utils.feature_utils import dataset_to_policy_features
from safetensors.torch import load_file

from cei_converters import convert

DP3 = ("--policy.type=dp3", "--policy.down_dims=[16,32]", "--policy.points=64", "--policy.scheduler_warmup_steps=2")


def run(script: str, *options: str, cwd: Path) -> None:
    done = warm.script(script, *options, cwd=cwd)
    assert done.returncode == 0, done.stdout[-3000:]


def shell(script: str, *options: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """As a user starts it."""
    env = dict(os.environ) | {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1"}
    command = [Path(sys.executable).with_name(script), *options]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, env=env, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("policy")
    panda, few = folder / "panda", ("--init.starts=64", "--init.basins=2", "--clouds.points=128", "--workers=1")
    record_cubes(panda, 2, 0)
    moved = ("--dataset.repo_id=me/panda", f"--dataset.root={panda}", "--target=UR5e-FourierRight", *few)
    assert convert.main([*moved, "--new_repo_id=me/uncut", f"--new_root={folder / 'uncut'}"]) == 0
    edited = ("--new_repo_id=me/ur5e", f"--new_root={folder / 'ur5e'}", "--operation.type=delete_episodes")
    operation = ("--repo_id=me/uncut", f"--root={folder / 'uncut'}", *edited, "--operation.episode_indices=[0]")
    run("lerobot-edit-dataset", *operation, cwd=folder)  # what is left of it trains and is evaluated as any
    told = ("--privileged_state", "--new_repo_id=me/told", f"--new_root={folder / 'told'}", "--episodes=1")
    assert convert.main([*moved, *told]) == 0
    return folder


def train(folder: Path, output: str, *options: str, root: str = "ur5e") -> dict[str, torch.Tensor]:
    data = (f"--dataset.repo_id=me/{root}", f"--dataset.root={root}", "--dataset.video_backend=pyav")
    rest = ("--policy.device=cpu", "--policy.push_to_hub=false", "--batch_size=4", "--log_freq=1", "--num_workers=0")
    run("lerobot-train", *data, *rest, f"--output_dir={output}", *options, cwd=folder)
    return weights(folder, output)


def weights(folder: Path, output: str) -> dict[str, torch.Tensor]:
    return load_file(folder / output / "checkpoints/last/pretrained_model/model.safetensors")


def test_dp3_trains_resumes_exactly_and_is_evaluated(folder: Path) -> None:
    whole = train(folder, "whole", *DP3, "--steps=4", "--save_freq=2")
    assert (folder / "whole/checkpoints/000002").exists()
    # As if the training had been stopped after two steps.
    half = folder / "whole/checkpoints/last"
    half.unlink()
    half.symlink_to("000002")
    config = "--config_path=whole/checkpoints/last/pretrained_model/train_config.json"
    done = shell("lerobot-train", config, "--resume=true", cwd=folder)
    assert done.returncode == 0, done.stderr[-3000:]
    resumed = weights(folder, "whole")
    assert {"average.n_averaged", "average.module.unet.final_conv.1.bias"} <= set(whole)
    assert int(resumed["average.n_averaged"]) == 4
    for name, value in whole.items():
        torch.testing.assert_close(resumed[name], value, rtol=0, atol=0, msg=name)

    evaluation = ("--env.type=cei", "--env.dataset=ur5e", "--env.episode_length=10", "--eval.use_async_envs=true")
    count = ("--eval.n_episodes=2", "--eval.batch_size=2", "--seed=1000", "--output_dir=eval", "--policy.device=cpu")
    run("lerobot-eval", "--policy.path=whole/checkpoints/last/pretrained_model", *evaluation, *count, cwd=folder)
    overall = json.loads((folder / "eval/eval_info.json").read_text())["overall"]
    assert overall["n_episodes"] == 2
    assert all(Path(folder, path).stat().st_size > 1000 for path in overall["video_paths"])


@pytest.mark.parametrize(
    "policy",
    [
        ("--policy.type=act", "--policy.dim_model=32", "--policy.dim_feedforward=32", "--policy.n_encoder_layers=1"),
        ("--policy.type=diffusion", "--policy.down_dims=[16,32]", "--policy.horizon=16", "--policy.n_action_steps=8"),
    ],
    ids=["act", "diffusion"],
)
def test_lerobots_own_policies_train_on_states_where_they_are_told_them(folder: Path, policy: tuple[str, ...]) -> None:
    name, options = policy[0].removeprefix("--policy.type="), (*policy, "--steps=2", "--save_freq=2")
    trained = train(folder, name, *options, root="told")
    assert all(torch.isfinite(value).all() for value in trained.values())
    # Otherwise they say themselves that they have nothing to look at.
    blind = make_policy_config(name, device="cpu")
    with pytest.raises(
        ValueError, match="You must provide at least one image or the environment state among the inputs"
    ):
        make_policy(blind, ds_meta=LeRobotDatasetMetadata("me/ur5e", folder / "ur5e"))
    assert blind.input_features is not None
    assert set(blind.input_features) == {"observation.state", "observation.point_cloud"}
    recorded = dataset_to_policy_features(LeRobotDatasetMetadata("me/panda", folder / "panda").features)
    assert set(recorded) == {"action", "observation.state", "observation.point_cloud", "observation.depth.front"}
    assert recorded["observation.depth.front"].shape == (1, 120, 160)  # which they take for a picture


def test_an_unknown_task_of_an_environment_is_one_clear_line(folder: Path) -> None:
    options = ("--env.type=cei", "--env.task=PickCube-UR5e-FourierRigth", "--policy.type=dp3")
    done = shell("lerobot-eval", *options, cwd=folder)
    assert done.returncode != 0
    assert "PickCube-UR5e-FourierRight" in done.stderr
