"""`cei-record`: demonstrations of a scripted, human-like expert, or of a person, as a LeRobot dataset."""

import contextlib
import signal
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym

from cei_converters import signals
from cei_converters.cli import run
from cei_converters.cli.options import check_overwrite, check_range
from cei_converters.simulation.rollout import as_demonstration, record_episode, roll_out
from cei_gym.demonstration import Demonstration
from cei_gym.errors import CEIError, OutOfReachError

EXAMPLE = """example:
  cei-record --env=CEI-PickCube-Panda-PandaGripper --episodes=20 --seed=1000 \\
      --repo_id=me/pick_panda --root=data/pick_panda"""
BY_HAND = """An episode starts with your first motion and ends with success; time stands still until you move.
To start it over: q, or the space mouse's right button. To finish early: Ctrl-C here, which keeps finished episodes."""


@dataclass
class RecordConfig:
    """Record demonstrations of an environment's scripted expert, or your own; episode i uses seed + i."""

    env: str  # Environment id, such as CEI-PickCube-Panda-PandaGripper.
    repo_id: str  # Name of the dataset, <user>/<name>.
    root: Path | None = None  # Its folder, which must not exist; default: LeRobot's cache.
    episodes: int = 20  # How many demonstrations.
    seed: int = 0  # Of the first one.
    variation: float = 1.0  # How much the expert's demonstrations differ: 1 as people's do, 0 not at all.
    cameras: list[str] | None = None  # Depth cameras, such as [front,left,top]; default: front.
    depth_noise: str | None = None  # What makes depth like a real camera's, such as kinect; default: nothing.
    colours: bool = False  # Pictures beside depth, so that clouds have colours.
    sensors: list[str] | None = None  # What else the robot feels, such as [wrench], as observation.<sensor>.
    fixed_rate: bool = False  # A step is one period and waits for no joint, so that the frames a second are true.
    privileged_state: bool = False  # Let policies see the state of objects, as observation.environment_state.
    teleop: str | None = None  # Demonstrate by hand, with keyboard or spacemouse; default: the scripted expert does.
    push_to_hub: bool = False  # Upload the dataset.
    private: bool = False  # Make the uploaded dataset private.
    branch: str | None = None  # Upload to this branch, made if there is none; default: main.
    pull_request: bool = False  # Upload to a pull request.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace a JSON file that is there already; never a dataset.

    def __post_init__(self) -> None:
        check_range("--episodes", self.episodes, 1)
        check_range("--seed", self.seed, 0)
        check_range("--variation", self.variation, 0, 1)
        check_overwrite(self.overwrite, self.json)
        if self.teleop is not None and self.variation != RecordConfig.variation:
            raise CEIError("--variation is the scripted expert's; leave it out with --teleop.")


