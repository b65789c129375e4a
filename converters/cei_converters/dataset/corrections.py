"""What a refined conversion says of an episode's correction (`cei-convert --refine`), in the episode's record under `verified.corrected`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from cei_converters.dataset.metadata import plain
from cei_gym.alignment.contact.correction import Correction
from cei_gym.errors import CEIError, one_line

VERIFIED, CORRECTED = "verified", "corrected"
"""Where it is in a record."""


@dataclass(frozen=True)
class Corrected:
    """A correction that is kept, and where the robot would be without it.

    Attributes:
        correction: what is other than followed.
        frame: of the episode: the middle of its first hold.
        plain_qpos: (n,) the robot's joints there without the correction, rad or m.
    """

    correction: Correction
    frame: int
    plain_qpos: list[float]

    def record(self) -> dict[str, Any]:
        """In JSON types."""
        return plain(self)

    @classmethod
    def of(cls, record: Mapping[str, Any], frames: int, joints: int, where: str) -> Self | None:
        """That of an episode; None if its record has none.

        Args:
            record: of the episode, which may be a stranger's.
            frames, joints: how many it has.
            where: for messages.

        Raises:
            CEIError: what it has is no correction of such an episode.
        """
        verified = record.get(VERIFIED)
        found = verified.get(CORRECTED) if isinstance(verified, Mapping) else None
        if found is None:
            return None
        place = f"{where}: {VERIFIED}.{CORRECTED}"
        try:
            frame, qpos = found["frame"], [float(q) for q in found["plain_qpos"]]
            correction = Correction(**{name: float(value) for name, value in found["correction"].items()})
        except (KeyError, TypeError, ValueError, AttributeError) as error:  # CEIError, too
            raise CEIError(f"{place} is no correction: {one_line(error)}.") from error
        if not isinstance(frame, int) or isinstance(frame, bool) or not 0 <= frame < frames:
            raise CEIError(f"{place}.frame should be 0 to {frames - 1}, not {one_line(frame, 60)}.")
        if len(qpos) != joints or not np.isfinite(qpos).all():
            raise CEIError(f"{place}.plain_qpos should be {joints} finite numbers.")
        return cls(correction, frame, qpos)


def held_in_words(record: Mapping[str, Any]) -> str:
    """Which share of an episode's replays held without its correction, and with it; empty if its record does not say."""
    verified = record.get(VERIFIED)
    shares = [verified.get(name) for name in ("plain_held", "held")] if isinstance(verified, Mapping) else []
    if not shares or not all(isinstance(share, (int, float)) and 0 <= share <= 1 for share in shares):
        return ""
    return "of replays slightly otherwise held {:.0%} without, {:.0%} with it".format(*shares)
