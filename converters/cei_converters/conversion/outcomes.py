"""What became of a conversion's episodes: told on the terminal, and its result. Frame by frame it stays on disk."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from cei_converters.cli.table import print_table
from cei_converters.conversion import evidence
from cei_converters.conversion.augment import check_left, count, counted
from cei_converters.conversion.episode import Outcome
from cei_converters.conversion.gate import FAILS_IN_TWIN, LOW_QUALITY, in_words
from cei_converters.conversion.plan import Plan
from cei_converters.conversion.reach import spans
from cei_converters.conversion.shard import Shard
from cei_converters.conversion.staging import StagingDirectory
from cei_converters.conversion.verdict import check_kept, sentence, summarise
from cei_gym.errors import CEIError

# a table of more rows is nobody's to read
_ROWS, _WORST = 50, 20
_BECAUSE, _PENETRATES, _TOOL, _STRAYS = "unreachable_because", "penetrates", "tool_points_mean", "another_way"


def outcomes(place: StagingDirectory, plan: Plan) -> Iterator[Outcome]:
    """What became of each episode, in order."""
    for shard in range(len(plan.shards)):
        yield from Shard(place.shard(shard)).outcomes


def residuals(place: StagingDirectory, plan: Plan) -> Iterator[dict[str, Any]]:
    """Give for each episode that is kept, in order, `episode` and how far pads are apart frame by frame."""
    return (outcome.residuals for outcome in outcomes(place, plan) if not outcome.left_out)


@dataclass(frozen=True)
class Summary:
    """What became of all episodes.

    Attributes:
        entries: one for each that is kept.
        verified: what replaying showed (`summarise`), if it was asked for.
        judged: which are dropped or flagged for their quality (`Gate.judge`), if it was asked for.
        augmented: how many were made and left out (`count`), if objects are moved.
        strays: which go another way than the others, if any do, and whether they are left out.
        evidence: what twins of the recordings say, if it was asked for.
    """

    entries: list[dict[str, Any]]
    verified: dict[str, Any] | None = None
    judged: dict[str, list[int]] | None = None
    augmented: dict[str, Any] | None = None
    strays: dict[str, Any] | None = None
    evidence: dict[str, Any] | None = None

    @property
    def choices(self) -> dict[str, Any]:
        """All but the entries, where they were asked for, by the names they have in the result."""
        found = {"verify": self.verified, "gate": self.judged, "augment": self.augmented, "strays": self.strays}
        found["evidence"] = self.evidence
        return {name: value for name, value in found.items() if value is not None}


def summarise_conversion(place: StagingDirectory, plan: Plan, title: str) -> Summary:
    """Print a table of how good episodes are, and a sentence on each thing that leaves some out.

    Args:
        place: with all shards.
        plan: of the conversion.
        title: of the table.

    Raises:
        CEIError: no episode is kept.
    """
    entries, rows, verdicts, left_out, scored, said, failing = [], [], [], [], [], [], []
    for outcome in outcomes(place, plan):
        entry, reason = outcome.entry, outcome.left_out
        left_out.append(reason)
        if not reason:
            entries.append(entry)
        if reason in ("", LOW_QUALITY):
            scored.append(entry)
        row = entry | {"flagged": "yes" if outcome.record.get("flagged") else None, "left_out": reason or None}
        if (of_twin := outcome.record.get("evidence")) is not None:
            said.append(of_twin)
            failing += [entry["episode"]] if reason == FAILS_IN_TWIN else []
            row |= {"evidence": evidence.row(of_twin)}
        if outcome.verdict is not None:
            verdicts.append(outcome.verdict)
            row |= outcome.verdict.row()
        rows.append(row)
    _print_rows(rows, title)
    _print_faults(rows)
    _print_tools(rows)
    strays = _strays(rows, plan.config.drop_strays)
    verified = judged = augmented = None
    if verdicts:
        verified = summarise(verdicts)
        print(f"Verification: {sentence(verified)}.")
        check_kept(verified)
    witnessed = evidence.summarise(said, failing) if said else None
    if witnessed is not None:
        print(f"Evidence of twins: {evidence.sentence(witnessed)}.")
    if plan.config.gate.bounds:
        judged = plan.config.gate.judge(scored)
        print(f"Quality: {in_words(judged)}.")
    if plan.config.augment.enabled:
        augmented = count(left_out)
        print(f"Augmentation: {counted(augmented)}.")
        check_left(augmented)
    return Summary(entries, verified, judged, augmented, strays, witnessed)


def _how_good(row: dict[str, Any]) -> tuple[float, float]:
    return 1.0 if row.get("quality") is None else row["quality"], row["fidelity"]


def _print_rows(rows: list[dict[str, Any]], title: str) -> None:
    """A row an episode, or of many episodes the worst and a row of means; no column that is empty throughout, nor of sentences."""
    names = dict.fromkeys(name for row in rows for name in row)
    sentences = _BECAUSE, _PENETRATES, _TOOL, _STRAYS
    shown = [name for name in names if name not in sentences and any(row.get(name) is not None for row in rows)]
    rows = [{name: row.get(name) for name in shown} for row in rows]
    if len(rows) > _ROWS:
        title += (
            f": of {len(rows)} episodes, the {_WORST} least likely to work, or of lowest fidelity, and the mean of all"
        )
        numbers = [name for name, value in rows[0].items() if isinstance(value, (int, float)) and name != "episode"]
        mean = {name: float(np.mean([row[name] for row in rows])) for name in numbers}
        rows = [*sorted(rows, key=_how_good)[:_WORST], {"episode": "mean", **mean}]
    print_table(rows, title)


def _print_tools(rows: list[dict[str, Any]]) -> None:
    """A line on what was taken to be the source's tool, if anything was."""
    found = {row["episode"]: row[_TOOL] for row in rows if row.get(_TOOL)}
    if found:
        print(
            f"note: in {spans([*found], 'episode')} the source's hand has something with it all the time (up to {max(found.values()):.0f} points "
            "a frame): it is taken for a tool, or for what is left of the robot, and is no obstacle."
        )