def record(config: RecordConfig) -> dict[str, Any]:
    """Record a dataset.

    Where an expert fails, the episode is left out and the command fails; a person repeats it. What a person has
    finished is kept when Ctrl-C ends the recording.

    Raises:
        CEIError: bad options, no expert, an expert that failed, or nothing to record by hand with.
        KeyboardInterrupt: Ctrl-C before the first demonstration was finished.
    """
    from cei_converters.cli.outputs import JSON, Outputs
    from cei_converters.cli.progress import progress_bar
    from cei_converters.cli.result import write_json
    from cei_converters.dataset import schema
    from cei_converters.dataset.hub import check_destination, check_repo_id, push
    from cei_converters.dataset.metadata import Environment, Metadata, plain
    from cei_converters.dataset.place import check_place
    from cei_converters.dataset.provenance import collect, command_line, published
    from cei_converters.dataset.step_time import STEP_TIMES
    from cei_converters.dataset.writer import DatasetWriter, default_root
    from cei_converters.simulation.environment import open_environment

    check_repo_id(config.repo_id)
    root = Path(config.root) if config.root is not None else default_root(config.repo_id)
    check_place(root)
    json = Outputs(config.overwrite, root).file("--json", config.json, JSON)
    check_destination(config.push_to_hub, config.private, config.branch, config.pull_request)
    given = {"cameras": config.cameras, "depth_noise": config.depth_noise, "sensors": config.sensors}
    kwargs = {name: value for name, value in given.items() if value is not None}
    if config.colours:
        kwargs["colours"] = True
    if config.fixed_rate:
        kwargs["max_hold_ticks"] = 1
    env = open_environment(config.env, **kwargs)
    seeds = range(config.seed, config.seed + config.episodes)
    results = []
    with contextlib.ExitStack() as stack:
        if config.teleop is None:
            episodes = scripted(env, seeds, config.variation)
        else:
            teleoperator = stack.enter_context(env.get_wrapper_attr("teleoperator")(config.teleop))
            stack.enter_context(_on_interrupt(teleoperator.stop))
            episodes = by_hand(env, seeds, teleoperator, config.teleop)
        environment = Environment(config.env, kwargs)
        provenance = collect(published(config), command_line("cei-record", config))
        writer = stack.enter_context(
            DatasetWriter(
                config.repo_id,
                root,
                environment=environment,
                provenance=provenance,
                state_key=schema.state_key(config.privileged_state),
            )
        )
        progress = stack.enter_context(progress_bar("episodes"))
        task = progress.add_task("recording", total=config.episodes)
        for seed, demonstration, info, how in episodes:
            success = bool(info["is_success"])
            results.append(
                {"seed": seed, "success": success, "failure": info["failure"], "frames": len(demonstration or ())}
            )
            if success and demonstration is not None:
                times = {STEP_TIMES: info[STEP_TIMES]} if STEP_TIMES in info else {}
                writer.add(demonstration, {"seed": seed, "success": True, **how, **times})
            progress.advance(task)
        if not results:
            raise KeyboardInterrupt
    fps = env.metadata["render_fps"]
    env.close()
    step_time = Metadata.load(writer.root).step_time_s
    failed = [r for r in results if not r["success"]]
    result = {
        "env": config.env,
        "repo_id": config.repo_id,
        "root": str(writer.root),
        "episodes": len(results),
        "successes": len(results) - len(failed),
        "step_time_s": plain(step_time),
        "results": results,
    }
    write_json(json, result)
    if len(results) < config.episodes:
        print(f"Interrupted after {len(results)} of {config.episodes} demonstrations, which are kept.")
    print(f"Wrote {result['successes']} demonstrations of {config.env} to {writer.root}.")
    if step_time is not None:
        print(step_time.sentence(fps))
    if failed:
        named = ", ".join(f"seed {r['seed']} ({r['failure']})" for r in failed)
        raise CEIError(f"the expert failed {len(failed)} of {len(results)} times; left out: {named}.")
    if config.push_to_hub:
        to = {"private": config.private, "branch": config.branch, "pull_request": config.pull_request}
        print(f"Uploaded to {push(writer.root, config.repo_id, **to)}.")
    return result


type Episode = tuple[int, Demonstration | None, dict[str, Any], dict[str, Any]]
"""Seed, demonstration (None if there was no way to begin one), its last `info`, and what else the metadata shall say of it."""


def scripted(env: gym.Env, seeds: Iterable[int], variation: float = 1.0) -> Iterator[Episode]:
    """The expert's episodes, one a seed, whether or not they succeed; they differ as much as `variation` says."""
    for index, seed in enumerate(seeds):
        try:
            demonstration, info, varied = record_episode(env, seed, index, variation)
        except OutOfReachError as error:  # where this seed has put things; others may be in reach
            yield seed, None, {"is_success": False, "failure": str(error).rstrip(".")}, {}
            continue
        yield seed, demonstration, info, {"variation": varied}


def by_hand(env: gym.Env, seeds: Iterable[int], teleoperator, device: str) -> Iterator[Episode]:
    """A person's episodes: successes only, one a seed, until the teleoperator is stopped."""
    print(BY_HAND)
    for index, seed in enumerate(seeds):
        while True:
            frames, info = roll_out(env, seed, lambda observation: teleoperator.actions(observation["agent_pos"]))
            if info["is_success"]:
                break
            if teleoperator.stopped:
                return
            print(f"Seed {seed}: {info['failure']}; discarded. The same start again.")
        yield seed, as_demonstration(env, frames, index), info, {"teleop": device}


@contextlib.contextmanager
def _on_interrupt(call: Callable[[], None]) -> Iterator[None]:
    """Have Ctrl-C, SIGTERM and a terminal that closes call a function, so that they never cut the writing of an episode in two."""
    previous = {}
    with contextlib.suppress(ValueError):  # not in the main thread
        for number in (each for each in signals.WORDS if signal.getsignal(each) != signal.SIG_IGN):
            previous[number] = signal.signal(number, lambda *_: call())
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-record`."""
    return run(RecordConfig, record, args, prog="cei-record", example=EXAMPLE)


if __name__ == "__main__":
    from cei_converters import start

    raise SystemExit(start.record())
