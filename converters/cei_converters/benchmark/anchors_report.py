"""What was found at the anchors, as numbers (JSON) and as a table (Markdown)."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cei_converters.benchmark.anchors_stages import ANCHORS, Anchor
from cei_converters.benchmark.marks import mark_of
from cei_converters.benchmark.real_found import Rate

DATA, TABLE = "anchors.json", "anchors.md"
_DIFFERENCES = """What differs from the paper: physics are simulated (MuJoCo), where it has a robot; a script demonstrates, where people teleoperate; the \
camera is exact and stands in front, where the paper's stands to the right; DP3 has a small network. The paper shows a map of 50 trials, of which most \
succeed, and gives no number in its text."""


@dataclass(frozen=True)
class Found:
    """What is finished: of anchors' trials and of the replay, the contents of their JSONs."""

    replay: Mapping[str, Any] | None
    policies: Mapping[Anchor, Mapping[str, Any]]

    @property
    def any(self) -> Mapping[str, Any] | None:
        """One that is finished; None if nothing is."""
        return next(iter(self.policies.values()), self.replay)

    @property
    def commits(self) -> list[str]:
        """At which they were measured, each once."""
        every = [*self.policies.values(), *([] if self.replay is None else [self.replay])]
        return sorted({str(result["commit"]) for result in every})

    def replayed(self, anchor: Anchor) -> Rate | None:
        """What was replayed at an anchor."""
        own = [each["success"] for each in self._episodes(anchor)]
        return Rate(sum(own), len(own)) if own else None

    def failures(self, anchor: Anchor) -> str:
        """Why some of that failed."""
        counted = Counter(each["failure"] for each in self._episodes(anchor) if not each["success"])
        return ", ".join(f"{reason}: {count}" for reason, count in counted.items())

    def made(self, anchor: Anchor) -> int | None:
        """How many demonstrations were made for an anchor; None if that is not known."""
        if self.replay is None or list(anchor.middle_m) not in self.replay["anchors"]:
            return None
        return self.replay["made"][self.replay["anchors"].index(list(anchor.middle_m))]

    def learnt(self, anchor: Anchor) -> Rate | None:
        """The policy's trials at an anchor."""
        found = self.policies.get(anchor)
        return None if found is None else Rate(sum(found["successes"]), len(found["successes"]))

    def _episodes(self, anchor: Anchor) -> list[Mapping[str, Any]]:
        episodes = [] if self.replay is None else self.replay["episodes"]
        return [each for each in episodes if each["anchor"] == anchor.number]


def every_anchor() -> list[Anchor]:
    """All of them, in order."""
    return [Anchor(number=i + 1) for i in range(len(ANCHORS))]


def total(rates: Sequence[Rate | None]) -> Rate | None:
    """Of all that there are; None of none."""
    there = [rate for rate in rates if rate is not None]
    return Rate(sum(r.successes for r in there), sum(r.of for r in there)) if there else None


def write_report(found: Found, folder: Path) -> str:
    """Write anchors.json and anchors.md; returns the Markdown."""
    text = _markdown(found)
    (folder / TABLE).write_text(text + "\n")
    (folder / DATA).write_text(json.dumps(_numbers(found), indent=1) + "\n")
    return text


def _numbers(found: Found) -> dict[str, Any]:
    first = found.any
    assert first is not None
    shared = {name: first[name] for name in ("task", "source", "target", "demonstration", "grid", "range_m", "base_m")}
    entries = []
    for anchor in every_anchor():
        x, y = anchor.middle_m
        entry: dict[str, Any] = {"anchor": anchor.number, "x_m": x, "y_m": y, "made": found.made(anchor)}
        for name, rate in (("replayed", found.replayed(anchor)), ("policy", found.learnt(anchor))):
            entry[name] = None if rate is None else {"successes": rate.successes, "of": rate.of}
        entries.append(entry)
    return shared | {"anchors": entries, "commits": found.commits}


def _markdown(found: Found) -> str:
    first = found.any
    assert first is not None
    made = first["grid"] ** 2 * len(first["anchors"])
    count = f"{len(first['anchors'])} anchors" if len(first["anchors"]) > 1 else "one anchor"
    about = (
        f"One demonstration of {first['source']} (seed {first['demonstration']}) becomes {made} of {first['target']}: a grid of {first['grid']} x "
        f"{first['grid']} places over {100 * first['range_m']:.0f} x {100 * first['range_m']:.0f} cm around each of {count}. Some of them are replayed in physics; "
        "one policy (DP3) learns from all, and is tried at each anchor with the button within 8 cm of it and turned by up to 20 degrees, on clouds as it was "
        "trained on."
    )
    if found.policies:
        trials = next(iter(found.policies.values()))["trials"]
        about += f" {trials['count']} trials an anchor, seeds from {trials['first_seed']} on."
    header = ["anchor", "x, cm", "y, cm", "demonstrations", "replayed", "policy", "why replays failed"]
    lines = [header, ["---"] * len(header)]
    anchors = [a for a in every_anchor() if found.replayed(a) or found.learnt(a)]
    for anchor in anchors:
        place = [f"{100 * value:.0f}" for value in anchor.middle_m]
        rates = [_text(found.replayed(anchor)), _text(found.learnt(anchor))]
        lines.append([str(anchor.number), *place, _text(found.made(anchor)), *rates, found.failures(anchor) or "-"])
    sums = [total([found.replayed(a) for a in anchors]), total([found.learnt(a) for a in anchors])]
    all_made = sum(found.made(a) or 0 for a in anchors) or None
    lines.append(["**all**", "", "", _text(all_made), *(_text(rate) for rate in sums), ""])
    table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    intervals = [
        f"{what} {rate} ({rate.interval[0]:.0%} to {rate.interval[1]:.0%})"
        for what, rate in zip(("replayed", "policy"), sums, strict=True)
        if rate is not None
    ]
    in_all = f"With 95 % confidence (Wilson): {', '.join(intervals)}. `-`: not run. Measured at {mark_of(DATA, found.commits)}."
    return "\n\n".join(["# One demonstration, pressed all over the table", about, table, _DIFFERENCES, in_all])


def _text(value: object) -> str:
    return "-" if value is None else str(value)
