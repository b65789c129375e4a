"""How well an episode's quality tells what works: the twin's answers against the true environment, with objects and robots held out.

usage: python benchmarks/score.py [--fit results/twin/twin.json] [--judged results/twin/fresh.json] [--results FOLDER]

Reads what `benchmarks/twin.py` found and runs no simulation. Of `--fit` it counts how many episodes work of each answer (`cei_gym.twin.calibration`) and
fits the prior of replays (`cei_converters.conversion.quality`). Then it counts anew with each object, or robot, left out, and scores that one with the counts
of the others; last, it scores `--judged`, seeds that nothing was fitted on. It writes the table that was used, AUC, what `--min_quality` keeps, and a
reliability plot.
"""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measure import save
from scipy.optimize import minimize
from scipy.stats import betabinom, bootstrap

from cei_converters.conversion.quality import PRIOR
from cei_converters.replay import wilson
from cei_gym.twin.calibration import WORKED, probability
from cei_gym.twin.evidence import CANNOT, FAILS, HOLDS, UNSURE, Evidence

FIT, JUDGED = Path("results/twin/twin.json"), Path("results/twin/fresh.json")
BOUNDS = (0.5, 0.8)
ANSWERS = (HOLDS, UNSURE, FAILS)
_BINS = (0.4, 0.85)  # between qualities of the three answers
Row = Mapping[str, Any]
Counts = Mapping[str, tuple[int, int]]


def counted(rows: Sequence[Row]) -> dict[str, tuple[int, int]]:
    """Per answer how many episodes work, and of how many."""
    said = {answer: [bool(row["truth"]) for row in rows if row["answer"] == answer] for answer in ANSWERS}
    return {answer: (sum(works), len(works)) for answer, works in said.items()}


def prior(rows: Sequence[Row]) -> tuple[float, float]:
    """The beta distribution that explains best how many replays of each episode succeed."""
    n = 1 + len(rows[0]["shaken"])
    held = [row["truth"] + sum(row["shaken"]) for row in rows]
    found = minimize(lambda x: -betabinom.logpmf(held, n, *np.exp(x)).sum(), np.zeros(2), method="Nelder-Mead")
    a, b = np.exp(found.x)
    return round(float(a), 2), round(float(b), 2)


def scored(rows: Sequence[Row], worked: Counts) -> list[tuple[float | None, bool]]:
    """The quality of each, None where it is not known, and whether it works."""
    return [
        (probability(Evidence(row["answer"], reason=row.get("reason", "")), worked), bool(row["truth"])) for row in rows
    ]


def held_out(rows: Sequence[Row], by: str) -> list[tuple[float | None, bool]]:
    """The same, each by counts over those of other objects, or robots."""
    found: list[tuple[float | None, bool]] = []
    for name in dict.fromkeys(row[by] for row in rows):
        found += scored([row for row in rows if row[by] == name], counted([row for row in rows if row[by] != name]))
    return found


def auc(pairs: Sequence[tuple[float, bool]]) -> float | None:
    """The chance that of two, one of which works, that one has the higher quality; None where all or none works."""
    quality, works = np.array([q for q, _ in pairs]), np.array([w for _, w in pairs])
    good, bad = quality[works], quality[~works]
    if not len(good) or not len(bad):
        return None
    return float(((good[:, None] > bad) + 0.5 * (good[:, None] == bad)).mean())


def figures(pairs: Sequence[tuple[float | None, bool]]) -> dict[str, Any]:
    """AUC with an interval, and what bounds keep."""
    known = [(quality, works) for quality, works in pairs if quality is not None]
    found: dict[str, Any] = {"episodes": len(pairs), "fail": sum(not w for _, w in pairs), "known": len(known)}
    found["auc"] = _rounded(auc(known))
    if found["auc"] is not None:
        found["auc_95"] = _interval(known)
    # what nothing is known of, at the share that works of all that is not
    unknown = [works for quality, works in pairs if quality is None]
    middle = np.mean([w for _, w in known]) if unknown and known else 0.0
    found["auc_of_all"] = _rounded(auc([(middle if q is None else q, w) for q, w in pairs]))
    for bound in BOUNDS:
        kept = [works for quality, works in known if quality >= bound]
        found[f"kept_at_{bound:g}"] = {"works": sum(kept), "of": len(kept)}
        if kept:
            found[f"kept_at_{bound:g}"]["interval_95"] = [round(b, 3) for b in wilson(sum(kept), len(kept))]
    return found


