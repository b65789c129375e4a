"""Verified transfer: replay each converted episode in physics, and convert it another way where it fails."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cei_converters.conversion.common import common_correction
from cei_converters.conversion.refine import RefineOptions
from cei_converters.conversion.sample import Sample
from cei_converters.conversion.search import InTurn, Listed, Sampled, Search
from cei_converters.conversion.starting import Chosen, choose_start
from cei_converters.conversion.trials import Held, Trials
from cei_converters.conversion.verdict import Verdict
from cei_converters.dataset.corrections import Corrected
from cei_gym.alignment.contact.correction import Correction, Holds, dwelling
from cei_gym.arrays import Array
from cei_gym.errors import CEIError
from cei_gym.transfer import Attempt

if TYPE_CHECKING:
    from cei_converters.dataset.metadata import Environment
    from cei_converters.simulation.stage import Stage
    from cei_gym.alignment import AlignmentReport
    from cei_gym.demonstration import Demonstration
    from cei_gym.transfer import Transfer
    from cei_gym.transfer.aligned import Aligned

_SAME_RAD = 1e-3  # actions (rad or m) nearer than this to ones that failed are not worth a replay
_POSE_TOLERANCE = 1e-3  # of a base's position, m, and rotation


@dataclass
class VerifyOptions:
    """Verification in simulation; `--verify` switches it on.

    Attributes:
        enabled: replay each converted episode in its environment, and convert it another way where it fails.
        attempts: most ways of converting an episode, the plain one included.
        drop: leave an episode out if none of them succeeds; otherwise its plain transfer is kept.
    """

    enabled: bool = False
    attempts: int = 8
    drop: bool = False

    def __post_init__(self) -> None:
        if self.attempts < 1:
            raise CEIError(f"verify.attempts={self.attempts} must be at least 1.")
        if not self.enabled and (self.drop or self.attempts != VerifyOptions.attempts):
            raise CEIError("--verify.attempts and --verify.drop are of no use without --verify.")


class Verifier:
    """Transfers demonstrations such that they succeed in physics, where some way of transferring them does.

    The plain way is kept if it holds. Else others are tried: with verification those of `Transfer.attempts` in their order, those that move as one
    that failed left out; with refinement then corrections of how it takes hold, that CMA-ES draws, until one holds when replays are perturbed, too,
    and when others confirm it. What holds best is kept.

    Args:
        transfer: what transfers.
        stage: the target's environment (`open_stage`).
        options: see there.
        allow_unreachable: accept transfers that cannot reach every frame; otherwise they fail without a replay.
        refine: see there.

    Attributes:
        common: the correction that all episodes have where it holds no worse than none; what is searched is around it.
    """

    def __init__(
        self,
        transfer: "Transfer",
        stage: "Stage",
        options: VerifyOptions,
        allow_unreachable: bool = False,
        refine: RefineOptions | None = None,
    ) -> None:
        self._transfer, self._stage, self._options = transfer, stage, options
        self._allow_unreachable = allow_unreachable
        self._refine = refine if refine is not None and refine.enabled else None
        self.common: Correction | None = None

    def __call__(
        self, demonstration: "Demonstration", mode: int = 0
    ) -> tuple["Demonstration", "AlignmentReport", Verdict]:
        """Transfer one demonstration; what is returned is plain where nothing holds better.

        Args:
            demonstration: of the source, with the state of its objects.
            mode: which of the `init.modes` motions.
        """
        refine = self._refine
        trials = Trials(self._stage, refine.perturbed if refine else 0, self._allow_unreachable)
        aligned = self._transfer.aligned(demonstration, mode)
        plain = self._tried(trials, aligned, Attempt())
        best, tried, search = plain, [plain], self._search(demonstration, aligned, mode)
        if self.common is not None:
            tried.append(self._tried(trials, aligned, Attempt(correction=self.common)))
            best = max(tried[::-1], key=lambda way: way.share)
        while not self._is_enough(best.share) and not (refine and trials.replays >= refine.replays):
            if (attempt := search.ask()) is None:
                break
            # Clouds take longer than joints, and nothing that fails needs them.
            way = self._tried(trials, self._aligned(aligned, attempt, demonstration, mode), attempt, tried)
            search.tell(way.share)
            if way.known:
                continue
            tried.append(way)
            if self._is_enough(way.share):
                way = replace(way, share=min(way.share, trials.confirm(way.moved)))
            if way.share > best.share:
                best = way
        moved, report = self._transfer.made(best.aligned, best.attempt)
        verdict = Verdict(
            demonstration.index,
            not best.held.failure,
            len(tried),
            str(best.attempt),
            plain.held.failure,
            self._options.drop and bool(best.held.failure),
        )
        if refine is not None:
            judged = 1 + len(best.held.perturbed)
            verdict = replace(verdict, held=best.share, plain_held=plain.share, replays=trials.replays, judged=judged)
        if best.attempt.correction is not None:
            verdict = replace(verdict, corrected=_corrected(best.attempt.correction, aligned, plain.moved))
        return moved, report, verdict

    def choose_start(self, demonstrations: "Sequence[Demonstration]", done: Callable[[int], None]) -> Chosen | None:
        """The start of all episodes, by these; see `choose_start`."""
        assert self._refine is not None
        return choose_start(self._sample(demonstrations), self._refine, done)

    def search_common(
        self, demonstrations: "Sequence[Demonstration]", done: Callable[[int], None]
    ) -> Correction | None:
        """A correction for all episodes, by these; see `common_correction`."""
        assert self._refine is not None
        return common_correction(self._sample(demonstrations), self._refine, done)

    def _sample(self, demonstrations: "Sequence[Demonstration]") -> Sample:
        return Sample(self._transfer, self._stage, demonstrations, self._allow_unreachable)

    def _search(self, demonstration: "Demonstration", aligned: "Aligned", mode: int) -> Search:
        """What to try where the plain way does not hold."""
        searches: list[Search] = []
        if self._options.enabled:
            searches.append(Listed(self._transfer.attempts(self._options.attempts, mode)[1:]))
        if self._refine is not None and aligned.holds:
            seed = (self._refine.seed, demonstration.index, mode)
            searches.append(Sampled(seed, self._refine.population, self.common))
        return InTurn(searches)

    def _is_enough(self, share: float) -> bool:
        return share >= (1.0 if self._refine is None else self._refine.robust)

    def _aligned(self, plain: "Aligned", attempt: Attempt, demonstration: "Demonstration", mode: int) -> "Aligned":
        """Of another way: the plain one where it follows alike."""
        if attempt.basin is None and attempt.representation is None:
            return plain
        return self._transfer.aligned(demonstration, mode, attempt)

    def _tried(self, trials: Trials, aligned: "Aligned", attempt: Attempt, others: "Sequence[_Way]" = ()) -> "_Way":
        """One way, replayed unless it moves as another did."""
        moved, report = self._transfer.made(aligned, attempt, clouds=False)
        for other in others:
            if _same(moved, other.moved):
                return replace(other, known=True)
        held = trials.judge(moved, report)
        return _Way(attempt, aligned, moved, held, held.share)


@dataclass(frozen=True)
class _Way:
    """A way that was tried.

    Attributes:
        attempt, aligned: what it is.
        moved: what came of it, without clouds.
        held: what replays showed.
        share: which share of them, also of those that confirmed it, succeeded.
        known: whether another moves alike.
    """

    attempt: Attempt
    aligned: "Aligned"
    moved: "Demonstration"
    held: Held
    share: float
    known: bool = False


def _corrected(correction: Correction, aligned: "Aligned", plain: "Demonstration") -> Corrected:
    """What the dataset keeps of a correction: with it, where the robot would be in the middle of its first hold without."""
    motion = aligned.followed.motion
    holds = Holds.of(motion.grip, motion.dt_s or 0.0)
    middle = int(holds.first[0] + holds.last[0]) // 2
    shown = dwelling(motion, len(plain), correction)  # the kept one's frames, of the plain one's
    return Corrected(
        correction, int(np.flatnonzero(shown == middle)[0]), [round(float(q), 6) for q in plain.qpos[middle]]
    )


def _same(one: "Demonstration", other: "Demonstration") -> bool:
    a, b = one.action, other.action
    return a.shape == b.shape and bool(np.abs(a - b).max() < _SAME_RAD)


def open_stage(repo_id: str, environment: "Environment", target: str, T_world_base: Array) -> "Stage":
    """The environment in which to verify.

    Args:
        repo_id: the source's dataset, for messages.
        environment: the target's.
        target: its embodiment.
        T_world_base: (4, 4) pose of its base, which must be the environment's.

    Raises:
        CEIError: there is no environment, or its robot stands elsewhere.
    """
    from cei_converters.simulation.stage import Stage

    if environment.id is None:
        raise CEIError(f"{repo_id} names no environment that a {target} could be verified in; leave --verify out.")
    stage = Stage(environment.id, **environment.kwargs)
    if not np.allclose(stage.env.get_wrapper_attr("scene").T_world_base, T_world_base, atol=_POSE_TOLERANCE):
        stage.close()
        raise CEIError(
            f"the base of {environment.id} is not where the converted robot's is; leave --verify or --target_pose out."
        )
    return stage
