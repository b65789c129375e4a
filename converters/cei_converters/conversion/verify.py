"""Verified transfer: replay each converted episode in physics, and convert it another way where it fails."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cei_gym.arrays import Array
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.dataset.metadata import Environment
    from cei_converters.simulation.stage import Stage
    from cei_gym.alignment import AlignmentReport
    from cei_gym.demonstration import Demonstration
    from cei_gym.transfer import Transfer

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


@dataclass(frozen=True)
class Verdict:
    """What replaying an episode showed.

    Attributes:
        episode: its index in the source's dataset.
        success: whether some way of converting it succeeds.
        attempts: how many were tried.
        how: the one that is kept (`cei_gym.transfer.Attempt`).
        failure: why the plain one fails; empty if it does not.
        dropped: whether the episode is left out.
    """

    episode: int
    success: bool
    attempts: int
    how: str
    failure: str
    dropped: bool = False

    def record(self) -> dict[str, Any]:
        """For the dataset's metadata."""
        return {name: getattr(self, name) for name in ("success", "attempts", "how", "failure")}

    def row(self) -> dict[str, str]:
        """For the table on the terminal."""
        kept = self.how if self.success else "failed"
        return {"plain": self.failure or "success", "verified": "dropped" if self.dropped else kept}


class Verifier:
    """Transfers demonstrations such that they succeed in physics, where some way of `Transfer.attempts` does.

    Ways are tried in its order, those that move as one that failed left out; the first that succeeds is kept.

    Args:
        transfer: what transfers.
        stage: the target's environment (`open_stage`).
        options: see there.
        allow_unreachable: accept transfers that cannot reach every frame; otherwise they fail without a replay.
    """

    def __init__(
        self, transfer: "Transfer", stage: "Stage", options: VerifyOptions, allow_unreachable: bool = False
    ) -> None:
        self._transfer, self._stage, self._options = transfer, stage, options
        self._allow_unreachable = allow_unreachable

    def __call__(
        self, demonstration: "Demonstration", mode: int = 0
    ) -> tuple["Demonstration", "AlignmentReport", Verdict]:
        """Transfer one demonstration; what is returned is plain where nothing succeeds.

        Args:
            demonstration: of the source, with the state of its objects.
            mode: which of the `init.modes` motions.
        """
        plain, report = self._transfer(demonstration, mode)
        index, failure = demonstration.index, self._failure(plain, report)
        if not failure:
            return plain, report, Verdict(index, True, 1, "plain", "")
        tried = [plain]
        for attempt in self._transfer.attempts(self._options.attempts, mode)[1:]:
            # Clouds take longer than joints, and nothing that fails needs them.
            moved, its_report = self._transfer(demonstration, mode, attempt=attempt, clouds=False)
            if any(_same(moved, other) for other in tried):
                continue
            tried.append(moved)
            if not self._failure(moved, its_report):
                moved, its_report = self._transfer(demonstration, mode, attempt=attempt)
                return moved, its_report, Verdict(index, True, len(tried), str(attempt), failure)
        return plain, report, Verdict(index, False, len(tried), "plain", failure, self._options.drop)

    def _failure(self, moved: "Demonstration", report: "AlignmentReport") -> str:
        """Why a transferred demonstration fails; empty if it does not."""
        if report.unreachable_frames and not self._allow_unreachable:
            return "unreachable"
        stored = moved.qpos.astype(np.float32).astype(float)  # the very start that a replay of the dataset has
        result, _ = self._stage.play(replace(moved, qpos=stored))
        return "" if result["success"] else result["failure"]


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


def summarise(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """The result of a verified conversion, apart from that of the plain one."""
    return {
        "episodes": len(verdicts),
        "plain_successes": sum(not v.failure for v in verdicts),
        "verified_successes": sum(v.success for v in verdicts),
        "retried": sum(v.attempts > 1 for v in verdicts),
        "dropped": [v.episode for v in verdicts if v.dropped],
        "how": dict(Counter(v.how for v in verdicts if v.success)),
        "results": [{"episode": v.episode, **v.record()} for v in verdicts],
    }


def sentence(summary: dict[str, Any]) -> str:
    """`summarise` in one line."""
    n = summary["episodes"]
    return (
        f"plain {summary['plain_successes']}/{n}, verified {summary['verified_successes']}/{n} "
        f"({summary['retried']} retried), dropped {len(summary['dropped'])}"
    )


def check_kept(summary: dict[str, Any]) -> None:
    """Check that an episode is left.

    Raises:
        CEIError: all are dropped.
    """
    n = len(summary["dropped"])
    if n == summary["episodes"]:
        raise CEIError(
            f"no episode of {n} succeeds, so all are dropped and nothing is written; leave out --verify.drop."
        )
