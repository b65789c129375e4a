"""`cei-replay`: execute a dataset's actions in physics, from each episode's recorded start, and count successes."""

import contextlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cei_converters.cli import DatasetConfig, SourceConfig, run
from cei_converters.cli.options import check_overwrite, check_range, parse_episodes
from cei_converters.simulation.stage import Stage
from cei_gym.arrays import Array
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.cli.outputs import Output, Outputs
    from cei_converters.sources.reader import DatasetReader
    from cei_converters.sources.source import Source

EXAMPLE = """example:
  cei-replay --dataset.repo_id=me/pick_iiwa --dataset.root=data/pick_iiwa
  cei-replay --dataset.repo_id=me/pick_iiwa --dataset.root=data/pick_iiwa \\
      --source.repo_id=me/pick_panda --source.root=data/pick_panda --video=outputs/pick_iiwa.mp4"""


@dataclass
class ReplayConfig:
    """Replay a dataset in simulation and report how often it succeeds."""

    dataset: DatasetConfig
    source: SourceConfig = field(default_factory=SourceConfig)  # Shown beside it in the video.
    env: str | None = None  # Environment id; default: the one that the dataset names.
    stock_physics: bool = False  # Without the embodiment's physics exceptions, but for those that it cannot do without.
    # Also replay each episode so many times slightly otherwise: objects 3 mm away, friction x0.8 to 1.2, the arm's joints off by some 2 mrad.
    perturb: int = 0
    episodes: str | None = None  # Episodes to replay, such as 0,3,5 or 0-99; default: all.
    # MP4 to write, and a contact sheet (PNG) beside it, in place of what is there; default: outputs/replay/<name>.mp4.
    video: Path | None = None
    video_episodes: int = 3  # How many episodes the video shows; 0 writes none.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace a JSON file that is there already.

    def __post_init__(self) -> None:
        parse_episodes(self.episodes)
        check_range("--perturb", self.perturb, 0)
        check_range("--video_episodes", self.video_episodes, 0)
        check_overwrite(self.overwrite, self.json)
        for option, given in (("--video", self.video), ("--source.repo_id", self.source.repo_id)):
            if self.video_episodes == 0 and given is not None:
                raise CEIError(f"{option} is of no use with --video_episodes=0, which writes no video.")


def replay(config: ReplayConfig) -> dict[str, Any]:
    """Replay a dataset; print successes with a Wilson interval, the reasons of failure, and how long steps took.

    Raises:
        CEIError: bad options or data, or no environment to replay in.
    """
    from cei_converters.cli.outputs import JSON, Outputs
    from cei_converters.cli.progress import progress_bar
    from cei_converters.cli.result import write_json
    from cei_converters.dataset.metadata import plain
    from cei_converters.dataset.step_time import STEP_TIMES, StepTime
    from cei_converters.simulation.perturbation import perturbations
    from cei_converters.sources.reader import DatasetReader

    outputs = Outputs(config.overwrite)
    json, film = outputs.file("--json", config.json, JSON), _film_of(config, outputs)
    reader = DatasetReader(config.dataset.repo_id, config.dataset.root)
    selected = reader.select(parse_episodes(config.episodes))
    with contextlib.ExitStack() as stack:
        stage = stack.enter_context(stage_of(reader, config.env, config.stock_physics))
        beside = None
        if config.source.repo_id is not None:
            source = DatasetReader(config.source.repo_id, config.source.root)
            beside = source, stack.enter_context(stage_of(source))
        results, films = [], []
        progress = stack.enter_context(progress_bar("episodes"))
        task = progress.add_task(f"replaying {reader.embodiment.name}", total=len(selected) * (1 + config.perturb))
        for index in selected:
            filmed = film is not None and len(films) < config.video_episodes
            demonstration = reader.read(index, clouds=False)
            entry, pictures = stage.play(demonstration, filmed)
            progress.advance(task)
            if config.perturb:
                entry["perturbed"] = []
                for perturbation in perturbations(demonstration, config.perturb, reader.embodiment.n_arm):
                    entry["perturbed"].append(stage.play(demonstration, perturbation=perturbation)[0]["success"])
                    progress.advance(task)
            results.append(entry)
            if filmed:
                films.append(film_beside(reader, beside, entry, pictures))
    step_time = StepTime.of(results, reader.fps)
    for entry in results:
        entry.pop(STEP_TIMES, None)  # a line each, in files that are kept
    result = {
        "repo_id": reader.repo_id,
        "env": stage.env_id,
        "stock_physics": stage.stock_physics,
        "embodiment": reader.embodiment.name,
        "physics": stage.physics.record(),
        "episodes": len(results),
        "successes": sum(entry["success"] for entry in results),
        "interval_95": wilson(sum(entry["success"] for entry in results), len(results)),
        "failures": dict(Counter(entry["failure"] for entry in results if not entry["success"])),
        "perturbed": held_of(results) if config.perturb else None,
        "step_time_s": plain(step_time),
        "video": None if film is None else str(film.video),
        "results": results,
    }
    if film is not None:
        _write_films(film, films, reader.fps)
    write_json(json, result)
    _print(result)
    if step_time is not None:
        print(step_time.sentence(reader.fps))
    return result


