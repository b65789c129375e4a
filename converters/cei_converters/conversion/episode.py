"""An episode on its way through a conversion: recorded, retargeted, judged, converted; each stage is whole, or is not made."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from cei_converters.conversion.quality import Quality
from cei_converters.conversion.verdict import Verdict
from cei_converters.dataset.cameras import Pictures
from cei_converters.dataset.carried import Carried
from cei_converters.dataset.encoded import EncodedEpisode
from cei_converters.dataset.writer import Header
from cei_gym.alignment import AlignmentReport
from cei_gym.alignment.judge.fidelity import Fidelity
from cei_gym.augmentation import Offset
from cei_gym.demonstration import Demonstration
from cei_gym.twin.evidence import Evidence


@dataclass(frozen=True)
class Recorded:
    """An episode of the source.

    Attributes:
        position: in the conversion, where an episode may come several times.
        index: in the source's dataset.
        demonstration: of the source, its objects moved if they are to be.
        offset: of its objects; None where they are where they were.
        inside: whether objects are in the workspace.
        pictures: what cameras saw in all frames of the source's episode, of those whose pictures pass through.
        carried: what else there is of these frames.
    """

    position: int
    index: int
    demonstration: Demonstration
    offset: Offset | None = None
    inside: bool = True
    pictures: Pictures = field(default_factory=Pictures)
    carried: Carried = field(default_factory=Carried)


@dataclass(frozen=True)
class Retargeted:
    """The same by the target.

    Attributes:
        recorded: what it was made of.
        mode: which of the motions that were asked for.
        demonstration: of the target.
        report: how well it follows.
        verdict: what replaying showed, if it was replayed.
        pictures: what cameras saw, frame by frame of the target's demonstration, or what a step has painted.
        carried: what else there is of these frames.
        evidence: what a twin of the recording says, if it was asked.
        painted: feature of each camera that shows the target, to how it was painted (`cei_gym.painting.Figures.record`).

    Raises:
        CEIError: pictures or columns are not of as many frames as the demonstration.
    """

    recorded: Recorded
    mode: int
    demonstration: Demonstration
    report: AlignmentReport
    verdict: Verdict | None = None
    pictures: Pictures = field(default_factory=Pictures)
    carried: Carried = field(default_factory=Carried)
    evidence: Evidence | None = None
    painted: Mapping[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])

    def __post_init__(self) -> None:
        frames = len(self.demonstration)
        self.pictures.check_frames(frames, repeated=self.demonstration.source_frames is not None)
        self.carried.check_frames(frames)


@dataclass(frozen=True)
class Judged:
    """The same with a decision.

    Attributes:
        retargeted: what is judged.
        fidelity: how well it follows the source.
        quality: how likely it works, if that is known.
        flagged: whether it is to be marked.
        left_out: why it is left out of the dataset; empty if it is not.
    """

    retargeted: Retargeted
    fidelity: Fidelity
    quality: Quality
    flagged: bool
    left_out: str


@dataclass(frozen=True)
class Worst:
    """The frame in which an episode's fidelity is lowest, and both robots' (n,) joints there, rad or m."""

    frame: int
    qpos_source: list[float]
    qpos_target: list[float]


@dataclass(frozen=True)
class Outcome:
    """What became of an episode, in JSON types, as shards keep it.

    Attributes:
        entry: of the table; its `episode` is the index in the source's dataset.
        record: what the dataset's metadata have of it (`dataset.records`).
        residuals: `episode`, and how far pads are apart frame by frame.
        worst: where it is worst.
        verdict: what replaying showed, or None.
        left_out: why it is left out; empty if it is not.
        mode: which motion it is.
        start_qpos: (n,) the target's joints at its start, rad or m.
    """

    entry: dict[str, Any]
    record: dict[str, Any]
    residuals: dict[str, Any]
    worst: Worst
    verdict: Verdict | None
    left_out: str
    mode: int
    start_qpos: list[float]

    @classmethod
    def decode(cls, stored: dict[str, Any]) -> Self:
        """What `encode` gave.

        Raises:
            KeyError, TypeError: it is something else.
        """
        verdict = stored["verdict"]
        built: dict[str, Any] = {
            "worst": Worst(**stored["worst"]),
            "verdict": None if verdict is None else Verdict.decode(verdict),
        }
        return cls(**stored | built)

    def encode(self) -> dict[str, Any]:
        """As JSON types."""
        return asdict(self)


@dataclass(frozen=True)
class Converted:
    """A converted episode.

    Attributes:
        outcome: what became of it.
        header: what it shares with the others.
        encoded: what is stored; None if it is left out.
    """

    outcome: Outcome
    header: Header
    encoded: EncodedEpisode | None
