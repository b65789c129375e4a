"""All episodes at a glance; memory has the worst of them, whatever their number."""

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field

from cei_converters.report.episodes import Episode

MOST = 200
"""Rows of a table: more are nobody's to read."""


@dataclass
class Summary:
    """What is found of all episodes.

    Attributes:
        count, frames: how many there are.
        worst: the worst of them, at most `MOST`, worst first.
        best: the best one.
        fidelities, qualities, distances_mm: of those that have them; the last are mean distances of pads.
        held: sums of the shares that held plain and as they are kept, and of how many episodes.
        verified: how many were verified while they were converted.
        corrected: those with a correction, at most `MOST`.
    """

    count: int = 0
    frames: int = 0
    worst: list[Episode] = field(default_factory=list[Episode])
    best: Episode | None = None
    fidelities: array = field(default_factory=lambda: array("f"))
    qualities: array = field(default_factory=lambda: array("f"))
    distances_mm: array = field(default_factory=lambda: array("f"))
    held: tuple[float, float, int] = (0.0, 0.0, 0)
    verified: int = 0
    corrected: list[Episode] = field(default_factory=list[Episode])

    def add(self, episode: Episode) -> None:
        """Count one in."""
        self.count += 1
        self.frames += episode.frames
        if episode.fidelity is not None:
            self.fidelities.append(episode.fidelity)
        if episode.quality is not None:
            self.qualities.append(episode.quality[0])
        if (mm := episode.figures.get("pad_distance_mm_mean")) is not None:
            self.distances_mm.append(mm)
        if episode.held is not None:
            plain, kept, n = self.held
            self.held = plain + episode.held[0], kept + episode.held[1], n + 1
        self.verified += episode.plain_failure is not None
        if episode.corrected is not None and len(self.corrected) < MOST:
            self.corrected.append(episode)
        if self.best is None or episode.rank > self.best.rank:
            self.best = episode
        self.worst.append(episode)
        if len(self.worst) > 2 * MOST:
            self._cut()

    def _cut(self) -> None:
        self.worst = sorted(self.worst, key=lambda each: each.rank)[:MOST]

    @classmethod
    def of(cls, episodes: Iterable[Episode]) -> "Summary":
        """That of all of them."""
        summary = cls()
        for episode in episodes:
            summary.add(episode)
        summary._cut()
        return summary

    def rows(self) -> list[Episode]:
        """Those of the table: all in their order, or the worst of many."""
        return self.worst if self.count > len(self.worst) else sorted(self.worst, key=lambda each: each.index)

    def shown(self, most: int) -> list[Episode]:
        """The worst so many, worst first, and the best one last; that alone where nothing tells which are worse."""
        assert self.best is not None
        return [each for each in self.worst if each.rank < self.best.rank][:most] + [self.best]
