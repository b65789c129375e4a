"""Evidence for converted episodes where no environment is: what twins of their recordings say (`cei_gym.twin`)."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from cei_converters.cli.options import check_range
from cei_converters.conversion.reach import spans
from cei_gym.errors import CEIError
from cei_gym.twin.evidence import CANNOT, Evidence
from cei_gym.twin.options import TwinOptions

if TYPE_CHECKING:
    from cei_gym.demonstration import Demonstration
    from cei_gym.transfer import Transfer
    from cei_gym.transfer.aligned import Aligned


@dataclass
class EvidenceOptions:
    """A twin of each recording; `--evidence` switches it on.

    Attributes:
        enabled: say of each episode whether it holds, by a scene built from its clouds; first the source's own motion is tried in it.
        density_kg_m3: assumed of what is held.
        friction: the same; tries differ in it.
        tries: most that an answer takes.
        drop: leave out episodes that fail in their twin; what is unsure, or cannot be judged, stays.
        seed: of what is drawn.
    """

    enabled: bool = False
    density_kg_m3: float = TwinOptions.density_kg_m3
    friction: float = TwinOptions.friction
    tries: int = TwinOptions.tries
    drop: bool = False
    seed: int = TwinOptions.seed

    def __post_init__(self) -> None:
        check_range("--evidence.seed", self.seed, 0)
        _ = self.twin  # which checks itself
        others = [field.name for field in fields(self) if getattr(self, field.name) != field.default]
        if not self.enabled and others:
            raise CEIError(f"--evidence.{others[0]} is of no use without --evidence.")

    @property
    def twin(self) -> TwinOptions:
        """What a twin is told.

        Raises:
            CEIError: a figure that cannot be.
        """
        try:
            return TwinOptions(self.density_kg_m3, self.friction, self.tries, seed=self.seed)
        except CEIError as error:
            raise CEIError(str(error).replace("twin.", "evidence.")) from None


class Witness:
    """Says of transferred demonstrations what twins show.

    Args:
        transfer: that moves them.
        options: see there.
    """

    def __init__(self, transfer: "Transfer", options: EvidenceOptions) -> None:
        from cei_gym.twin.twin import Twin

        self._twin = Twin(transfer.source, transfer.target, options.twin)

    def __call__(self, aligned: "Aligned", moved: "Demonstration") -> Evidence:
        """What the twin of a recording says of what was made of it."""
        if aligned.demonstration.displacement is not None:
            return Evidence.none("objects were moved, and nobody saw them there")
        grip, frames = aligned.followed.motion.grip, aligned.followed.frames
        shown = frames if moved.source_frames is None else moved.source_frames
        of_source = aligned.demonstration.source_frames
        if of_source is not None:
            shown = np.searchsorted(of_source, shown)
        first = np.unique(frames, return_index=True)[1]  # each of the source's frames is shown, some several times
        by_source = None if grip is None else grip.at(first)
        return self._twin.judge(aligned.demonstration, aligned.scenes, by_source, moved, shown)


def summarise(records: Sequence[dict[str, Any]], dropped: Sequence[int] = ()) -> dict[str, Any]:
    """The result, of what is recorded of each episode (`Evidence.record`), and of those that are left out for it.

    Raises:
        CEIError: all are.
    """
    if dropped and len(dropped) == len(records):
        raise CEIError(
            f"all {len(records)} episodes fail in their twins, so all are left out and nothing is written; leave out --evidence.drop."
        )
    return {
        "answers": dict(Counter(record["answer"] for record in records)),
        "reasons": dict(Counter(record["reason"] for record in records if "reason" in record)),
        "dropped": list(dropped),
    }


def sentence(summary: dict[str, Any]) -> str:
    """`summarise` in one line."""
    answers, reasons = summary["answers"], summary["reasons"]
    text = ", ".join(f"{count} {answer}" for answer, count in answers.items())
    if CANNOT in answers:
        text += f" ({'; '.join(f'{reason}: {count}' for reason, count in reasons.items())})"
    if dropped := summary["dropped"]:
        text += f"; left out: {spans(dropped, 'episode')}"
    return text


def row(record: dict[str, Any]) -> str:
    """For the table on the terminal."""
    return record["answer"] if "reason" in record else f"{record['answer']} {record['held']}/{record['tries']}"
