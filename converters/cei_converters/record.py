"""`cei-record`: demonstrations of a scripted, human-like expert as a LeRobot dataset."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cei_converters.cli import run
from cei_gym.demonstration import Demonstration
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-record --env=CEI-PickCube-Panda-PandaGripper --episodes=20 --seed=1000 \\
      --repo_id=me/pick_panda --root=data/pick_panda"""
HOLD_STEPS = 20
"""Steps that the last target is held for a success to show."""


@dataclass
class RecordConfig:
    """Record demonstrations of an environment's scripted expert; episode i uses seed + i."""

    env: str  # Environment id, such as CEI-PickCube-Panda-PandaGripper.
    repo_id: str  # Name of the dataset, <user>/<name>.
    root: str | None = None  # Its folder, which must not exist; default: LeRobot's cache.
    episodes: int = 20  # How many demonstrations.
    seed: int = 0  # Of the first one.
    push_to_hub: bool = False  # Upload the dataset.
    private: bool = False  # Make the uploaded dataset private.
    json: str | None = None  # File for the result as JSON.


def record(config: RecordConfig) -> dict[str, Any]:
    """Record a dataset; demonstrations that fail are left out and make the command fail.

    Raises:
        CEIError: bad options, no expert, or an expert that failed.
    """
    from cei_converters.environment import open_environment
    from cei_converters.hub import check_login, check_repo_id, push
    from cei_converters.metadata import Environment
    from cei_converters.progress import progress_bar
    from cei_converters.provenance import collect
    from cei_converters.result import check_json_path, write_json
    from cei_converters.writer import DatasetWriter

    if config.episodes < 1:
        raise CEIError(f"--episodes={config.episodes}: record at least 1.")
    check_repo_id(config.repo_id)
    check_json_path(config.json)
    if config.push_to_hub:
        check_login()
    env = open_environment(config.env)
    results = []
    with (
        DatasetWriter(
            config.repo_id, config.root, environment=Environment(config.env), provenance=collect(config)
        ) as writer,
        progress_bar("episodes") as progress,
    ):
        env.get_wrapper_attr("expert")(config.seed)  # fails here if there is none
        task = progress.add_task("recording", total=config.episodes)
        for seed in range(config.seed, config.seed + config.episodes):
            demonstration, info, variation = record_episode(env, seed, index=len(results))
            success = bool(info["is_success"])
            results.append({"seed": seed, "success": success, "failure": info["failure"], "frames": len(demonstration)})
            if success:
                writer.add(demonstration, {"seed": seed, "success": True, "variation": variation})
            progress.advance(task)
    env.close()
    failed = [r for r in results if not r["success"]]
    result = {
        "env": config.env,
        "repo_id": config.repo_id,
        "root": str(writer.root),
        "episodes": len(results),
        "successes": len(results) - len(failed),
        "results": results,
    }
    write_json(config.json, result)
    print(f"Wrote {result['successes']} demonstrations of {config.env} to {writer.root}.")
    if failed:
        named = ", ".join(f"seed {r['seed']} ({r['failure']})" for r in failed)
        raise CEIError(f"the expert failed {len(failed)} of {len(results)} times; left out: {named}.")
    if config.push_to_hub:
        push(writer.root, config.repo_id, private=config.private)
    return result


def record_episode(env, seed: int, index: int) -> tuple[Demonstration, dict[str, Any], dict[str, Any]]:
    """One demonstration of the expert: the episode, its last `info`, and how the expert varied."""
    inner = env.unwrapped
    observation, info = env.reset(seed=seed)
    expert = inner.expert(seed)
    targets = expert.plan(observation["agent_pos"], observation["environment_state"]).astype(np.float32)
    frames: dict[str, list] = {"qpos": [], "action": [], "cloud": [], "state": [], "depth": []}
    for action in [*targets, *[targets[-1]] * HOLD_STEPS]:
        frames["qpos"].append(observation["agent_pos"])
        frames["action"].append(action)
        frames["cloud"].append(observation["point_cloud"])
        frames["state"].append(observation["environment_state"])
        frames["depth"].append(inner.depth_m())
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
    demonstration = Demonstration(
        embodiment=inner.embodiment.name,
        fps=env.metadata["render_fps"],
        qpos=np.array(frames["qpos"], float),
        action=np.array(frames["action"], float),
        scene=inner.scene,
        task=inner.task_text,
        depth_m={c.name: np.stack([d[c.name] for d in frames["depth"]]) for c in inner.scene.cameras},
        point_cloud_world=np.stack(frames["cloud"]),
        environment_state=np.array(frames["state"]),
        environment_state_names=inner.state_names,
        index=index,
    )
    return demonstration, info, expert.describe()


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-record`."""
    return run(RecordConfig, record, args, prog="cei-record", example=EXAMPLE)


if __name__ == "__main__":
    raise SystemExit(main())
