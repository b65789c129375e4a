"""`cei-inspect`: what is in a dataset, what is wrong with it, and which of its columns are which joints."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cei_converters.cli import DatasetConfig, run
from cei_converters.cli.options import check_overwrite, check_range
from cei_converters.sources import joint_map, pose
from cei_gym.errors import CEIError

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
        Columns, problems, and the proposed map or None.

    Raises:
        CEIError: bad options, or a dataset that cannot be read.
    """
    import yaml

    from cei_converters.cli.outputs import JOINT_MAP, JSON, Outputs
    from cei_converters.cli.result import write_json
    from cei_converters.cli.table import print_table
    from cei_converters.inspection.findings import check_map, look_at, problems, propose
    from cei_converters.sources.formats import read_recordings
    from cei_converters.sources.joint_map import load_joint_map
    from cei_gym.embodiment import load_embodiment, use_package_path

    use_package_path(config.package_path)
    outputs = Outputs(config.overwrite)
    json = outputs.file("--json", config.json, JSON)
    file = outputs.file("--save_map", config.save_map, JOINT_MAP)
    mapped = None if config.joint_map is None else load_joint_map(config.joint_map)
    name = config.source or (mapped.embodiment if mapped is not None else None)
    if mapped is not None and mapped.embodiment not in (None, name):
        raise CEIError(f"{config.joint_map} is a map of {mapped.embodiment}; leave out --source={config.source}.")
    if mapped is not None and name is None:
        raise CEIError("the joint map does not name its embodiment; give --source=<Arm>-<EndEffector>.")
    embodiment = None if name is None else load_embodiment(name)
    state, action = (config.state, config.action) if mapped is None else (mapped.state, mapped.action)
    recordings = read_recordings(config.dataset.repo_id, config.dataset.root, config.episodes, state, action)
    columns = look_at(recordings)
    frames = sum(len(episode.state) for episode in recordings.episodes)
    title = f"{config.dataset.repo_id}: {len(recordings.episodes)} of {recordings.total} episodes, {frames} frames"
    print_table([column.row() for column in columns], title)
    found = problems(recordings, columns)
    proposal = None
    if mapped is not None and embodiment is not None:
        found += check_map(recordings, mapped, embodiment)
    elif embodiment is not None:
        proposal = propose(recordings, columns, embodiment)
        if proposal is None:
            found.append(f"no columns look like joints of {embodiment.name}; is it the right robot?")
    print("\n".join(f"- {problem}" for problem in found) or "Nothing is wrong.")
    if proposal is not None:
        text = yaml.safe_dump(proposal, sort_keys=False, default_flow_style=None)
        print(f"Proposed joint map, a guess to be checked:\n{text}")
        if file is not None:
            with file.whole() as partial:
                partial.write_text(
                    f"# Proposed by cei-inspect for {config.dataset.repo_id}: a guess; check it.\n{text}"
                )
    result = {"columns": columns, "problems": found, "proposal": proposal}
    write_json(json, result)
    if file is not None and proposal is None:
        raise CEIError(f"there is no joint map to save, so {file} is not made.")
    return result


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-inspect`."""
    return run(InspectConfig, inspect, args, prog="cei-inspect", example=EXAMPLE)
