"""`make demo`: record demonstrations on a Panda, convert them to an IIWA with an Inspire hand, replay both, write a report."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cei_converters.cli import DatasetConfig, run
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
    target = "--dataset.repo_id=me/pick_cube_iiwa --dataset.root=data/pick_cube_iiwa"
    source = "--source.repo_id=me/pick_cube_panda --source.root=data/pick_cube_panda"
    return [
        f"cei-record --env=CEI-PickCube-{SOURCE} --episodes={config.episodes} --seed={config.seed} \\\n"
        "    --repo_id=me/pick_cube_panda --root=data/pick_cube_panda",
        f"cei-convert --dataset.repo_id=me/pick_cube_panda --dataset.root=data/pick_cube_panda --target={TARGET} \\\n"
        "    --new_repo_id=me/pick_cube_iiwa --new_root=data/pick_cube_iiwa",
        f"cei-replay {source.replace('source', 'dataset')} --json=replay_of_source.json",
        f"cei-replay {target} --json=replay.json",
        f"cei-report {target} \\\n    {source} \\\n"
        "    --replay=replay_of_source.json:replay.json --films --output=report.html",
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
    from cei_converters.report.command import ReportConfig, report
    from cei_converters.view.command import MappedSourceConfig

    folder = config.output
    if folder.exists() and not (folder / _MARK).is_file():
        raise CEIError(f"--output={folder} exists, and no demo made it; choose another folder or remove it first.")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / _MARK).touch()
    source = DatasetConfig("me/pick_cube_panda", folder / "pick_cube_panda")
    target = DatasetConfig("me/pick_cube_iiwa", folder / "pick_cube_iiwa")
    print(f"1/5 recording {config.episodes} demonstrations of {SOURCE}")
    record(RecordConfig(f"CEI-PickCube-{SOURCE}", source.repo_id, source.root, config.episodes, config.seed))
    print(f"2/5 converting them for {TARGET}")
    convert(ConvertConfig(source, TARGET, target.repo_id, target.root, json=folder / "conversion.json"))
    replays = [folder / "replay_of_source.json", folder / "replay.json"]
    found: list[dict[str, Any]] = []
    for i, (name, dataset, json) in enumerate(zip(("source", "target"), (source, target), replays, strict=True)):
        print(f"{3 + i}/5 replaying the {name}")
        found.append(replay(ReplayConfig(dataset, video_episodes=0, json=json)))
    print("5/5 reporting")
    beside = MappedSourceConfig(source.repo_id, source.root)
    page = ReportConfig(target, folder / "report.html", beside, replays, films=True, json=folder / "report.json")
    report(page, commands(config))
    print(
        f"\nOpen {page.output}: {found[1]['successes']} of {config.episodes} transferred demonstrations lift the cube."
    )


def main(args: list[str] | None = None) -> int:
    """Entry point of `make demo`."""
    return run(DemoConfig, demo, args, prog="python -m cei_converters.demo", example=EXAMPLE)


if __name__ == "__main__":
    raise SystemExit(main())