def stage_of(reader: "Source", env_id: str | None = None, stock_physics: bool = False) -> Stage:
    """The environment that a dataset names, or another.

    Args:
        reader: of the dataset.
        env_id: the other one.
        stock_physics: without the embodiment's physics exceptions.

    Raises:
        CEIError: it names none, or there is none of that name.
    """
    kwargs = reader.environment.kwargs if env_id is None else {}
    env_id = env_id or reader.environment.id
    if env_id is None:
        raise CEIError(f"{reader.repo_id} does not say which environment it replays in; name it with --env.")
    return Stage(env_id, **(kwargs | {"stock_physics": True} if stock_physics else kwargs))


def film_beside(
    reader: "DatasetReader",
    beside: "tuple[Source, Stage] | None",
    entry: dict[str, Any],
    pictures: list[Array],
) -> tuple[list[list[Array]], list[str]]:
    """Views and their labels: the source, where it is known, then the replayed episode.

    Args:
        reader: of the dataset.
        beside: of its source, and that one's environment.
        entry, pictures: what `Stage.play` gave of the episode.

    Raises:
        CEIError: the source has no such episode, or it is not of the environment's robot.
    """
    views, labels = [pictures], [_label(reader, entry)]
    if beside is not None:
        source, stage = beside
        index = reader.source_episode(entry["episode"])
        source_entry, source_pictures = stage.play(source.read(index, clouds=False), filmed=True)
        views.insert(0, source_pictures)
        labels.insert(0, _label(source, source_entry))
    return views, labels


def _label(reader: "Source", entry: dict[str, Any]) -> str:
    verdict = "success" if entry["success"] else entry["failure"]
    return f"{reader.embodiment.name}, episode {entry['episode']}: {verdict}"


@dataclass(frozen=True)
class _Film:
    """The video that is asked for, and the contact sheet beside it."""

    video: "Output"
    sheet: "Output"


def _film_of(config: ReplayConfig, outputs: "Outputs") -> _Film | None:
    from cei_converters.cli.outputs import PICTURE, VIDEO

    if config.video_episodes == 0:
        return None
    path = config.video or Path("outputs/replay", f"{config.dataset.repo_id.split('/')[-1]}.mp4")
    video = outputs.file("--video", path, VIDEO)
    sheet = outputs.file("the contact sheet of --video", Path(path).with_suffix(".png"), PICTURE)
    assert video is not None and sheet is not None
    return _Film(video, sheet)


def _write_films(film: _Film, films: list[Any], fps: float) -> None:
    from PIL import Image

    from cei_converters.simulation.video import contact_sheet, side_by_side, write_video

    frames = [frame for views, labels in films for frame in side_by_side(views, labels)]
    with film.video.whole() as partial:
        write_video(partial, frames, int(fps))
    with film.sheet.whole() as partial:
        Image.fromarray(contact_sheet(*films[0])).save(partial, format="PNG")


def wilson(successes: int, n: int) -> tuple[float, float]:
    """Between which shares a rate lies with 95 % confidence (Wilson), from `successes` of `n`."""
    from scipy.stats import binomtest

    interval = binomtest(successes, n).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)


def held_of(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Which share of perturbed replays succeeds, and its interval: replays of one episode are much alike, so an episode counts once (Wilson, 95 %,
    of the nearest whole number of episodes)."""
    shares = [sum(entry["perturbed"]) / len(entry["perturbed"]) for entry in results]
    share = sum(shares) / len(shares)
    return {
        "replays": len(results[0]["perturbed"]),
        "share": share,
        "interval_95": wilson(round(share * len(shares)), len(shares)),
    }


def _print(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    low, high = result["interval_95"]
    table = Table(title=f"Replay of {result['repo_id']} in {result['env']}")
    for column in ("embodiment", "episodes", "successes", "rate", "95 % (Wilson)", "failures"):
        table.add_column(column)
    failures = ", ".join(f"{reason}: {count}" for reason, count in result["failures"].items()) or "-"
    rate = result["successes"] / result["episodes"]
    table.add_row(
        result["embodiment"],
        str(result["episodes"]),
        str(result["successes"]),
        f"{rate:.0%}",
        f"{low:.0%} to {high:.0%}",
        failures,
    )
    if perturbed := result["perturbed"]:
        low, high = perturbed["interval_95"]
        table.add_row(
            "",
            "",
            f"perturbed, {perturbed['replays']} each",
            f"{perturbed['share']:.0%}",
            f"{low:.0%} to {high:.0%}",
            "",
        )
    Console(width=None if Console().is_terminal else 140).print(table)
    if result["physics"]["joints"]:
        print("By rule, as robosuite does not have this robot (each joint's figures: --json):")
        for rule in result["physics"]["rules"]:
            print("  {part}, {kind}: {says} ({source})".format(**rule))
    if result["video"]:
        print(f"Video: {result['video']}; contact sheet: {Path(result['video']).with_suffix('.png')}.")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-replay`."""
    return run(ReplayConfig, replay, args, prog="cei-replay", example=EXAMPLE)


if __name__ == "__main__":
    from cei_converters import start

    raise SystemExit(start.replay())
