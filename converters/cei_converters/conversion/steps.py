"""The steps of a conversion, from an episode's place to what is stored of it: read, augment, retarget (and verify), judge, encode.

Packages add steps by the entry point group `cei_gym.steps`, and `--steps` has them run, in the workers: those that change what is
recorded (`OnRecorded`) after augmentation, those that change what is retargeted (`OnRetargeted`) before it is judged: its demonstration, its
pictures.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cei_converters.conversion.augment import Augmentation
from cei_converters.conversion.episode import Converted, Judged, Outcome, Recorded, Retargeted, Worst
from cei_converters.conversion.gate import ANOTHER_WAY, DROPPED, FAILS_IN_TWIN, FLAGGED, LOW_QUALITY, Gate
from cei_converters.conversion.reach import check_reached
from cei_converters.dataset.cameras import Pictures
from cei_converters.dataset.carried import Carried
from cei_converters.dataset.columns import encode
from cei_converters.dataset.encoded import EncodedEpisode, encode_episode
from cei_converters.dataset.metadata import plain
from cei_converters.dataset.picture_encoding import encode_pictures
from cei_converters.dataset.writer import Header
from cei_gym import plugins
from cei_gym.alignment.judge.quality import assess
from cei_gym.errors import CEIError
from cei_gym.twin.evidence import FAILS

if TYPE_CHECKING:
    from cei_converters.conversion.evidence import Witness
    from cei_converters.conversion.verify import Verifier
    from cei_converters.sources.source import Source
    from cei_gym.transfer import Transfer

GROUP = "cei_gym.steps"
"""Entry points of steps that packages offer."""
_TRACES = ("pad_distance_mm", "normal_angle_deg")
_OF_THE_SOURCE = ("verified", "evidence", "source_frames", "flagged", "offset", "painted")


class Step:
    """A step that a package adds; made once in each process that converts.

    Args:
        transfer: between which embodiments; not fitted yet when an `OnRecorded` sees the episodes that it is fitted to.
    """

    def __init__(self, transfer: "Transfer") -> None:
        self.transfer = transfer


class OnRecorded(Step, ABC):
    """A step that changes what is recorded, before it is retargeted."""

    @abstractmethod
    def __call__(self, episode: Recorded) -> Recorded:
        """The episode with a change.

        Raises:
            CEIError: it cannot be had; the conversion ends.
        """


class OnRetargeted(Step, ABC):
    """A step that changes what is retargeted, before it is judged and stored."""

    @abstractmethod
    def __call__(self, episode: Retargeted) -> Retargeted:
        """The episode with a change: of its demonstration, or of pictures (`Pictures.paint`). Report and verdict stay those of what was
        retargeted.

        Raises:
            CEIError: it cannot be had; the conversion ends.
        """


def check_steps(names: Sequence[str]) -> None:
    """Check that steps can be had.

    Raises:
        CEIError: nobody offers one, or it is no step.
    """
    for name in names:
        kind = plugins.load(GROUP, name, Step, "step")
        if not issubclass(kind, (OnRecorded, OnRetargeted)):
            raise CEIError(f"step {name!r} should be an OnRecorded or OnRetargeted of {__name__}.")


def make_steps(names: Sequence[str], transfer: "Transfer") -> list[Step]:
    """Steps by name, in that order; see `check_steps`."""
    check_steps(names)
    return [plugins.load(GROUP, name, Step, "step")(transfer) for name in names]


@dataclass(frozen=True)
class Read:
    """Goes from an episode's place to what is recorded, augmented if that is asked for.

    Attributes:
        reader: what episodes are read from.
        selected: which of its episodes is at each place.
        augmentation: which variants are made of each, if any.
        pictures: whether those of cameras pass through.
        carried: whether columns, or tasks of frames, are carried over.
        then: steps that packages add, in their order.
    """

    reader: "Source"
    selected: Sequence[int]
    augmentation: Augmentation | None
    pictures: bool
    carried: bool
    then: Sequence[OnRecorded]

    @property
    def changes(self) -> bool:
        """Whether what is recorded is changed: objects moved, or by steps."""
        return self.augmentation is not None or bool(self.then)

    def __call__(self, position: int, quickly: bool = False, clouds: bool = True) -> Recorded:
        """The episode at a place; `quickly` without what only its dataset needs: colours, pictures and what is carried over; without
        `clouds` (nor depth), if nothing that comes after it may want them."""
        index = self.selected[position]
        read = Recorded(
            position,
            index,
            self.reader.read(index, clouds=clouds or self.changes, colours=not quickly),
            pictures=self.reader.pictures(index) if self.pictures and not quickly else Pictures(),
            carried=self.reader.carry(index) if self.carried and not quickly else Carried(),
        )
        if self.augmentation is not None:
            variant = position % len(self.augmentation)
            moved, offset, inside = self.augmentation(read.demonstration, variant)
            read = replace(read, demonstration=moved, offset=offset, inside=inside)
        for step in self.then:
            read = step(read)
        return read


@dataclass(frozen=True)
class Retarget:
    """Goes from what is recorded to the target's, verified by replay if that is asked for.

    Attributes:
        transfer: fitted.
        verifier: who replays, if that is asked for.
        modes: distinct motions, which episodes take in turn.
        clouds: whether clouds are synthesised.
        then: steps that packages add, in their order.
        mode: the one motion that all episodes take instead.
        witness: who asks a twin of the recording, if that is asked for; not beside a verifier.
    """

    transfer: "Transfer"
    verifier: "Verifier | None"
    modes: int
    clouds: bool
    then: Sequence[OnRetargeted]
    mode: int | None = None
    witness: "Witness | None" = None

    def __call__(self, recorded: Recorded) -> Retargeted:
        # motions take turns: a dataset is an even mixture
        mode = recorded.position % self.modes if self.mode is None else self.mode
        if self.verifier is None:
            aligned = self.transfer.aligned(recorded.demonstration, mode)
            moved, report = self.transfer.made(aligned, clouds=self.clouds)
            verdict, evidence = None, None if self.witness is None else self.witness(aligned, moved)
        else:
            (moved, report, verdict), evidence = self.verifier(recorded.demonstration, mode), None
        frames = moved.source_frames
        pictures, carried = recorded.pictures.at(frames), recorded.carried.at(frames)
        made = Retargeted(recorded, mode, moved, report, verdict, pictures, carried, evidence)
        for step in self.then:
            made = step(made)
        return made


@dataclass(frozen=True)
class Judge:
    """What becomes of an episode.

    Attributes:
        gate: what decides by quality.
        allow_unreachable: whether frames out of reach are kept.
        drop_strays: whether those that go another way in the joints are left out.
        drop_failing: whether those that fail in a twin of their recording are left out.
    """

    gate: Gate
    allow_unreachable: bool
    drop_strays: bool
    drop_failing: bool

    def __call__(self, made: Retargeted) -> Judged:
        quality = assess(made.report)
        decision = self.gate.decision(quality.score)
        return Judged(made, quality, decision == FLAGGED, self._left_out(made, decision))

    def _left_out(self, made: Retargeted, decision: str) -> str:
        """Why it is left out of the dataset; empty if it is not. Recorded ones that are unreachable end the conversion."""
        recorded = made.recorded
        if not recorded.inside:
            return "outside the workspace"
        if recorded.offset is not None and made.report.unreachable_frames and not self.allow_unreachable:
            return "out of reach"
        if made.verdict is not None and made.verdict.dropped:
            return "fails"
        if self.drop_strays and made.report.another_way:
            return ANOTHER_WAY
        if self.drop_failing and made.evidence is not None and made.evidence.answer == FAILS:
            return FAILS_IN_TWIN
        return LOW_QUALITY if decision == DROPPED else ""


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
        made, quality = judged.retargeted, judged.quality
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
            "quality": quality.score,
            "weakest": quality.weakest,
        }
        known = {
            name: value for name, value in self.reader.record(recorded.index).items() if name not in _OF_THE_SOURCE
        }
        record = {
            **known,
            "source_episode": recorded.index,
            **offset,
            "quality": {"score": quality.score, "parts": quality.parts},
            **({"flagged": True} if judged.flagged else {}),
            **({} if verdict is None else {"verified": verdict.record()}),
            **({} if made.evidence is None else {"evidence": made.evidence.record()}),
            **({} if moved.source_frames is None else {"source_frames": moved.source_frames.tolist()}),
            **({"painted": sorted(made.pictures.painted)} if made.pictures.painted else {}),
            **figures,
            "alignment": summary,
        }
        worst = quality.frame
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
