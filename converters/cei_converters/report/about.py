"""What a report says of a dataset as a whole: how it came about, what was taken for granted, what was left out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cei_converters.dataset.card_markdown import flat
from cei_converters.dataset.metadata import Metadata, Provenance
from cei_converters.report.lenient import mapping
from cei_converters.sources.reader import DatasetReader
from cei_gym.alignment.contact.correction import Correction
from cei_gym.errors import CEIError, one_line

_LONG = ("basins", "pads", "gate", "strays", "joint_map")
"""Options that are told elsewhere, or are nobody's to read."""
_SHOWN = 30


@dataclass(frozen=True)
class About:
    """It.

    Attributes:
        facts: name and value of what there is to say at once.
        commands: what made it, in order.
        options: of these commands, by dotted name.
        assumed, dropped: a sentence each.
        common: the correction that episodes have in common; "" if none.
    """

    facts: Sequence[tuple[str, str]]
    commands: Sequence[str]
    options: Sequence[tuple[str, str]]
    assumed: Sequence[str] = ()
    dropped: Sequence[str] = ()
    common: str = ""


def sources(metadata: Metadata) -> list[str]:
    """Robots that it was converted from, each once; none if it was recorded."""
    found = (provenance.source for provenance in metadata.provenances)
    return list(dict.fromkeys(source.embodiment for source in found if source is not None))


def about(reader: DatasetReader, metadata: Metadata, of_source: Metadata | None, size: str) -> About:
    """Of a dataset.

    Args:
        reader: of it.
        metadata: of it, which may be a stranger's.
        of_source: of what it was converted from, if that is known.
        size: how much it is, in words.
    """
    own = metadata.provenance
    named = [f"{p.source.repo_id} ({p.source.embodiment})" for p in metadata.provenances if p.source is not None]
    versions = ", ".join(f"{name} {version}" for name, version in own.versions.items())
    facts = [
        ("dataset", reader.repo_id),
        ("robot", metadata.embodiment),
        ("converted from", ", ".join(dict.fromkeys(named)) or "nothing: it was recorded"),
        ("size", size),
        ("environment", metadata.environment.id or "none is named"),
        ("made", own.date),
        ("commit", own.git_commit or "not of a checkout"),
        ("versions", versions),
    ]
    recorded = [] if of_source is None else [each.command for each in of_source.provenances]
    commands = [*recorded, *(each.command for each in metadata.provenances)]
    return About(
        [(name, one_line(value, 400)) for name, value in facts if value],
        [command for command in dict.fromkeys(commands) if command],
        [(name, one_line(value, 200)) for name, value in flat(_told(own.options))],
        [said for each in metadata.provenances for said in _assumed(each, metadata, reader)],
        [said for each in metadata.provenances for said in _dropped(each)],
        _common(own),
    )


def _told(options: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if name not in _LONG}


def _assumed(provenance: Provenance, metadata: Metadata, reader: DatasetReader) -> list[str]:
    """What was taken for granted."""
    said, table = [], mapping(provenance.options.get("table"))
    if table.get("z_m") is not None:
        said.append(
            f"The table is at z = {one_line(table['z_m'], 20)} m (world), by {one_line(table.get('said_by'), 60)}."
        )
    placed = mapping(provenance.options.get("placed"))
    if placed:
        said.append(f"The target's base was placed by a search: {one_line(placed, 200)}.")
    for robot, notes in provenance.notes.items():
        said += [f"{robot}: {one_line(note, 400)}" for note in notes]
    source = provenance.source
    if source is None:
        return said
    if reader.has_clouds:
        seen = ", ".join(source.depth_cameras)
        said.append(f"Clouds are made of {f'the depth of {seen}' if seen else 'the recorded ones'}.")
        if (metadata.clouds or {}).get("swap", True):
            said.append("In them the source's robot is masked out, and points on the target's meshes are put in.")
        else:
            said.append(f"They still show {source.embodiment} (--clouds.swap=false).")
    if reader.cameras:
        shown = ", ".join(reader.cameras)
        if mapping(provenance.options.get("cameras")).get("paint"):
            said.append(f"In pictures of {shown} the target is painted over {source.embodiment}, by geometry.")
        else:
            said.append(f"Pictures of {shown} still show {source.embodiment}, unless a step has painted others.")
    chosen = mapping(mapping(provenance.options.get("refine")).get("start"))
    if chosen:
        held, best, tried = (one_line(chosen.get(name), 20) for name in ("held", "best_held", "tried"))
        said.append(
            f"Episodes follow from the start, of {tried}, that holds most in replays of some (--refine): a share of {held}, and {best} from the one that "
            "follows best. What is called plain begins there."
        )
    evidence = mapping(provenance.options.get("evidence"))
    if evidence:
        density, friction = (one_line(evidence.get(name), 20) for name in ("density_kg_m3", "friction"))
        said.append(
            f"In twins of the recordings (--evidence), what is held weighs {density} kg/m^3, with friction {friction}."
        )
    if source.carried:
        said.append(f"Carried over as they are: {', '.join(source.carried)}.")
    return said


def _dropped(provenance: Provenance) -> list[str]:
    """What was left out: episodes of the source, by why, and features."""
    options, said = provenance.options, list[str]()
    episodes = [
        (
            mapping(options.get("verify")).get("dropped"),
            "nothing that was tried succeeds in simulation (--verify.drop)",
        ),
        (mapping(options.get("evidence")).get("dropped"), "it fails in a twin of its recording (--evidence.drop)"),
        (mapping(options.get("gate")).get("dropped"), f"of low quality (--min_quality={options.get('min_quality')})"),
    ]
    strays = mapping(options.get("strays"))
    if strays.get("left_out"):
        episodes.append((strays.get("episodes"), "the target goes another way than in the others (--drop_strays)"))
    for which, why in episodes:
        if isinstance(which, list) and which:
            more = ", ..." if len(which) > _SHOWN else ""
            listed = ", ".join(one_line(each, 20) for each in which[:_SHOWN])
            said.append(
                f"{len(which)} {'episode' if len(which) == 1 else 'episodes'} of the source ({listed}{more}): {why}."
            )
    if provenance.source is not None:
        said += [f"Feature {name}: {one_line(why, 200)}." for name, why in provenance.source.dropped.items()]
    return said


def _common(provenance: Provenance) -> str:
    """The correction that all episodes have where it holds no worse."""
    found = mapping(provenance.options.get("refine")).get("common")
    if not isinstance(found, dict):
        return ""
    try:
        return str(Correction(**{name: float(value) for name, value in found.items()}))
    except (CEIError, TypeError, ValueError):
        return "not readable"
