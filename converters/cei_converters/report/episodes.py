"""What is known of each episode: of its record, and of replays; one at a time, as a dataset may have many."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from cei_converters.dataset.corrections import Corrected
from cei_converters.dataset.records import fidelity_of, quality_of
from cei_converters.report.lenient import mapping, number, share
from cei_converters.report.replays import Replay, Replayed
from cei_converters.sources.reader import DatasetReader
from cei_gym.alignment.judge.fidelity import HALVES
from cei_gym.errors import one_line
from cei_gym.twin.evidence import FAILS, HOLDS

PARTS = tuple(HALVES)


@dataclass(frozen=True)
class Twin:
    """What the twin of a recording says (`cei_gym.twin.Evidence.record`).

    Attributes:
        answer: of `cei_gym.twin.evidence`.
        held: how many of how many tries held, "4 of 6"; empty where there was none.
        reason: why it cannot be judged; else empty.
    """

    answer: str
    held: str = ""
    reason: str = ""


@dataclass(frozen=True)
class Episode:
    """One of them.

    Attributes:
        index: in the dataset.
        frames: how many it has.
        source_episode: which episode of the source it was converted from; None if its record does not say.
        quality: how likely it works, in [0, 1], and what that is known by; None if nothing tells.
        fidelity: how well it follows its source, in [0, 1]; None if its record does not say.
        parts: of the fidelity, by name.
        figures: other numbers of its record, by name (`AlignmentReport.summary`).
        texts: likewise sentences.
        unreachable: how many frames are out of reach.
        how: which way of transferring it was kept, where it was verified.
        plain_failure: why the plain way fails; empty if it does not, None if it was not verified.
        fails: whether nothing that was tried while converting succeeds.
        held: shares of replays that held while it was refined: plain, and as it was kept.
        corrected: the correction that is kept.
        replayed: what a replay showed, if it is of one.
        twin: what the twin of its recording says, if it was asked.
        another_way: whether it goes another way in its joints than the others.
        flagged: whether the conversion marked it.
    """

    index: int
    frames: int
    source_episode: int | None = None
    quality: tuple[float, str] | None = None
    fidelity: float | None = None
    parts: Mapping[str, float] = field(default_factory=dict[str, float])
    figures: Mapping[str, float] = field(default_factory=dict[str, float])
    texts: Mapping[str, str] = field(default_factory=dict[str, str])
    unreachable: int = 0
    how: str = ""
    plain_failure: str | None = None
    fails: bool = False
    held: tuple[float, float] | None = None
    corrected: Corrected | None = None
    replayed: Replayed | None = None
    twin: Twin | None = None
    another_way: bool = False
    flagged: bool = False

    @property
    def weakest(self) -> str:
        """Name of the worst part of its fidelity; empty if it has none."""
        return min(self.parts, key=lambda name: self.parts[name], default="")

    @property
    def rank(self) -> tuple[float, ...]:
        """How good it is, to sort by: whether it succeeds, how often slightly otherwise, how likely that is, its fidelity."""
        succeeds = not self.replayed.failure if self.replayed else not self.fails
        held = self.held[1] if self.held else float(self.twin is None or self.twin.answer != FAILS)
        if self.replayed and self.replayed.perturbed:
            held = sum(self.replayed.perturbed) / len(self.replayed.perturbed)
        likely = 1.0 if self.quality is None else self.quality[0]
        return float(succeeds), held, likely, 1.0 if self.fidelity is None else self.fidelity

    def why(self) -> list[str]:
        """What is known against it, a sentence each."""
        said = [_of_fidelity(self)] if self.fidelity is not None and self.fidelity < 0.995 else []
        if self.replayed is not None:
            if self.replayed.failure:
                said.append(f"Replayed, it fails: {self.replayed.failure}.")
            if n := len(self.replayed.perturbed):
                said.append(f"Replayed slightly otherwise, it succeeds in {sum(self.replayed.perturbed)} of {n}.")
        if self.fails:
            said.append(
                f"While it was converted, nothing that was tried succeeded; the plain way: {self.plain_failure}."
            )
        elif self.plain_failure:
            said.append(f"The plain transfer fails ({self.plain_failure}); kept is another: {self.how}.")
        elif self.corrected is not None:
            said.append(f"It is {self.how}.")
        if self.held is not None:
            plain, kept = self.held
            better = "" if plain == kept else f" plain, {kept:.0%} as it is kept"
            said.append(f"While it was refined, {plain:.0%} of replays held{better}.")
        if self.twin is not None and self.twin.answer != HOLDS:
            found = self.twin.reason or f"{self.twin.held} tries hold"
            said.append(f"Played in a scene built from its recording: {self.twin.answer} ({found}).")
        if self.flagged:
            said.append("The conversion flagged it for its quality (--flag).")
        if self.another_way:
            said.append("The target goes another way in its joints than in the other episodes.")
        return said


def episodes(reader: DatasetReader, replay: Replay | None) -> Iterator[Episode]:
    """All of a dataset, in order.

    Args:
        reader: of the dataset.
        replay: of it, if there is one.

    Raises:
        CEIError: what should be known of an episode is of another.
    """
    for index in range(len(reader)):
        replayed = None if replay is None else replay.episodes.get(index)
        yield _episode(reader, index, replayed)


def _episode(reader: DatasetReader, index: int, replayed: Replayed | None) -> Episode:
    record, frames = reader.record(index), reader.frames(index)
    alignment, verified, fidelity, quality = (
        mapping(record.get("alignment")),
        mapping(record.get("verified")),
        fidelity_of(record),
        quality_of(record),
    )
    likely = share(quality.get("probability"))
    shares = [share(verified.get(name)) for name in ("plain_held", "held")]
    parts = {name: share(mapping(fidelity.get("parts")).get(name)) for name in PARTS}
    missed, origin = alignment.get("unreachable_frames"), record.get("source_episode")
    return Episode(
        index=index,
        frames=frames,
        source_episode=origin if isinstance(origin, int) and not isinstance(origin, bool) else None,
        quality=None if likely is None else (likely, one_line(quality.get("by", ""), 20)),
        fidelity=share(fidelity.get("score")),
        parts={name: part for name, part in parts.items() if part is not None},
        figures={name: figure for name, value in alignment.items() if (figure := number(value)) is not None},
        texts={name: one_line(value, 300) for name, value in alignment.items() if isinstance(value, str)},
        unreachable=len(missed) if isinstance(missed, list) else 0,
        how=one_line(verified.get("how", ""), 300),
        plain_failure=one_line(verified.get("failure", ""), 100) if verified else None,
        fails=verified.get("success") is False,
        held=(shares[0], shares[1]) if shares[0] is not None and shares[1] is not None else None,
        corrected=Corrected.of(
            record, frames, len(reader.embodiment.joint_names), f"{reader.repo_id}, episode {index}"
        ),
        replayed=replayed,
        twin=_twin(mapping(record.get("evidence"))),
        another_way=alignment.get("another_way") is True,
        flagged=record.get("flagged") is True,
    )


def _twin(evidence: Mapping[str, object]) -> Twin | None:
    answer, (held, tries) = (
        one_line(evidence.get("answer", ""), 40),
        (number(evidence.get(k)) for k in ("held", "tries")),
    )
    counted = "" if held is None or tries is None else f"{held:.0f} of {tries:.0f}"
    return Twin(answer, counted, one_line(evidence.get("reason", ""), 200)) if answer else None


def _of_fidelity(episode: Episode) -> str:
    """Which part of its fidelity is the worst, and what that part measures."""
    figures, texts, part = episode.figures, episode.texts, episode.weakest
    if not part:
        return f"Its fidelity is {episode.fidelity:.2f}."
    about = {
        "residual": "how far its pads stay from the source's",
        "limits": "how long a joint of the arm sits at a limit",
        "jumps": "a joint faster than it can be",
        "clearance": "how deep the robot is in itself, the table or objects",
        "reach": "frames that are out of reach",
    }[part]
    found = {
        "residual": _given("{:.1f} mm in the mean", figures.get("pad_distance_mm_mean")),
        "limits": "",
        "jumps": _given("{:.2f} rad in a frame at most", figures.get("joint_step_max_rad")),
        "clearance": _given("{:.1f} mm", figures.get("penetration_mm_max")) + _given(", {}", texts.get("penetrates")),
        "reach": f"{episode.unreachable} of {episode.frames}{_given('; {}', texts.get('unreachable_because'))}",
    }[part].removesuffix(".")
    return f"Its fidelity is {episode.fidelity:.2f}, for its {part}: {about}{found and f' ({found})'}."


def _given(template: str, value: object) -> str:
    return "" if value is None else template.format(value)
