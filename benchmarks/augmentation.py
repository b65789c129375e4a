"""Spatial augmentation: one demonstration becomes a hundred, cubes stand elsewhere, and each is executed in physics.

usage: python benchmarks/augmentation.py [--target UR5e-FourierRight] [--seed 1000] [--grid 10,10] [--range 0.2,0.2]

Four ways: as it is, with cubes also turned by up to 30 degrees, with the paper's ramp over the whole episode, and as a control the
demonstration without augmentation from the same starts. Writes results/augmentation/PickCube-<target>.json and .png.
"""

import argparse
import json
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

from measure import save

from cei_converters import convert, record
from cei_converters.simulation.stage import Stage
from cei_converters.sources.reader import DatasetReader

SOURCE = "Panda-PandaGripper"
WAYS = {
    "augmented": [],
    "turned by up to 30 degrees, too": ["--augment.rotation_deg=30"],
    "the paper's ramp": ["--augment.ramp_over=episode"],
}
CONTROL = "not augmented"


def converted(folder: Path, name: str, target: str, *options: str) -> tuple[DatasetReader, dict]:
    """A conversion of the one demonstration, and its result."""
    root = folder / name
    paths = [f"--dataset.root={folder / 'source'}", f"--new_root={root}", f"--json={root}.json"]
    done = convert.main(
        ["--dataset.repo_id=me/source", f"--target={target}", f"--new_repo_id=me/{name}", *paths, *options]
    )
    if done:
        raise SystemExit(done)
    return DatasetReader(f"me/{name}", root), json.loads(Path(f"{root}.json").read_text())


def counted(outcomes: list[dict], left_out: dict[str, int]) -> dict:
    """One way's result, with an entry an episode."""
    failures = Counter(outcome["failure"] for outcome in outcomes if outcome["failure"])
    successes = len(outcomes) - failures.total()
    return {"successes": successes, "replayed": len(outcomes), "left_out": left_out, "failures": dict(failures)} | {
        "episodes": outcomes
    }


def draw(path: Path, ways: dict[str, dict]) -> None:
    """Where cubes stand against where the recorded one did, a panel a way: green where the episode succeeds, else red."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, len(ways), figsize=(3 * len(ways), 3.6), sharey=True, layout="constrained")
    for panel, (name, way) in zip(panels, ways.items(), strict=True):
        episodes = way["episodes"]
        colours = ["#c22" if episode["failure"] else "#2a2" for episode in episodes]
        panel.scatter([100 * e["x_m"] for e in episodes], [100 * e["y_m"] for e in episodes], s=24, c=colours)
        panel.plot(0, 0, "k+", markersize=14)
        panel.set_title(f"{name}: {way['successes']} of {way['replayed']}", fontsize=9)
        panel.set_xlabel("x (cm)")
        panel.set_aspect("equal")
    panels[0].set_ylabel("y (cm), from the recorded cube")
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--target", default="UR5e-FourierRight")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--grid", default="10,10")
    parser.add_argument("--range", default="0.2,0.2")
    parser.add_argument("--results", type=Path, default=Path("results/augmentation"))
    args = parser.parse_args()
    grid = [f"--augment.grid={args.grid}", f"--augment.range={args.range}"]
    ways = {}
    with tempfile.TemporaryDirectory() as temporary, Stage(f"CEI-PickCube-{args.target}") as stage:
        folder = Path(temporary)
        recorded = [f"--env=CEI-PickCube-{SOURCE}", "--episodes=1", f"--seed={args.seed}"]
        if done := record.main([*recorded, "--repo_id=me/source", f"--root={folder / 'source'}"]):
            raise SystemExit(done)
        plain = converted(folder, "plain", args.target)[0].read(0, clouds=False)
        control = []
        for number, (name, options) in enumerate(WAYS.items()):
            dataset, result = converted(folder, f"augmented{number}", args.target, *grid, *options)
            outcomes = []
            for index in range(len(dataset)):
                demonstration = dataset.read(index, clouds=False)
                offset = dataset.record(index)["offset"]
                outcomes.append(offset | {"failure": stage.play(demonstration)[0]["failure"]})
                if number == 0:
                    moved = replace(plain, environment_state=demonstration.environment_state)
                    control.append(offset | {"failure": stage.play(moved)[0]["failure"]})
            ways[name] = counted(outcomes, result["augment"]["left_out"])
            print(f"{name}: {ways[name]['successes']} of {len(outcomes)} succeed; left out: {ways[name]['left_out']}")
    ways[CONTROL] = counted(control, {})
    print(f"{CONTROL}: {ways[CONTROL]['successes']} of {len(control)} succeed")
    setup = {"source": SOURCE, "target": args.target, "seed": args.seed, "grid": args.grid, "range_m": args.range}
    path = args.results / f"PickCube-{args.target}.json"
    save(path, {"task": "PickCube", **setup, "ways": ways}, path.with_suffix(".png").name, seeds=[args.seed, args.seed])
    draw(path.with_suffix(".png"), ways)


if __name__ == "__main__":
    main()
