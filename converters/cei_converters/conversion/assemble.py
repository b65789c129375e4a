"""Shards become a dataset."""

from collections import defaultdict
from dataclasses import replace

import numpy as np

from cei_converters.conversion.converter import Converter
from cei_converters.conversion.outcomes import Account, outcomes
from cei_converters.conversion.plan import Plan
from cei_converters.conversion.quality_picture import write_summary
from cei_converters.conversion.shard import Shard
from cei_converters.conversion.workplace import Workplace
from cei_converters.dataset.cameras import Pictures
from cei_converters.dataset.license import copy_license_files
from cei_converters.dataset.metadata import PICTURE_PATH, START, Environment, Provenance, plain
from cei_converters.dataset.starts import middle
from cei_converters.dataset.writer import DatasetWriter
from cei_gym.transfer import Transfer


def assemble(place: Workplace, plan: Plan, converter: Converter, told: Account) -> None:
    """Write the dataset, and move it to where it is wanted.

    Args:
        place: with all shards.
        plan: of the conversion.
        converter: fitted.
        told: what became of the episodes.

    Raises:
        CEIError: pictures that pass through are missing.
        OSError: a shard is damaged.
    """
    config, reader = plan.config, converter.reader
    assert config.new_repo_id is not None
    starts: dict[int, list[list[float]]] = defaultdict(list)
    with DatasetWriter(
        config.new_repo_id,
        place.root,
        environment=converter.environment,
        clouds=plain(config.clouds),
        provenance=_with_choices(plan.provenance, converter.transfer, told),
        cameras=converter.cameras,
        carried=reader.carried,
        tasks=reader.tasks,
        partial=place.dataset,
    ) as writer:
        for number in range(len(plan.shards)):
            shard = Shard(place.shard(number))
            shard.check()
            for converted in shard:
                if converted.encoded is not None:
                    outcome = converted.outcome
                    frames = outcome["record"].get("source_frames")
                    pictures = reader.pictures(outcome["entry"]["episode"]) if converter.cameras else Pictures()
                    frames = None if frames is None else np.array(frames)
                    carried = reader.carry(outcome["entry"]["episode"]).at(frames)
                    writer.append(converted.header, converted.encoded, outcome["record"], pictures.at(frames), carried)
                    starts[outcome["mode"]].append(outcome["start_qpos"])
        writer.environment = _with_start(writer.environment, starts)
        copy_license_files(reader.root, place.dataset)
        write_summary(place.dataset / PICTURE_PATH, outcomes(place, plan), config.gate, converter)


def _with_choices(provenance: Provenance, transfer: Transfer, told: Account) -> Provenance:
    """Provenance with what was decided on the way: where trajectories start, on which pads, which episodes are dropped."""
    pads = {e.name: plain(e.end_effector.pads) for e in (transfer.source, transfer.target) if e.end_effector}
    options = provenance.options | {"basins": plain(transfer.basins)}
    if told.verified is not None:
        options["verify"] = options["verify"] | {"dropped": told.verified["dropped"]}
    if told.judged is not None:
        options["gate"] = told.judged
    return replace(provenance, pads=pads, options=options)


def _with_start(environment: Environment, starts: dict[int, list[list[float]]]) -> Environment:
    """The environment with episodes that start where the demonstrations of each mode do: a policy knows no other way."""
    if environment.id is None:
        return environment
    middles = [middle(qpos) for _, qpos in sorted(starts.items())]
    return replace(environment, kwargs=environment.kwargs | {START: middles})
