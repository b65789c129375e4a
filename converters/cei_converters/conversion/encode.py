"""The last step of a conversion: from what is judged to what is stored of it, and what became of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cei_converters.conversion.episode import Converted, Judged, Outcome, Retargeted, Worst
from cei_converters.conversion.reach import check_reached
from cei_converters.dataset.columns import encode
from cei_converters.dataset.encoded import EncodedEpisode, encode_episode
from cei_converters.dataset.metadata import plain
from cei_converters.dataset.picture_encoding import encode_pictures
from cei_converters.dataset.step_time import STEP_TIMES, StepTimes
from cei_converters.dataset.writer import Header

if TYPE_CHECKING:
    from cei_converters.sources.source import Source

_TRACES = ("pad_distance_mm", "normal_angle_deg")
_OF_THE_SOURCE = (
    "fidelity",
    "quality",
    "verified",
    "evidence",
    "source_frames",
    "flagged",
    "offset",
    "painted",
    "painting",
    STEP_TIMES,
)


@dataclass(frozen=True)
class Encode:
    """Goes from what is judged to what is stored of it.

    Attributes:
        reader: what episodes are read from.
        target: name of the embodiment.
        state_key: LeRobot's feature that the state of objects becomes.
        modes: distinct motions, which episodes take in turn.
        allow_unreachable: whether frames out of reach are kept.
        scratch: folder for files that are removed again; None if nothing is stored.
    """

    reader: "Source"
    target: str
    state_key: str
    modes: int
    allow_unreachable: bool
    scratch: Path | None

    def __call__(self, judged: Judged) -> Converted:
        outcome = self._outcome(judged)
        header = Header.of(judged.retargeted.demonstration, self.state_key)
        encoded = None
        if self.scratch is not None and not judged.left_out:
            if not self.allow_unreachable:
                check_reached(self.target, [outcome.entry])
            encoded = self._encoded(judged.retargeted, header, self.scratch)
        return Converted(outcome, header, encoded)

    def _encoded(self, made: Retargeted, header: Header, scratch: Path) -> EncodedEpisode:
        moved = made.demonstration
        own = encode_episode(encode(moved, self.state_key), header.features, moved.task)
        pictures = encode_pictures(made.pictures, moved.fps, scratch)
        return own.joined(made.carried.encode(self.reader.carried)).joined(pictures)

    def _outcome(self, judged: Judged) -> Outcome:
        made, fidelity, quality = judged.retargeted, judged.fidelity, judged.quality
        moved, report, verdict, recorded = made.demonstration, made.report, made.verdict, made.recorded
        summary = report.summary() | ({"mode": made.mode} if self.modes > 1 else {})
        offset = {} if recorded.offset is None else {"offset": plain(recorded.offset)}
        figures = recorded.demonstration.figures
        entry = {
            "episode": recorded.index,
            **offset.get("offset", {}),
            "frames": len(moved),
            **figures,
            **summary,
            "quality": quality.probability,
            "fidelity": fidelity.score,
            "weakest": fidelity.weakest,
        }
        of_episode = self.reader.record(recorded.index)
        known = {name: value for name, value in of_episode.items() if name not in _OF_THE_SOURCE}
        times, shown = StepTimes.of(of_episode), moved.source_frames
        times = times and times.at(np.arange(len(moved)) if shown is None else shown)
        record = {
            **known,
            "source_episode": recorded.index,
            **offset,
            "fidelity": {"score": fidelity.score, "parts": fidelity.parts},
            **({"quality": found} if (found := quality.record()) else {}),
            **({"flagged": True} if judged.flagged else {}),
            **({} if verdict is None else {"verified": verdict.record()}),
            **({} if made.evidence is None else {"evidence": made.evidence.record()}),
            **({} if moved.source_frames is None else {"source_frames": moved.source_frames.tolist()}),
            **({} if times is None else times.record()),
            **({"painted": sorted(made.pictures.painted)} if made.pictures.painted else {}),
            **({"painting": dict(made.painted)} if made.painted else {}),
            **figures,
            "alignment": summary,
        }
        worst = fidelity.frame
        of_source = worst if moved.source_frames is None else moved.source_frames[worst]
        cut = recorded.demonstration.source_frames
        if cut is not None:  # by a step: where it shows that frame
            of_source = np.flatnonzero(cut == of_source)[0]
        return Outcome(
            plain(entry),
            plain(record),
            plain({"episode": recorded.index} | {name: getattr(report, name) for name in _TRACES}),
            Worst(worst, plain(recorded.demonstration.qpos[of_source]), plain(moved.qpos[worst])),
            verdict,
            judged.left_out,
            made.mode,
            plain(moved.qpos[0]),
        )
