"""Where the target's base should stand: a search over places, of which the few best, and the source's own, are judged by whole
demonstrations (`standing`)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.transfer.standing import BASINS, BEYOND_M, SEARCHED, Judging, Standing, followed
from cei_gym.transfer.transfer import Transfer

SAMPLED = 256
"""Frames that a place is judged by, at most."""
FOLLOWED = 4
"""Demonstrations that the best places are followed through, at most."""
AS_GOOD_M = 0.01
"""The source's place is kept if no other costs so much less."""

_FINALISTS = 3  # places, beside the source's
_DRAWN, _FIRST = 512, 64  # places that are drawn at random, and of them those that are scored
_RUNS, _POPULATION, _GENERATIONS = 3, 8, 9  # of CMA-ES
_SIGMA = 0.12  # of the arm's reach, and of half a turn
_APART_M, _APART_RAD = 0.08, 0.5  # of two finalists, in either


@dataclass(frozen=True)
class Placement:
    """Where the target should stand.

    Attributes:
        chosen: the best place; `source` itself, where that is as good (`AS_GOOD_M`).
        source: the source's place.
        frames, episodes: how many they were judged by.
        scored: (K, 3) x, y (world, m) and cost (m) of all places of the search.
        pads_world: (N, 2) where the source's pads were, x and y, m.
    """

    chosen: Standing
    source: Standing
    frames: int
    episodes: int
    scored: Array
    pads_world: Array

    @property
    def kept(self) -> bool:
        """Whether the source's place is as good as any."""
        return self.chosen is self.source


def effort(frames: int, transfer: Transfer, whole: Sequence[Demonstration]) -> int:
    """How many frames `find_place` solves, about, for progress."""
    searched = (_FIRST + _RUNS * _POPULATION * _GENERATIONS) * min(frames, SEARCHED) * BASINS
    return searched + (_FINALISTS + 1) * followed(frames, transfer, whole[:FOLLOWED])


def find_place(
    transfer: Transfer,
    sampled: Sequence[Demonstration],
    whole: Sequence[Demonstration],
    seed: int = 0,
    done: Callable[[int], None] = lambda _: None,
) -> Placement:
    """Search a place for a transfer's target, by its options; the same arguments find the same.

    Args:
        transfer: between the embodiments; where its target stands now does not matter, nor whether it is fitted.
        sampled: demonstrations thinned to a few frames each (`Demonstration.at`), `SAMPLED` in all at most.
        whole: a few demonstrations as they are, of which `FOLLOWED` are followed at most.
        seed: of the search.
        done: called with the number of frames that are solved, now and then.
    """
    judging = Judging(transfer, sampled, whole[:FOLLOWED], done)
    searched = _Search(judging, seed)
    places = [judging.source_place, *searched.best(_FINALISTS)]
    source, *others = [judging.follow(*place) for place in places]
    best = min(others, key=_order, default=source)
    as_good = source.out_of_reach <= best.out_of_reach and source.cost_m <= best.cost_m + AS_GOOD_M
    pads_world = judging.points_world.mean(axis=1)[:, :2]
    chosen = source if as_good else best
    return Placement(chosen, source, len(pads_world), len(sampled), np.array(searched.scored), pads_world)


def _order(standing: Standing) -> tuple[int, float]:
    return standing.out_of_reach, standing.cost_m


class _Search:
    """A seeded search over x, y, yaw and heights: the source's place and random ones, then CMA-ES about the best of these.

    Attributes:
        scored: x, y (world, m) and cost (m) of each place that was looked at.
    """

    def __init__(self, judging: Judging, seed: int) -> None:
        from cmaes import CMA  # a second, of scipy.stats, and few conversions search for a place

        self._judging = judging
        self.scored: list[tuple[float, float, float]] = []
        self._places: list[tuple[Array, float, float]] = []
        reach_m, (source_m, _) = judging.reach_m, judging.source_place
        middle = judging.points_world.mean(axis=(0, 1))[:2]
        bounds = np.stack([np.append(middle - reach_m, -np.pi), np.append(middle + reach_m, np.pi)], axis=1)
        rng = np.random.default_rng(seed)
        drawn = rng.uniform(bounds[:, 0], bounds[:, 1], (_DRAWN, 3))
        places = [
            (np.append(x[:2], z_m), float(x[2]))
            for x, z_m in zip(drawn, rng.choice(judging.heights_m, _DRAWN), strict=True)
        ]
        # Where the arm is not too short and the base in no way first, which costs nothing to tell.
        places.sort(key=lambda place: round(judging.beyond_m(place[0]) + judging.ground.among_m(place[0]), 2))
        for position_m, yaw_rad in [(source_m, 0.0), *places[: _FIRST - 1]]:
            self._score(position_m, yaw_rad)
        scale = np.array([reach_m, reach_m, np.pi])
        for position_m, yaw_rad in self.best(_RUNS):
            start = np.clip(np.append(position_m[:2], yaw_rad), *bounds.T)
            cma = CMA(start / scale, _SIGMA, bounds=bounds / scale[:, None], seed=seed, population_size=_POPULATION)
            for _ in range(_GENERATIONS):
                asked = [cma.ask() for _ in range(_POPULATION)]
                turned = [(x, x * scale) for x in asked]
                cma.tell([(x, self._score(np.append(y[:2], position_m[2]), float(y[2]))) for x, y in turned])

    def best(self, most: int) -> list[tuple[Array, float]]:
        """The best places that are apart, whole centimetres and degrees."""
        found: list[tuple[Array, float]] = []
        for position_m, yaw_rad, cost_m in sorted(self._places, key=lambda each: each[2]):
            apart = all(
                np.linalg.norm(position_m - other) > _APART_M or abs(np.sin((yaw_rad - turn) / 2)) > _APART_RAD / 2
                for other, turn in found
            )
            if apart and len(found) < most and (cost_m < BEYOND_M or not found):
                rounded_m = np.array([*position_m[:2].round(2), position_m[2]])
                found.append((rounded_m, float(np.radians(np.degrees(yaw_rad).round()))))
        return found

    def _score(self, position_m: Array, yaw_rad: float) -> float:
        cost_m = self._judging.score(position_m, yaw_rad)
        self.scored.append((float(position_m[0]), float(position_m[1]), cost_m))
        self._places.append((position_m, yaw_rad, cost_m))
        return cost_m
