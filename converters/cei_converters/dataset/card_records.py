"""What a card says of a dataset's episodes, by their records."""

from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset.card_markdown import markdown_table
from cei_converters.dataset.metadata import PICTURE_PATH, Metadata
from cei_converters.dataset.records import RECORDS_PATH, Record, Records, fidelity_of, quality_of

PARTS = (
    "An episode's fidelity, from 0 to 1, says how well it follows its source, not whether it works in contact. It is that of its worst part: `residual` (how far pads are from the source's), `limits` "
    "(frames with a joint of the arm at a limit), `jumps` (joints faster than they can be), `clearance` (how deep the robot is in "
    "itself, table or objects) and `reach` (frames out of reach)."
)

_KNOWN_BY = {"replays": "replays in its environment", "twin": "a scene built from its recording"}
_LISTED = "from another start, with another squeeze, with other points on the pads"
_REFINED = "corrections of how the hand takes hold, searched by rollouts"


def quality(root: Path, metadata: Metadata, records: Records) -> str:
    """How well episodes follow, and how likely they work where that is known; empty for a recorded dataset."""
    scored = _spread(
        {"fidelity": found["score"], **found["parts"]} for record in records if (found := fidelity_of(record))
    )
    rows = scored + _spread(record.get("alignment", {}) for record in records)
    if not rows:
        return ""
    parts = ["## Quality", _likely(records)]
    if (root / PICTURE_PATH).is_file():
        parts.append(f"![Scores of all episodes, and the worst ones]({PICTURE_PATH})")
    if scored:
        parts.append(PARTS)
    parts.append(_gated(metadata, records))
    text = f"Over the episodes; per episode in `{RECORDS_PATH}`."
    return "\n\n".join([*filter(None, parts), text, markdown_table(("per episode", "mean", "least", "largest"), rows)])


def _likely(records: Records) -> str:
    """How likely episodes work, where that is known."""
    known, by, n = array("d"), dict[str, None](), 0
    for record in records:
        n += 1
        if found := quality_of(record):
            known.append(found["probability"])
            by[_KNOWN_BY[found["by"]]] = None
    if not known:
        return "Whether episodes work in contact is not known: they were not replayed, and no twin of a recording was asked."
    return (
        f"Quality is the probability that an episode works, by {' and '.join(by)}. It is known of {len(known)} of {n} episodes, {np.mean(known):.2f} in the "
        f"mean; per episode in `{RECORDS_PATH}`."
    )


def _spread(records: Iterable[Record]) -> list[tuple[str, ...]]:
    """Rows of a table: each number that records hold, over all of them."""
    values: dict[str, array] = {}
    for record in records:
        for key, value in record.items():
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                values.setdefault(key, array("d")).append(value)
    return [(f"`{key}`", *(f"{f(v):.4g}" for f in (np.mean, np.min, np.max))) for key, v in values.items()]


def _gated(metadata: Metadata, records: Records) -> str:
    """Sentences on what the quality gate did; empty if there was none."""
    options = [provenance.options for provenance in metadata.provenances]
    text = ""
    for gated in (each for each in options if "min_quality" in each):
        text += f" Episodes not known to work with a probability of at least {gated['min_quality']:g} are left out ({len(gated['gate']['dropped'])})."
    for bound in dict.fromkeys(each["flag"] for each in options if "flag" in each):
        flagged = [str(index) for index, record in enumerate(records) if record.get("flagged")]
        text += f" Those not known to work with {bound:g} are `flagged` in `{RECORDS_PATH}`: {', '.join(flagged) or 'none'}."
    return text.strip()


def augmented(records: Records) -> str:
    """How far objects were moved; empty if none were."""
    recorded = Counter(record["source_episode"] for record in records if "offset" in record)
    if not recorded:
        return ""
    rows = _spread(record.get("offset", {}) for record in records)
    return (
        f"## Spatial augmentation\n\n{len(recorded)} recorded episodes became {recorded.total()}: in each, all objects are moved as one from where they were recorded, and the hand goes where they are. "
        "Their points move rigidly: what a camera did not see of them, or behind them, where they were recorded is also missing "
        f"where they are now. Per episode in `{RECORDS_PATH}`, under `offset`; `seed` there is that of the recorded start.\n\n"
        + markdown_table(("offset", "mean", "least", "largest"), rows)
    )


