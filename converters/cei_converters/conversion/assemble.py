"""Shards become a dataset."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from cei_converters.cameras import Pictures
from cei_converters.conversion.converter import Converter
from cei_converters.conversion.plan import Plan
from cei_converters.conversion.quality_picture import write_summary
from cei_converters.conversion.shard import Shard
from cei_converters.conversion.workplace import Workplace
from cei_converters.metadata import PICTURE_PATH, Environment, Provenance, plain
from cei_converters.writer import DatasetWriter
from cei_gym.transfer import Transfer


def outcomes(place: Workplace, plan: Plan) -> Iterator[dict[str, Any]]:
    """What became of each episode, in order; see `Converted`."""
    for shard in range(len(plan.shards)):
        yield from Shard(place.shard(shard)).outcomes


def assemble(
    place: Workplace,
    plan: Plan,
    converter: Converter,
    verified: dict[str, Any] | None,
    judged: dict[str, list[int]] | None,
) -> None:
    """Write the dataset, and move it to where it is wanted.

    Args:
        place: with all shards.
        plan: of the conversion.
        converter: fitted.
        verified: what verification showed (`summarise`), if it was asked for.
        judged: what the gate lets through (`Gate.judge`), if there is one.

    Raises:
        CEIError: pictures that pass through are missing.
    """
    config, reader = plan.config, converter.reader
    assert config.new_repo_id is not None
    starts: dict[int, list[list[float]]] = defaultdict(list)
    with DatasetWriter(
        config.new_repo_id,
        place.root,
        environment=converter.environment,
        provenance=_with_choices(plan.provenance, converter.transfer, verified, judged),
        cameras=converter.cameras,
        partial=place.dataset,
    ) as writer:
        for shard in range(len(plan.shards)):
            for converted in Shard(place.shard(shard)):
                if converted.encoded is not None:
                    outcome = converted.outcome
                    frames = outcome["record"].get("source_frames")
                    pictures = reader.pictures(outcome["entry"]["episode"]) if converter.cameras else Pictures()
                    pictures = pictures.at(None if frames is None else np.array(frames))
                    writer.append(converted.header, converted.encoded, outcome["record"], pictures)
                    starts[outcome["mode"]].append(outcome["start_qpos"])
        writer.environment = _with_start(writer.environment, starts)
        write_summary(place.dataset / PICTURE_PATH, list(outcomes(place, plan)), config.gate, converter)


def _with_choices(
    provenance: Provenance,
    transfer: Transfer,
    verified: dict[str, Any] | None,
    judged: dict[str, list[int]] | None,
) -> Provenance:
    """Provenance with what was decided on the way: where trajectories start, on which pads, which episodes are dropped."""
    pads = {e.name: plain(e.end_effector.pads) for e in (transfer.source, transfer.target) if e.end_effector}
    options = provenance.options | {"basins": plain(transfer.basins)}
    if verified is not None:
        options["verify"] = options["verify"] | {"dropped": verified["dropped"]}
    if judged is not None:
        options["gate"] = judged
    return replace(provenance, pads=pads, options=options)


def _with_start(environment: Environment, starts: dict[int, list[list[float]]]) -> Environment:
    """The environment with episodes that start where the demonstrations of each mode do: a policy knows no other way."""
    if environment.id is None:
        return environment
    middles = [np.round(np.median(qpos, axis=0), 4).tolist() for _, qpos in sorted(starts.items())]
    return replace(environment, kwargs=environment.kwargs | {"start_qpos": middles})
