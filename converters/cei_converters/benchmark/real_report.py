"""The real-world table beside the paper's, as Markdown and CSV."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from cei_converters.benchmark import paper
from cei_converters.benchmark.marks import mark_of
from cei_converters.benchmark.real_found import Found, Pair, Rate, failures_of, of_paper
from cei_converters.benchmark.real_tasks import RealTask, transfer_ratio
from cei_converters.benchmark.results import fidelity_mean

TABLE, DATA = "real.md", "real.csv"
_COLUMNS = (
    *("task", "direction", "robot", "stage", "successes", "of", "wilson_low", "wilson_high"),
    *("fidelity_mean", "failures", "paper_successes", "paper_of", "commit"),
)
_DIFFERENCES = f"""What differs from the paper: physics are simulated (MuJoCo), where it has robots; the arm is a UR5e, where it has a UR5; a scripted \
expert that varies as people do demonstrates, where people teleoperate; clouds are of one exact depth camera; DP3 has a small network; the paper \
has {paper.REAL_TRIALS} trials a policy, and no replays of these tasks."""


def write_report(found: Found, folder: Path) -> str:
    """Write real.md and real.csv; returns the Markdown."""
    text = _markdown(found)
    (folder / TABLE).write_text(text + "\n")
    with (folder / DATA).open("w", newline="") as file:
        writer = csv.DictWriter(file, _COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(_csv_rows(found))
    return text


def _markdown(found: Found) -> str:
    parts = ["# The paper's real-world table, in simulation"]
    if found.policies:
        parts += ["## Policies", _about_policies(found), _policies(found)]
    if found.replays:
        parts += ["## Replay", _about_replays(found), _replays(found)]
    return "\n\n".join([*parts, _DIFFERENCES, f"`-`: not run. Measured at {mark_of(DATA, found.commits)}."])


# -- policies -----------------------------------------------------------------------------------------------------------


def _about_policies(found: Found) -> str:
    first = next(iter(found.policies.values()))
    varied = f", which vary {first['variation']:g} times as much as people's" if first["variation"] != 1 else ""
    return (
        f"{first['demonstrations']} demonstrations of the source{varied}, converted for the target, less those that go another way in the joints than the others; a policy (DP3) that is trained on them acts on the "
        "target, on clouds as it was trained on. Beside it the source's own policy, of its own demonstrations, on the source, on clouds as cameras see "
        f"them. {len(first['successes'])} trials each, seeds from {first['trials']['first_seed']} on. The ratio is the target's success by the source's."
    )


def _policies(found: Found) -> str:
    tasks = [task for task in found.tasks if found.learnt(task) != (None, None)]
    header = [
        "",
        "task",
        "on the target",
        "95 %",
        "source's own",
        "95 %",
        "ratio",
        "paper",
        "its source's",
        "its ratio",
    ]
    lines = [header, ["---"] * len(header)]
    directions = list(dict.fromkeys(task.direction for task in tasks))
    for direction in directions:
        group = [task for task in tasks if task.direction == direction]
        lines += [_policy_line(task, found.learnt(task), of_paper(task)) for task in group]
        lines.append(_average_line(direction, group, found))
    if len(directions) > 1:
        lines.append(_average_line("all", tasks, found))
    return _table(lines)


def _policy_line(task: RealTask, ours: Pair, theirs: Pair) -> list[str]:
    figures = [text for rate in ours for text in (_text(rate), _interval(rate))]
    return [task.direction, task.name, *figures, _ratio([ours]), *map(_text, theirs), _ratio([theirs])]


def _average_line(name: str, tasks: Sequence[RealTask], found: Found) -> list[str]:
    """Averages over those tasks of which both policies are finished, the paper's over the same."""
    whole = [task for task in tasks if None not in found.learnt(task)]
    ours, theirs = [found.learnt(task) for task in whole], [of_paper(task) for task in whole]
    target, own = (_percent(pair[side] for pair in ours) for side in (0, 1))
    figures = [target, "", own, "", _ratio(ours), *(_percent(pair[side] for pair in theirs) for side in (0, 1))]
    return [f"**{name}**", f"average of {len(whole)}", *figures, _ratio(theirs)]


def _percent(rates: Iterable[Rate | None]) -> str:
    shares = [rate.share for rate in rates if rate is not None]
    return f"{sum(shares) / len(shares):.1%}" if shares else "-"


def _ratio(pairs: Iterable[Pair]) -> str:
    ratio = transfer_ratio((target.share, own.share) for target, own in pairs if target is not None and own is not None)
    return "-" if ratio is None else f"{ratio:.1%}"


# -- replays ------------------------------------------------------------------------------------------------------------


def _about_replays(found: Found) -> str:
    first, last = next(iter(found.replays.values()))["seeds"]
    return (
        f"{last - first + 1} demonstrations of the source (seeds {first} to {last}), converted with default options and replayed in physics on the target, "
        "from the same starts. Fidelity is how well pads follow, 0 to 1, a mean over episodes. The last columns are of the source itself: its own demonstrations "
        "replayed, and how many its script failed to make, which are not replayed."
    )


def _replays(found: Found) -> str:
    header = ["", "task", "on the target", "95 %", "fidelity", "failures", "on the source", "not demonstrated"]
    lines = [header, ["---"] * len(header)]
    for task in found.tasks:
        target, own = found.replayed(task)
        if (result := found.replays.get(task.replayed) or found.replays.get(task.recorded)) is not None:
            fidelity = fidelity_mean(result)
            first, last = result["seeds"]
            said = [
                "-" if fidelity is None else f"{fidelity:.2f}",
                failures_of(found.replays.get(task.replayed)) or "-",
            ]
            absent = str(last - first + 1 - len(result["source_seeds"]))
            lines.append([task.direction, task.name, _text(target), _interval(target), *said, _text(own), absent])
    return _table(lines)


# -- both ---------------------------------------------------------------------------------------------------------------


def _text(rate: Rate | None) -> str:
    return "-" if rate is None else str(rate)


def _interval(rate: Rate | None) -> str:
    return "-" if rate is None else "{:.0%} to {:.0%}".format(*rate.interval)


def _table(lines: Iterable[Iterable[str]]) -> str:
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _csv_rows(found: Found) -> Iterator[dict[str, Any]]:
    for task in found.tasks:
        pairs: list[tuple[str, Pair, Pair]] = [
            ("replay", found.replayed(task), (None, None)),
            ("policy", found.learnt(task), of_paper(task)),
        ]
        results = {
            "replay": (found.replays.get(task.replayed), found.replays.get(task.recorded)),
            "policy": (found.policies.get(task.policy), found.policies.get(task.own_policy)),
        }
        for stage, ours, theirs in pairs:
            for robot, rate, figure, result in zip(
                (task.target, task.source), ours, theirs, results[stage], strict=True
            ):
                if rate is None or result is None:
                    continue
                fidelity = fidelity_mean(result)
                values = (task.name, task.direction, robot, stage, rate.successes, rate.of)
                interval = (round(bound, 3) for bound in rate.interval)
                said = (
                    "" if fidelity is None else round(fidelity, 3),
                    failures_of(result) if stage == "replay" else "",
                )
                beside = ("", "") if figure is None else (figure.successes, figure.of)
                yield dict(zip(_COLUMNS, (*values, *interval, *said, *beside, result["commit"]), strict=True))
