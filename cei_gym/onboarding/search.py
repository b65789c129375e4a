"""The search for a way to close: from where to where joints go so that finger surfaces that face each other meet."""

import numpy as np
from cmaes import CMA

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.onboarding.closing import POSES, SHUT_M, WIDER_M, Closing, Judge

_MARGIN = 0.05  # of a joint's range that is kept to its limits
_ROUNDS, _RESTARTS = 200, 2
_GOOD = 0.3  # a cost that no other beginning need be tried for


def design(
    judge: Judge, embodiment: Embodiment, rest: Array, active: Array, rounds: int = _ROUNDS, seed: int = 0
) -> Closing:
    """Find a way to close.

    Args:
        judge: of the sides that should meet.
        embodiment: an end-effector.
        rest: (m,) where the joints stay that are not active.
        active: indices of independent joints that may move.
        rounds: of the search, at most.
        seed: of the search.
    """
    lower, upper = embodiment.independent_limits
    low, span = lower[active], upper[active] - lower[active]

    def poses(x: Array) -> tuple[Array, Array]:
        both = np.repeat(rest[None, None], 2, axis=0).repeat(len(x), axis=1)
        both[:, :, active] = low + span * np.moveaxis(x.reshape(len(x), 2, len(active)), 1, 0)
        return both[0], both[1]

    bounds = np.tile([_MARGIN, 1 - _MARGIN], (2 * len(active), 1))
    flexed = np.where(upper[active] + lower[active] >= 0, 1.0, 0.0)
    best, least = None, np.inf
    for restart in range(_RESTARTS):
        rng = np.random.default_rng([seed, restart])
        # Open is about 0, and closing goes where there is more room.
        home = np.clip(-low / np.maximum(span, 1e-9), 0.1, 0.9)
        mean = np.concatenate([home, home + 0.5 * (flexed - home)]) + 0.15 * restart * rng.standard_normal(
            2 * len(active)
        )
        search = CMA(
            mean=np.clip(mean, 0.06, 0.94), sigma=0.2, bounds=bounds, seed=int(rng.integers(2**31)), population_size=32
        )
        for _ in range(rounds):
            x = np.stack([search.ask() for _ in range(search.population_size)])
            cost = judge(*poses(x))
            search.tell(list(zip(x, cost.tolist(), strict=True)))
            if cost.min() < least:
                best, least = x[cost.argmin()], float(cost.min())
            if search.should_stop():
                break
        if least < _GOOD or rounds < _ROUNDS:
            break
    assert best is not None
    home, closed = poses(best[None])
    return judge.closing(home[0], closed[0])


def scan(judge: Judge, embodiment: Embodiment, rest: Array, joint: int) -> Closing:
    """The better of the two ways that one joint can close: between where it is wide open and where the sides meet."""
    lower, upper = embodiment.independent_limits
    best: Closing | None = None
    for start, end in ((lower[joint], upper[joint]), (upper[joint], lower[joint])):
        values = np.linspace(start, end, 201)
        ways = np.repeat(rest[None], 2, axis=0)
        ways[0, joint], ways[1, joint] = start, end
        whole = judge.closing(ways[0], ways[1])
        gap = np.interp(np.linspace(0, 1, len(values)), np.linspace(0, 1, POSES), whole.gap_m)
        first = int(np.argmax(gap <= WIDER_M)) if (gap <= WIDER_M).any() else 0
        shut = gap <= 4 * SHUT_M
        last = int(np.argmax(shut)) if shut.any() else len(values) - 1
        if last <= first:
            first, last = 0, len(values) - 1
        ways[0, joint], ways[1, joint] = values[first], values[last]
        way = judge.closing(ways[0], ways[1])
        if best is None or way.cost < best.cost:
            best = way
    assert best is not None
    return best
