"""The steps of a conversion, from an episode's place to what is judged: read, augment, retarget (and verify), judge; `encode` is the last.

Packages add steps by the entry point group `cei_gym.steps`, and `--steps` has them run, in the workers: those that change what is
recorded (`OnRecorded`) after augmentation, those that change what is retargeted (`OnRetargeted`) before it is judged: its demonstration, its
pictures.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cei_converters.conversion.augment import Augmentation
from cei_converters.conversion.episode import Judged, Recorded, Retargeted
from cei_converters.conversion.gate import ANOTHER_WAY, DROPPED, FAILS_IN_TWIN, FLAGGED, LOW_QUALITY, Gate
from cei_converters.conversion.quality import Quality
from cei_converters.dataset.cameras import Pictures
from cei_converters.dataset.carried import Carried
from cei_gym import plugins
from cei_gym.alignment.judge.fidelity import assess
from cei_gym.errors import CEIError
from cei_gym.twin.evidence import FAILS

if TYPE_CHECKING:
    from cei_converters.conversion.evidence import Witness
    from cei_converters.conversion.painting import Painting
    from cei_converters.conversion.verify import Verifier
    from cei_converters.sources.source import Source
    from cei_gym.transfer import Transfer

GROUP = "cei_gym.steps"
"""Entry points of steps that packages offer."""


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
        painting: who paints the target in pictures, if that is asked for.
    """

    transfer: "Transfer"
    verifier: "Verifier | None"
    modes: int
    clouds: bool
    then: Sequence[OnRetargeted]
    mode: int | None = None
    witness: "Witness | None" = None
    painting: "Painting | None" = None

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
        if self.painting is not None:
            made = self.painting(made)
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
        quality = Quality.of(made.verdict, made.evidence)
        decision = self.gate.decision(quality.probability)
        return Judged(made, assess(made.report), quality, decision == FLAGGED, self._left_out(made, decision))

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