def _strays(rows: list[dict[str, Any]], dropped: bool) -> dict[str, Any] | None:
    """Episodes that go another way than the others, which a line tells of; None if none does.

    Raises:
        CEIError: without them none is left.
    """
    episodes = list(dict.fromkeys(row["episode"] for row in rows if row.get(_STRAYS)))
    if not episodes:
        return None
    if dropped and all(row["left_out"] for row in rows):
        raise CEIError(
            f"no episode is left: {spans(episodes, 'episode')} would be left out for going another way than the others; leave out --drop_strays."
        )
    what = (
        "left out, as asked for"
        if dropped
        else "--drop_strays leaves out what does, as policies learn from what is done alike"
    )
    print(
        f"note: in {spans(episodes, 'episode')} the target goes another way in its joints than in the others; {what}."
    )
    return {"episodes": episodes, "left_out": dropped}


def _print_faults(rows: list[dict[str, Any]]) -> None:
    """Where and why the target does not follow, and what is in what where that is the worst about an episode, a line each."""
    faults = [
        f"Episode {row['episode']}, {spans(row['unreachable_frames'])} out of reach: {row[_BECAUSE]}"
        for row in rows
        if row.get(_BECAUSE)
    ]
    faults += [
        f"Episode {row['episode']}: {row[_PENETRATES]}, {row['penetration_mm_max']:.0f} mm deep."
        for row in rows
        if row.get(_PENETRATES) and row["weakest"] == "clearance"
    ]
    for fault in faults[:_WORST]:
        print(fault)
    if len(faults) > _WORST:
        print(f"And {len(faults) - _WORST} more such lines; --json has all.")
