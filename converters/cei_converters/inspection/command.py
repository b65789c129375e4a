"""`cei-inspect`: what is in a dataset, what is wrong with it, and which of its columns are which joints."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cei_converters.cli import DatasetConfig, run
from cei_converters.cli.options import check_overwrite, check_range
from cei_converters.sources import joint_map, pose
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cei_converters.cli.outputs import Output
    from cei_converters.inspection.columns import Column
    from cei_converters.sources.joint_map import JointMap
    from cei_converters.sources.recording import Recordings

_STATE, _ACTION = "observation.state", "action"
EXAMPLE = "\n\n".join(
    (
        """example:
  cei-inspect --dataset.repo_id=lab/real_panda
  cei-inspect --dataset.repo_id=lab/real_panda --source=Panda-PandaGripper --save_map=joint_map.yaml
  cei-inspect --dataset.repo_id=lab/real_panda --joint_map=joint_map.yaml""",
        joint_map.FORMAT,
        pose.FORMAT,
    )
)


@dataclass
class InspectConfig:
    """Say what is in a dataset of any robot, and propose or check its joint map."""

    dataset: DatasetConfig
    source: str | None = None  # Embodiment to propose a joint map for.
    joint_map: Path | None = None  # Joint map to check.
    save_map: Path | None = None  # YAML file for the proposed joint map.
    episodes: int = 8  # Episodes to look at, spread over the dataset.
    state: str = "observation.state"  # LeRobot's feature with the positions.
    action: str = "action"  # LeRobot's feature with the targets.
    package_path: list[Path] | None = None  # Folders to look for robots' ROS packages in, separated by colons.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace a JSON file or a joint map that is there already.

    def __post_init__(self) -> None:
        check_range("--episodes", self.episodes, 1)
        check_overwrite(self.overwrite, self.json, self.save_map)
        if self.joint_map is not None:
            if self.save_map is not None:
                raise CEIError("--joint_map is a map already; leave out --save_map.")
            if (self.state, self.action) != (InspectConfig.state, InspectConfig.action):
                raise CEIError("--joint_map says which features it maps; leave out --state and --action.")
        if self.save_map is not None and self.source is None:
            raise CEIError("--save_map needs --source=<Arm>-<EndEffector>: whose joints they are.")


def inspect(config: InspectConfig) -> dict[str, Any]:
    """Print a table of columns, what is wrong in plain words, and a joint map.

    Returns:
        Columns, problems, the proposed map or None, and how long steps took or None.

    Raises:
        CEIError: bad options, or a dataset that cannot be read.
    """
    from cei_converters.cli.outputs import JOINT_MAP, JSON, Outputs
    from cei_converters.cli.result import write_json
    from cei_converters.cli.table import print_table
    from cei_converters.inspection.columns import look_at
    from cei_converters.inspection.findings import problems
    from cei_converters.sources.formats import read_recordings
    from cei_converters.sources.joint_map import load_joint_map
    from cei_gym.embodiment import use_package_path

    use_package_path(config.package_path)
    outputs = Outputs(config.overwrite)
    json = outputs.file("--json", config.json, JSON)
    file = outputs.file("--save_map", config.save_map, JOINT_MAP)
    mapped = None if config.joint_map is None else load_joint_map(config.joint_map)
    if mapped is not None and config.source is None and mapped.embodiment is None:
        raise CEIError("the joint map does not name its embodiment; give --source=<Arm>-<EndEffector>.")
    state, action = (config.state, config.action) if mapped is None else (mapped.state, _feature(mapped, config.action))
    recordings = read_recordings(config.dataset.repo_id, config.dataset.root, config.episodes, state, action)
    columns = look_at(recordings)
    frames = sum(len(episode.state) for episode in recordings.episodes)
    title = f"{config.dataset.repo_id}: {len(recordings.episodes)} of {recordings.total} episodes, {frames} frames"
    print_table([column.row() for column in columns], title)
    if recordings.step_time_s is not None and recordings.fps is not None:
        print(recordings.step_time_s.sentence(recordings.fps))
    of_joints, explained, proposal = _joints(config, mapped, recordings, columns)
    found = problems(recordings, columns, explained) + of_joints
    if explained and mapped is None:
        print("Columns are the robot's joints by their names: cei-convert takes them as they are, without a joint map.")
    print("\n".join(f"- {problem}" for problem in found) or "Nothing is wrong.")
    if proposal is not None:
        _print_map(proposal, config, file)
    result = {
        "columns": columns,
        "problems": found,
        "proposal": proposal,
        "step_time_s": recordings.step_time_s,
    }
    write_json(json, result)
    if file is not None and proposal is None:
        if explained:
            raise CEIError(
                f"columns are the robot's joints by their names, so no joint map is proposed, and {file} is not made."
            )
        why = of_joints[0] if of_joints else "nothing here tells columns and joints."
        raise CEIError(f"no joint map could be proposed, so {file} is not made: {why}")
    return result


def _feature(mapped: "JointMap", default: str) -> str | None:
    """Where a joint map has actions."""
    from cei_converters.sources.actions import action_map
    from cei_converters.sources.joint_map import ActionMap

    said = action_map(mapped, ActionMap(feature=default))
    return None if said is None else said.feature


def _joints(
    config: InspectConfig, mapped: "JointMap | None", recordings: "Recordings", columns: "Sequence[Column]"
) -> tuple[list[str], bool, dict[str, Any] | None]:
    """What is wrong with joints, whether a map or names say which they are, and else a map."""
    from cei_converters.inspection.joints import check_joints
    from cei_converters.inspection.proposal import propose, wrong_sides
    from cei_converters.sources.formats import open_source
    from cei_gym.embodiment import load_embodiment

    at, read = (config.dataset.repo_id, config.dataset.root), [recording.index for recording in recordings.episodes]
    try:
        source = open_source(*at, embodiment=config.source, joint_map=config.joint_map, joints_only=True)
    except CEIError as error:
        if mapped is not None:
            return [str(error)], True, None
        if config.source is None:
            return [], False, None
        proposal = propose(columns, load_embodiment(config.source))
        if proposal.joint_map is None:
            return proposal.doubts, False, None
        found, proposed = _tried(config, proposal.joint_map, recordings)
        return found, False, proposed
    found = [] if mapped is None or not mapped.joints else wrong_sides(mapped, source.embodiment, recordings.names)
    return found + check_joints(source, read), True, None


def _tried(
    config: InspectConfig, proposed: dict[str, Any], recordings: "Recordings"
) -> tuple[list[str], dict[str, Any] | None]:
    """What is wrong with joints by a proposed map, and the map, if it can be read by."""
    import tempfile

    import yaml

    from cei_converters.inspection.joints import check_joints
    from cei_converters.sources.formats import open_source

    if recordings.fps is None:
        return ["a joint map is not proposed: it needs fps, which nothing here says."], None
    if config.state != _STATE:
        proposed = proposed | {"state": config.state}
    if any(recording.action is None for recording in recordings.episodes) or not recordings.same_columns:
        proposed = proposed | {"action": None}
    elif config.action != _ACTION:
        proposed = proposed | {"action": config.action}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "proposed.yaml")
        path.write_text(yaml.safe_dump(proposed))
        try:
            source = open_source(config.dataset.repo_id, config.dataset.root, joint_map=path, joints_only=True)
            found = check_joints(source, [recording.index for recording in recordings.episodes])
        except CEIError as error:
            return [str(error)], None
    return found, proposed


def _print_map(proposal: dict[str, Any], config: InspectConfig, file: "Output | None") -> None:
    import yaml

    text = yaml.safe_dump(proposal, sort_keys=False, default_flow_style=None)
    print(f"Proposed joint map, to be checked:\n{text}")
    if file is not None:
        with file.whole() as partial:
            partial.write_text(f"# Proposed by cei-inspect for {config.dataset.repo_id}; check it.\n{text}")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-inspect`."""
    return run(InspectConfig, inspect, args, prog="cei-inspect", example=EXAMPLE)
