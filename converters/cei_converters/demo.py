"""`make demo`: record ten demonstrations on a Panda, convert them to an IIWA with an Inspire hand, replay both."""

import shutil
from pathlib import Path

from cei_converters.cli import DatasetConfig, SourceConfig, quiet_libraries
from cei_converters.conversion.config import ConvertConfig
from cei_converters.convert import convert
from cei_converters.record import RecordConfig, record
from cei_converters.replay import ReplayConfig, replay
from cei_converters.report import write_report
from cei_converters.sources.reader import DatasetReader
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment

SOURCE, TARGET = "Panda-PandaGripper", "IIWA-Inspire"
EPISODES, SEED = 10, 1000
FOLDER = Path("outputs/demo")

COMMANDS = [
    f"cei-record --env=CEI-PickCube-{SOURCE} --episodes={EPISODES} --seed={SEED} "
    "--repo_id=me/pick_cube_panda --root=data/pick_cube_panda",
    "cei-convert --dataset.repo_id=me/pick_cube_panda --dataset.root=data/pick_cube_panda "
    f"--target={TARGET} --new_repo_id=me/pick_cube_iiwa --new_root=data/pick_cube_iiwa",
    "cei-replay --dataset.repo_id=me/pick_cube_iiwa --dataset.root=data/pick_cube_iiwa "
    "--source.repo_id=me/pick_cube_panda --source.root=data/pick_cube_panda",
]


def main() -> None:
    """Run the demo; its folder is made anew."""
    quiet_libraries()
    shutil.rmtree(FOLDER, ignore_errors=True)
    source = DatasetConfig("me/pick_cube_panda", str(FOLDER / "pick_cube_panda"))
    target = DatasetConfig("me/pick_cube_iiwa", str(FOLDER / "pick_cube_iiwa"))
    print(f"1/4 recording {EPISODES} demonstrations of {SOURCE}")
    record(RecordConfig(f"CEI-PickCube-{SOURCE}", source.repo_id, source.root, EPISODES, SEED))
    print(f"2/4 converting them for {TARGET}")
    conversion = convert(ConvertConfig(source, TARGET, target.repo_id, target.root))
    print("3/4 replaying the source")
    replays = [replay(ReplayConfig(source, video_episodes=0))]
    print("4/4 replaying the target")
    beside = SourceConfig(source.repo_id, source.root)
    replays.append(replay(ReplayConfig(target, beside, video=str(FOLDER / "side_by_side.mp4"))))
    episodes = _first_episode(source), _first_episode(target)
    embodiments = [load_embodiment(SOURCE), load_embodiment(TARGET)]
    write_report(FOLDER / "report.html", replays, conversion, episodes, embodiments, COMMANDS)
    print(
        f"\nOpen {FOLDER / 'report.html'}: {replays[1]['successes']} of {EPISODES} transferred demonstrations lift the cube."
    )


def _first_episode(dataset: DatasetConfig) -> Demonstration:
    return DatasetReader(dataset.repo_id, dataset.root).read(0)


if __name__ == "__main__":
    main()
