"""What two motions of a demonstration do, and policies of them, beside the paper's: as numbers (JSON) and as tables (Markdown)."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.benchmark import paper
from cei_converters.benchmark.marks import mark_of
from cei_converters.benchmark.modes_replay import BOTH, MOMENTS
from cei_converters.benchmark.modes_stages import PATTERNS, Pattern
from cei_converters.benchmark.real_found import Rate, of_policy

DATA, TABLE = "modes.json", "modes.md"
_DIFFERENCES = f"""What differs from the paper: physics are simulated (MuJoCo), where it has robots; a script that varies as people do demonstrates, where people \
teleoperate; DP3 has a small network; the paper has {paper.REAL_TRIALS} trials a policy, and no replays."""


@dataclass(frozen=True)
class Found:
    """What is finished: of the replay and of patterns' policies, the contents of their JSONs."""

    replay: Mapping[str, Any] | None
    policies: Mapping[Pattern, Mapping[str, Any]]

    @property
    def is_empty(self) -> bool:
        """Whether nothing is."""
        return self.replay is None and not self.policies

    @property
    def commits(self) -> list[str]:
        """At which they were measured, each once."""
        every = [*self.policies.values(), *([] if self.replay is None else [self.replay])]
        return sorted({str(result["commit"]) for result in every})

    def replayed(self, pattern: str) -> Rate | None:
        """Demonstrations in a motion; None where that is not run, or for the mixture."""
        if self.replay is None or pattern not in BOTH:
            return None
        result = self.replay["patterns"][pattern]
        return Rate(result["successes"], result["episodes"])

    def learnt(self, pattern: str) -> Rate | None:
        """A pattern's policy."""
        return of_policy(self.policies.get(Pattern(variant=pattern)))

    def angles_deg(self) -> dict[str, dict[str, float]]:
        """Moment to the mean and the least angle between the hands of the two motions; empty where nothing is replayed."""
        if self.replay is None:
            return {}
        angles = np.asarray(self.replay["angles_deg"])
        return {
            moment: {"mean": round(float(column.mean()), 1), "least": round(float(column.min()), 1)}
            for moment, column in zip(MOMENTS, angles.T, strict=True)
        }


def write_report(found: Found, folder: Path) -> str:
    """Write modes.json and modes.md; returns the Markdown."""
    text = _markdown(found)
    (folder / TABLE).write_text(text + "\n")
    patterns = {
        pattern: {
            name: _entry(rate)
            for name, rate in (("replayed", found.replayed(pattern)), ("policy", found.learnt(pattern)))
        }
        | {"paper": {"successes": paper.MODES[pattern], "of": paper.REAL_TRIALS}}
        for pattern in PATTERNS
    }
    numbers = {"patterns": patterns, "angles_deg": found.angles_deg(), "commits": found.commits}
    (folder / DATA).write_text(json.dumps(numbers, indent=1) + "\n")
    return text


def _markdown(found: Found) -> str:
    about = (
        "Demonstrations of the AG-95 gripper, converted for the XHand with `--init=eis --init.modes=2`: pattern 1 is the motion that costs the alignment "
        "less, pattern 2 the best that differs in what the hand does, and the mixture has every other episode in each."
    )
    if found.replay is not None:
        first, last = found.replay["seeds"]
        about += f" Replayed: seeds {first} to {last} in both motions, in physics."
    if found.policies:
        one = next(iter(found.policies.values()))
        about += (
            f" Policies (DP3): {one['demonstrations']} demonstrations, {len(one['successes'])} trials each, seeds from {one['trials']['first_seed']} on, on clouds "
            "as they were trained on."
        )
    header = ["", "replayed", "policy", "95 %", "paper"]
    lines = [header, ["---"] * len(header)]
    for pattern in PATTERNS:
        learnt = found.learnt(pattern)
        interval = "-" if learnt is None else "{:.0%} to {:.0%}".format(*learnt.interval)
        figures = [_text(found.replayed(pattern)), _text(learnt), interval]
        lines.append([pattern.replace("_", " "), *figures, f"{paper.MODES[pattern]} of {paper.REAL_TRIALS}"])
    parts = ["# Two motions from one demonstration: OpenDrawer", about, _table(lines)]
    if found.replay is not None:
        angles = found.angles_deg()
        said = [[moment, f"{each['mean']:.0f}", f"{each['least']:.0f}"] for moment, each in angles.items()]
        parts.append(
            "By how many degrees the hands of the two motions are turned from each other, over the demonstrations that were replayed:"
        )
        parts.append(_table([["", "mean", "least"], ["---"] * 3, *said]))
        parts.append("![Both motions as the drawer is half open](modes.png)")
    return "\n\n".join([*parts, _DIFFERENCES, f"`-`: not run. Measured at {mark_of(DATA, found.commits)}."])


def _entry(rate: Rate | None) -> dict[str, int] | None:
    return None if rate is None else {"successes": rate.successes, "of": rate.of}


def _text(rate: Rate | None) -> str:
    return "-" if rate is None else str(rate)


def _table(lines: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
