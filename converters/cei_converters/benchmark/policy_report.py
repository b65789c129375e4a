"""The policy table beside the paper's, as Markdown and CSV; success bars and learning curves."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cei_converters.benchmark import paper
from cei_converters.benchmark.marks import mark_of
from cei_converters.benchmark.policy_stages import BLIND, VARIANTS, PolicyCell, Stages
from cei_converters.benchmark.tables import shown

type Found = Mapping[PolicyCell, Mapping[str, Any]]


def write_report(found: Found, stages: Stages, folder: Path) -> str:
    """Write policy.md, policy.csv, success.png and learning.png; returns the Markdown."""
    text = _markdown(found)
    (folder / "policy.md").write_text(text + "\n")
    with (folder / "policy.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["task", "target", "variant", "seed", "successes", "trials", "paper_percent", "commit"])
        for cell, result in found.items():
            figure = _paper(cell.task, cell.target, cell.variant)
            row = [cell.task, cell.target, cell.variant, "" if cell.variant in BLIND else cell.seed]
            beside = ["" if figure is None else figure, result["commit"]]
            writer.writerow([*row, sum(result["successes"]), len(result["successes"]), *beside])
    _bars(found, folder / "success.png")
    _curves(found, folder / "learning.png")
    return text


def _paper(task: str, target: str, variant: str) -> float | None:
    figures = paper.POLICY[task].get(variant)
    return None if figures is None else figures[paper.POLICY_TARGETS.index(target)]


def _percent(found: Found, task: str, target: str, variant: str) -> float | None:
    """Over all training seeds; None where no cell is finished."""
    trials = [
        s for c, r in found.items() if (c.task, c.target, c.variant) == (task, target, variant) for s in r["successes"]
    ]
    return 100 * sum(trials) / len(trials) if trials else None


def _markdown(found: Found) -> str:
    lines = [
        "# Policies trained on converted demonstrations",
        "",
        "Percent of trials that succeed: ours / the paper's.",
        "",
    ]
    lines += [
        "| task | variant | " + " | ".join(paper.POLICY_TARGETS) + " |",
        "|---" * (2 + len(paper.POLICY_TARGETS)) + "|",
    ]
    for task in dict.fromkeys(cell.task for cell in found):
        for variant, label in VARIANTS.items():
            cells = []
            for target in paper.POLICY_TARGETS:
                figure = _paper(task, target, variant)
                cells.append(f"{shown(_percent(found, task, target, variant))} / {shown(figure)}")
            lines.append(f"| {task} | {label} | " + " | ".join(cells) + " |")
    first = next(iter(found.values()))
    lines += [
        "",
        f"{len(first['successes'])} trials from seed {first['trials']['first_seed']} on. {first['demonstrations']} demonstrations "
        f"of a scripted expert that varies {first['variation']:g} times as much as people do.",
    ]
    mark = mark_of("policy.csv", sorted({str(result["commit"]) for result in found.values()}))
    return "\n".join([*lines, f"`-`: not run. Measured at {mark}."])


def _bars(found: Found, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    groups = list(dict.fromkeys((cell.task, cell.target) for cell in found))
    figure, axes = plt.subplots(figsize=(2 + 2.6 * len(groups), 4))
    for i, (task, target) in enumerate(groups):
        for j, (variant, label) in enumerate(VARIANTS.items()):
            ours, theirs = _percent(found, task, target, variant), _paper(task, target, variant)
            x = i + (j - 2) * 0.17
            if ours is not None:
                axes.bar(x, ours, 0.15, color=f"C{j}", label=label if i == 0 else None)
                axes.text(x, ours + 1, f"{ours:.0f}", ha="center", fontsize=8)
            if theirs is not None:
                axes.plot(
                    [x - 0.075, x + 0.075], [theirs] * 2, color="black", label="the paper" if i == j == 0 else None
                )
    axes.set_xticks(range(len(groups)), [f"{task}\n{target}" for task, target in groups])
    axes.set(ylabel="trials that succeed, %", ylim=(0, 108))
    axes.legend(fontsize=8, frameon=False, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.15))
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)


def _curves(found: Found, path: Path) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4))
    for cell, result in found.items():
        if result.get("losses") and cell.variant != "no_inference_augmentation":  # the same training as CEI's
            steps, losses = zip(*result["losses"], strict=True)
            axes.semilogy(steps, losses, label=f"{cell.task} {cell.target}, {VARIANTS[cell.variant]}")
    axes.set(xlabel="step", ylabel="training loss")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)