def verified(metadata: Metadata, records: Records) -> str:
    """What simulation says of the episodes; empty if it was not asked."""
    kept: Counter[str] = Counter()
    plain, refined, held = 0, 0, {"plain_held": 0.0, "held": 0.0}
    for verdict in (record["verified"] for record in records if "verified" in record):
        kept[_kind(verdict["how"]) if verdict["success"] else "fails"] += 1
        plain += not verdict["failure"]
        if "held" in verdict:
            refined += 1
            held = {name: share + verdict[name] for name, share in held.items()}
    if not kept:
        return ""
    asked = (provenance.options.get("verify", {}) for provenance in metadata.provenances)
    dropped = [index for each in asked for index in each.get("dropped", [])]
    n = kept.total() + len(dropped)
    text = (
        f"## Verified in simulation\n\nEpisodes were replayed in `{metadata.environment.id}` as they were converted. The "
        f"plain transfer succeeds in {plain} of {n}. Where it fails{' or is fragile' if refined else ''}, others were tried: "
        f"{_REFINED if refined else _LISTED}. With these, {kept.total() - kept['fails']} of {n} succeed. "
    )
    for chosen in (
        p.options["refine"]["start"] for p in metadata.provenances if "start" in p.options.get("refine", {})
    ):
        text += (
            f"All follow from another start than the one that follows best: of {chosen['tried']} that were tried on some episodes, replays from it hold in "
            f"{chosen['held']:.0%}, from that in {chosen['best_held']:.0%}; what is called plain here begins there. "
        )
    if refined:
        before, after = (f"{share / refined:.0%}" for share in held.values())
        text += (
            f"Of replays with objects, friction and joints a little otherwise, {before} of the plain transfer and {after} of what is kept hold; "
            "as these chose it, fresh ones may show less. "
        )
    if dropped:
        text += f"Left out are {len(dropped)} in which nothing did. "
    text += f"Per episode in `{RECORDS_PATH}`, under `verified`.\n\n"
    return text + markdown_table(("transfer", "episodes"), list(kept.items()))


def _kind(how: str) -> str:
    """What a way is called; corrections are each their own, and count as one kind."""
    return "corrected" if how.startswith("corrected") else how


def evidence(metadata: Metadata, records: Records) -> str:
    """What twins of the recordings say of the episodes; empty if they were not asked."""
    answers = Counter(record["evidence"]["answer"] for record in records if "evidence" in record)
    if not answers:
        return ""
    asked = [each for provenance in metadata.provenances if (each := provenance.options.get("evidence"))]
    assumed = "".join(
        f" Assumed of what is held: {each['density_kg_m3']:g} kg/m^3, friction {each['friction']:g}."
        for each in asked[:1]
    )
    left_out = sum(len(each.get("dropped", ())) for each in asked)
    assumed += f" Episodes that fail in it are left out ({left_out})." if left_out else ""
    text = (
        "## Evidence of twins\n\nNo environment was asked: of each recording a scene was built from its clouds and from where the source touched "
        "what it held, the source's own motion was tried in it, then the converted one, several times a little otherwise. This is evidence, not "
        f"proof.{assumed} Per episode in `{RECORDS_PATH}`, under `evidence`.\n\n"
    )
    return text + markdown_table(("a converted episode", "episodes"), list(answers.items()))


def painting(target: str, figures: Sequence[Mapping[str, Any]]) -> str:
    """The end of a sentence: how pictures of episodes were painted, by the figures of each (`cei_gym.painting`)."""
    mean = {name: float(np.mean([each[name] for each in figures])) for name in ("source", "pooled", "invented")}
    light = [each["light_off"] for each in figures if each["light_off"] is not None]
    carried, cut_out = (sum(each[name] for each in figures) for name in ("carried", "cut_out"))
    return (
        f"by geometry, without a network: the source, {100 * mean['source']:.1f} % of a picture, was taken out by its joints, {target} drawn in its "
        f"place. {100 * mean['pooled']:.2f} % of a picture is from other episodes, {100 * mean['invented']:.2f} % inpainted, as no picture shows it. "
        + (
            f"The light is read from the source, to within {np.median(light):.0f} of 255. "
            if light
            else "The light is assumed. "
        )
        + (f"What is carried was cut out in {cut_out} of {carried} cases. " if carried else "Nothing is carried. ")
        + "Shadows that the source throws stay, and the target throws none."
    )
