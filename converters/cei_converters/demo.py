"""`make demo`: record demonstrations on a Panda, convert them to an IIWA with an Inspire hand, replay both, write a report."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

from cei_converters.cli import DatasetConfig, SourceConfig, run
from cei_converters.cli.options import check_range
from cei_gym.errors import CEIError

SOURCE, TARGET = "Panda-PandaGripper", "IIWA-Inspire"
EXAMPLE = """example:
  python -m cei_converters.demo --episodes=2 --output=outputs/short_demo"""
_MARK = ".cei-demo"
"""Tells a folder that an earlier demo made, which this one may make anew."""


@dataclass
class DemoConfig:
    """Move a skill from a Panda to an IIWA with an Inspire hand, and show it on one page."""

    episodes: int = 10  # Demonstrations to record.
    seed: int = 1000  # Of the first one.
    output: Path = Path("outputs/demo")  # Folder for the report and the datasets; that of an earlier demo is made anew.

    def __post_init__(self) -> None:
        check_range("--episodes", self.episodes, 1)
        check_range("--seed", self.seed, 0)


def commands(config: DemoConfig) -> list[str]:
    """What does the same by hand."""
    return [
        f"cei-record --env=CEI-PickCube-{SOURCE} --episodes={config.episodes} --seed={config.seed} \\\n"
        "    --repo_id=me/pick_cube_panda --root=data/pick_cube_panda",
        f"cei-convert --dataset.repo_id=me/pick_cube_panda --dataset.root=data/pick_cube_panda --target={TARGET} \\\n"
        "    --new_repo_id=me/pick_cube_iiwa --new_root=data/pick_cube_iiwa",
        "cei-replay --dataset.repo_id=me/pick_cube_iiwa --dataset.root=data/pick_cube_iiwa \\\n"
        "    --source.repo_id=me/pick_cube_panda --source.root=data/pick_cube_panda",
    ]


def demo(config: DemoConfig) -> None:
    """Run the demo, by what the commands run.

    Raises:
        CEIError: bad options, or the output is a folder that no demo has made.
    """
    from cei_converters.conversion.config import ConvertConfig
    from cei_converters.convert import convert
    from cei_converters.record import RecordConfig, record
    from cei_converters.replay import ReplayConfig, replay
    from cei_converters.report import write_report
    from cei_converters.sources.reader import DatasetReader

    folder = config.output
    if folder.exists() and not (folder / _MARK).is_file():
        raise CEIError(f"--output={folder} exists, and no demo made it; choose another folder or remove it first.")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / _MARK).touch()
    source = DatasetConfig("me/pick_cube_panda", folder / "pick_cube_panda")
    target = DatasetConfig("me/pick_cube_iiwa", folder / "pick_cube_iiwa")
    print(f"1/4 recording {config.episodes} demonstrations of {SOURCE}")
    record(RecordConfig(f"CEI-PickCube-{SOURCE}", source.repo_id, source.root, config.episodes, config.seed))
    print(f"2/4 converting them for {TARGET}")
    result = folder / "conversion.json"
    convert(ConvertConfig(source, TARGET, target.repo_id, target.root, json=result))
    print("3/4 replaying the source")
    replays = [replay(ReplayConfig(source, video_episodes=0))]
    print("4/4 replaying the target")
    beside = SourceConfig(source.repo_id, source.root)
    replays.append(replay(ReplayConfig(target, beside, video=folder / "side_by_side.mp4")))
    first, second = (DatasetReader(dataset.repo_id, dataset.root).read(0) for dataset in (source, target))
    report = folder / "report.html"
    write_report(report, replays, json.loads(result.read_text()), (first, second), commands(config))
    print(f"\nOpen {report}: {replays[1]['successes']} of {config.episodes} transferred demonstrations lift the cube.")


def main(args: list[str] | None = None) -> int:
    """Entry point of `make demo`."""
    return run(DemoConfig, demo, args, prog="python -m cei_converters.demo", example=EXAMPLE)


if __name__ == "__main__":
    raise SystemExit(main())
