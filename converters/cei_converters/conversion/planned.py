"""The plan of a conversion: that of one that was begun, or a new one, for which choices are made."""

from collections.abc import Callable
from dataclasses import replace

from rich.progress import Progress, TaskID

from cei_converters.conversion.config import ConvertConfig
from cei_converters.conversion.converter import Converter
from cei_converters.conversion.origin import provenance_of
from cei_converters.conversion.plan import Plan, absolute
from cei_converters.conversion.staging import StagingDirectory


def planned(
    config: ConvertConfig,
    place: StagingDirectory,
    begun: Plan | None,
    converter: Converter,
    content: Callable[[], str],
    progress: Progress,
    task: TaskID,
) -> Plan:
    """The plan that is gone on with, or a new one; the converter then starts where it says.

    Args:
        config, place, converter: of the conversion.
        begun: the plan that is gone on with.
        content: waits for the dataset's fingerprint.
        progress, task: show how far a search is.

    Raises:
        CEIError: what was begun is not what is wanted now, or an episode cannot be read.
    """
    absolutely = absolute(replace(config, target_pose=converter.target_pose), converter.reader.root)
    if begun is not None:
        begun.check_same(provenance_of(config, converter, content()), place.folder)
        converter.start_from(begun.finalists, begun.correction)
        if config.shard_episodes != begun.config.shard_episodes:
            print(f"Shards stay as they were begun: --shard_episodes={begun.config.shard_episodes}.")
        return replace(begun, config=replace(absolutely, shard_episodes=begun.config.shard_episodes))
    converter.fit()
    chosen, correction = converter.refine(
        lambda total: progress.reset(task, total=total, description="searching how to take hold"),
        lambda done: progress.advance(task, done),
    )
    if chosen is not None:
        print(f"All episodes follow from {chosen}.")
    if correction is not None:
        print(f"All episodes are corrected alike where that holds no worse: {correction}.")
    provenance = provenance_of(config, converter, content())
    frames = [converter.reader.frames(index) for index in converter.selected]
    plan = Plan(absolutely, provenance, converter.transfer.finalists, frames, correction, chosen)
    plan.save(place.plan)
    return plan
