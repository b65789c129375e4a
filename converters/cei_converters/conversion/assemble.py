"""What is written of a dataset becomes one: picture, licenses, metadata, card."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from cei_converters.conversion.converter import Converter
from cei_converters.conversion.episode import Outcome
from cei_converters.conversion.outcomes import Summary, outcomes
from cei_converters.conversion.placing import PLACE_PICTURE
from cei_converters.conversion.plan import Plan
from cei_converters.conversion.shard import Shard
from cei_converters.conversion.staging import StagingDirectory
from cei_converters.conversion.writing import Writing
from cei_converters.dataset.license import copy_license_files
from cei_converters.dataset.metadata import PICTURE_PATH, START, Environment, Metadata, Provenance, plain
from cei_converters.dataset.starts import middle
from cei_converters.dataset.writer import publish_dataset
from cei_gym.transfer import Transfer


def assemble(place: StagingDirectory, plan: Plan, converter: Converter, summary: Summary, writing: Writing) -> None:
    """Complete the dataset, and move it to where it is wanted.

    Args:
        place: with all shards.
        plan: of the conversion.
        converter: fitted.
        summary: what became of the episodes.
        writing: of its files, which has begun.

    Raises:
        CEIError: a video that pictures pass through from is not there any more.
        OSError: a shard is damaged, or the files could not be written.
    """
    from cei_converters.conversion.quality_picture import write_summary  # and matplotlib

    picture = place.folder / Path(PICTURE_PATH).name
    write_summary(picture, outcomes(place, plan), plan.config.gate, converter)
    written = writing.result()
    picture.rename(written / PICTURE_PATH)
    if (place.folder / PLACE_PICTURE).exists():
        (place.folder / PLACE_PICTURE).rename(written / "meta" / PLACE_PICTURE)
    copy_license_files(converter.reader.root, written)
    header = Shard(place.shard(0)).header
    metadata = Metadata(
        embodiment=header.embodiment,
        scene=header.scene,
        environment=_with_start(converter.environment, outcomes(place, plan)),
        clouds=plain(plan.config.clouds),
        total_episodes=len(summary.entries),
        provenance=_with_choices(plan, converter.transfer, summary),
    )
    publish_dataset(written, place.root, str(plan.config.new_repo_id), metadata)


def _with_choices(plan: Plan, transfer: Transfer, summary: Summary) -> Provenance:
    """Provenance with what was decided on the way: where trajectories start, on which pads, which episodes are dropped."""
    pads = {e.name: plain(e.end_effector.pads) for e in (transfer.source, transfer.target) if e.end_effector}
    provenance = plan.provenance
    options = provenance.options | {"basins": plain(transfer.basins)}
    if summary.verified is not None and "verify" in options:
        options["verify"] = options["verify"] | {"dropped": summary.verified["dropped"]}
    if summary.strays is not None:
        options["strays"] = summary.strays
    for name, found in (("common", plan.correction), ("start", plan.chosen)):
        if found is not None:
            options["refine"] = options["refine"] | {name: plain(found)}
    if summary.evidence is not None and summary.evidence["dropped"]:
        options["evidence"] = options["evidence"] | {"dropped": summary.evidence["dropped"]}
    if summary.judged is not None:
        options["gate"] = summary.judged
    return replace(provenance, pads=pads, options=options)


def _with_start(environment: Environment, found: Iterable[Outcome]) -> Environment:
    """The environment with episodes that start where the demonstrations of each mode do: a policy knows no other way."""
    if environment.id is None:
        return environment
    starts: dict[int, list[list[float]]] = defaultdict(list)
    for outcome in found:
        if not outcome.left_out:
            starts[outcome.mode].append(outcome.start_qpos)
    middles = [middle(qpos) for _, qpos in sorted(starts.items())]
    return replace(environment, kwargs=environment.kwargs | {START: middles})
