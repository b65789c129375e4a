"""Whatever is wrong with what users bring: one clear line, an exit code, no hang, and nothing written."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cei_converters import cli, convert, pads, replay

TARGET = "IIWA-Inspire"


@dataclass
class ReadConfig:
    """Read all of a dataset."""

    root: str  # Its folder.


def read(config: ReadConfig) -> None:
    """All that a conversion would."""
    from cei_converters.reader import DatasetReader

    reader = DatasetReader("me/pick", config.root)
    reader.check_videos(range(len(reader)))
    for index in range(len(reader)):
        demonstration = reader.read(index)
        assert len(demonstration) == reader.frames(index)
        assert np.isfinite(demonstration.qpos).all()
        reader.pictures(index)


def _convert(folder: Path, out: Path, *options: str) -> int:
    args = ["--dataset.repo_id=me/pick", f"--dataset.root={folder}", f"--target={TARGET}", "--new_repo_id=me/out"]
    return convert.main([*args, f"--new_root={out / 'made'}", "--init.starts=8", "--init.basins=1", *options])


COMMANDS = {
    "pads": lambda folder, out: pads.main([f"--end_effector={folder / 'hand.yaml'}", f"--output={out / 'made'}.png"]),
    "convert": _convert,
    "calibrate": lambda folder, out: _convert(folder, out, f"--calibration={folder / 'cameras.yaml'}"),
    "replay": lambda folder, _: replay.main(["--dataset.repo_id=me/pick", f"--dataset.root={folder}"]),
    "read": lambda folder, _: cli.run(ReadConfig, read, [f"--root={folder}"], prog="read", example=""),
}
