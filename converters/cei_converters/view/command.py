"""`cei-view`: look at one episode of a dataset, or at a converted episode beside its source."""

import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cei_converters.cli import DatasetConfig, SourceConfig, run
from cei_converters.cli.options import check_overwrite, check_range
from cei_gym import extras
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-view --dataset.repo_id=me/pick_panda --dataset.root=data/pick_panda
  cei-view --dataset.repo_id=me/pick_iiwa --dataset.root=data/pick_iiwa \\
      --source.repo_id=me/pick_panda --source.root=data/pick_panda --episode=3 \\
      --rrd=outputs/pick_iiwa.rrd --sheet=outputs/pick_iiwa.png
  rerun outputs/pick_iiwa.rrd"""


@dataclass
class MappedSourceConfig(SourceConfig):
    """The dataset that another was converted from, to show beside it."""

    joint_map: Path | None = None  # Its joint map, if it was converted with one.


@dataclass
class ViewConfig:
    """Show an episode's robot, pads, clouds, cameras and joints over time, in rerun's viewer or in a file."""

    dataset: DatasetConfig
    source: MappedSourceConfig = field(
        default_factory=MappedSourceConfig
    )  # Shown beside it, with how far the pads are apart.
    joint_map: Path | None = None  # Of a dataset that was recorded elsewhere; see cei-convert --help.
    episode: int = 0  # Which episode of the dataset.
    rrd: Path | None = None  # Recording to write instead of opening the viewer, in place of what is there.
    sheet: Path | None = None  # Contact sheet (PNG) to write instead of opening the viewer, in place of what is there.
    package_path: list[Path] | None = None  # Folders to look for robots' ROS packages in, separated by colons.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace a JSON file that is there already.

    def __post_init__(self) -> None:
        check_overwrite(self.overwrite, self.json)
        check_range("--episode", self.episode, 0)


def view(config: ViewConfig) -> dict[str, Any]:
    """Show an episode; returns what was shown, and the residuals if its source was shown too.

    Raises:
        CEIError: bad options or data, a file that must not be replaced, or a viewer without a display.
    """
    from cei_converters.cli.outputs import JSON, PICTURE, RECORDING, Outputs
    from cei_converters.cli.result import write_json
    from cei_converters.sources.formats import open_source
    from cei_converters.view.episode import load_view
    from cei_gym.embodiment import use_package_path

    if config.sheet is None or config.rrd is not None:
        extras.require("cei-view", "view")
    use_package_path(config.package_path)
    outputs = Outputs(config.overwrite)
    json = outputs.file("--json", config.json, JSON)
    rrd, sheet = outputs.file("--rrd", config.rrd, RECORDING), outputs.file("--sheet", config.sheet, PICTURE)
    opens_viewer = rrd is None and sheet is None
    if opens_viewer and not _has_display():
        raise CEIError(
            "there is no display to open the viewer on; save --rrd=<file>.rrd or --sheet=<file>.png instead."
        )
    reader = open_source(config.dataset.repo_id, config.dataset.root, joint_map=config.joint_map)
    source = None
    if config.source.repo_id is not None:
        source = open_source(config.source.repo_id, config.source.root, joint_map=config.source.joint_map)
    shown = load_view(reader, config.episode, source, pictures=True)
    if rrd is not None:
        from cei_converters.view.recording import save

        save(shown, rrd.path)
    if sheet is not None:
        from cei_converters.view.sheet import write_sheet

        write_sheet(shown, sheet.path)
    if opens_viewer:
        from cei_converters.view.recording import open_viewer

        open_viewer(shown)
    result = {
        "repo_id": reader.repo_id,
        "episode": config.episode,
        "frames": len(shown),
        "embodiments": {side.role: side.embodiment.name for side in shown.sides},
        "residuals": shown.residuals,
        "correction": shown.correction or None,
        "rrd": config.rrd,
        "sheet": config.sheet,
    }
    write_json(json, result)
    _print(
        f"{shown.title}{shown.correction and f', {shown.correction}'}",
        [output.path for output in (rrd, sheet) if output is not None],
    )
    return result


def _has_display() -> bool:
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _print(title: str, files: list[Path]) -> None:
    where = "Wrote " + " and ".join(map(str, files)) if files else "Closed the viewer"
    print(f"{where}: {title}.")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-view`."""
    return run(ViewConfig, view, args, prog="cei-view", example=EXAMPLE)