def _interval(known: Sequence[tuple[float, bool]]) -> list[float]:
    at = np.arange(len(known))

    def of(some: np.ndarray) -> float:
        return auc([known[int(i)] for i in some]) or 0.5

    found = bootstrap((at,), of, n_resamples=999, method="percentile", vectorized=False, rng=np.random.default_rng(0))
    return [round(float(b), 3) for b in (found.confidence_interval.low, found.confidence_interval.high)]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def draw(path: Path, named: Mapping[str, Sequence[tuple[float | None, bool]]]) -> None:
    """How many work of those of a quality, with 95 % intervals: on the diagonal a quality is what it says."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 5.2), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    for k, (name, pairs) in enumerate(named.items()):
        quality, works = (np.array(each) for each in zip(*((q, w) for q, w in pairs if q is not None), strict=True))
        bins = np.digitize(quality, _BINS)
        for i, which in enumerate(np.unique(bins)):
            own = works[bins == which]
            share, (low, high) = own.mean(), wilson(int(own.sum()), len(own))
            x = quality[bins == which].mean() + 0.02 * (k - (len(named) - 1) / 2)
            axes.errorbar(
                x, share, [[share - low], [high - share]], fmt="o", color=f"C{k}", capsize=3, label=None if i else name
            )
            axes.annotate(f"{len(own)}", (x, share), (6, -3), textcoords="offset points", fontsize=8, color=f"C{k}")
    axes.set(
        xlabel="quality, by the twin", ylabel="share that works in the environment", xlim=(0, 1), ylim=(-0.03, 1.03)
    )
    axes.legend(loc="upper left", fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def line(name: str, found: Mapping[str, Any]) -> str:
    """A row of the table."""
    shown = "-" if found["auc"] is None else "{:.2f} ({:.2f} to {:.2f})".format(found["auc"], *found["auc_95"])
    kept = found[f"kept_at_{BOUNDS[-1]:g}"]
    return f"| {name} | {found['episodes']} | {found['fail']} | {found['known']} | {shown} | {found['auc_of_all']} | {kept['works']} of {kept['of']} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fit", type=Path, default=FIT)
    parser.add_argument(
        "--judged", type=Path, default=JUDGED, help="of other seeds; left out where there is no such file"
    )
    parser.add_argument("--results", type=Path, help="folder for score.json and reliability.png; default: printed only")
    args = parser.parse_args()
    fit = json.loads(args.fit.read_text())["rows"]
    worked = counted(fit)
    named: dict[str, Callable[[], list[tuple[float | None, bool]]]] = {
        "other objects": lambda: held_out(fit, "thing"),
        "other robots": lambda: held_out(fit, "target"),
    }
    seeds = [min(row["seed"] for row in fit), max(row["seed"] for row in fit)]
    if args.judged.exists():
        fresh = json.loads(args.judged.read_text())["rows"]
        named["other seeds"] = lambda: scored(fresh, worked)
        seeds = [seeds[0], max(row["seed"] for row in fresh)]
    pairs = {name: of() for name, of in named.items()}
    found = {name: figures(each) for name, each in pairs.items()}
    cannot = {"works": sum(row["truth"] for row in fit if row["answer"] == CANNOT)}
    cannot["of"] = sum(row["answer"] == CANNOT for row in fit)
    print(
        "| held out | episodes | fail | known | AUC, 95 % | AUC, the unknown at their mean | of what --min_quality=0.8 keeps, works |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, each in found.items():
        print(line(name, each))
    print(
        f"counts {worked} (calibration.py has {dict(WORKED)}); cannot be judged: {cannot}; prior {prior(fit)} (quality.py has {PRIOR})"
    )
    if args.results is not None:
        draw(args.results / "reliability.png", pairs)
        result = {"worked": worked, "cannot": cannot, "prior": prior(fit), "held_out": found}
        save(args.results / "score.json", result, "reliability.png", seeds=seeds)


if __name__ == "__main__":
    main()
