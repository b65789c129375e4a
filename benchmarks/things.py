"""A picture of the things that there are to pick up: of each a film strip of one replay that succeeds, and of one that fails, where some do.

usage: python benchmarks/things.py [--things Sphere,Nut] [--targets UR5e-FourierRight,IIWA-Inspire] [--seeds 5] [--results FOLDER]

Demonstrations of the Panda's gripper, of development seeds from 0, go to one target after the other, as `cei-convert` would have them without
`--refine`, until one of either kind is found. Writes things.json, which says which they are, and things.png.
"""

import argparse
from pathlib import Path

from measure import save
from PIL import Image, ImageDraw
from tqdm import tqdm

from cei_converters.simulation.environment import open_environment
from cei_converters.simulation.rollout import record_episode
from cei_converters.simulation.stage import Stage
from cei_converters.simulation.video import contact_sheet
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer

SOURCE = "Panda-PandaGripper"
THINGS = "Sphere,Mug,ThinBox,Can,Cylinder,Lemon,LyingCylinder,Plate,Nut,Hammer"
TARGETS = "UR5e-FourierRight,Panda-RobotiqThreeFinger,IIWA-Inspire"
MOMENTS, HEIGHT_PX, LABEL_PX, GAP_PX = 4, 150, 110, 12

type Strip = tuple[str, Array]
"""Of which replay, in words, and its film strip, (H, W, 3) uint8."""


def recorded(thing: str, seeds: range) -> list[Demonstration]:
    env = open_environment(f"CEI-Pick-{thing}-{SOURCE}")
    found = [record_episode(env, seed, seed) for seed in seeds]
    env.close()
    return [demonstration for demonstration, info, _ in found if info["is_success"]]


def strips(thing: str, targets: list[str], seeds: range) -> dict[bool, Strip]:
    """A replay that succeeds, and one that fails, as far as there are any."""
    found: dict[bool, Strip] = {}
    demonstrations = recorded(thing, seeds)
    for target in targets:
        transfer = Transfer(load_embodiment(SOURCE), load_embodiment(target))
        transfer.fit(demonstrations)
        with Stage(f"CEI-Pick-{thing}-{target}") as stage:
            for demonstration in demonstrations:
                moved, _ = transfer.made(transfer.aligned(demonstration), clouds=False)
                result, _ = stage.play(moved)
                if result["success"] not in found:
                    _, film = stage.play(moved, filmed=True)
                    how = "succeeds" if result["success"] else result["failure"]
                    named = f"{target}, seed {demonstration.index}: {how}"
                    found[result["success"]] = named, contact_sheet([film], [named], MOMENTS)
                if len(found) == 2:
                    return found
    return found


def sheet(rows: dict[str, dict[bool, Strip]]) -> Image.Image:
    """One row a thing: its name, what succeeds, what fails."""
    first = next(strip for row in rows.values() for _, strip in row.values())
    width = round(first.shape[1] * HEIGHT_PX / first.shape[0])
    size = (LABEL_PX + 2 * (width + GAP_PX), len(rows) * (HEIGHT_PX + GAP_PX))
    picture = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(picture)
    for i, (thing, row) in enumerate(rows.items()):
        y = i * (HEIGHT_PX + GAP_PX)
        draw.text((4, y + HEIGHT_PX // 2), thing, fill=(20, 20, 20), font_size=15)
        for column, success in enumerate((True, False)):
            x = LABEL_PX + column * (width + GAP_PX)
            if success in row:
                picture.paste(Image.fromarray(row[success][1]).resize((width, HEIGHT_PX)), (x, y))
            else:
                none = f"none {'succeeds' if success else 'fails'} here"
                draw.text((x + width // 2 - 50, y + HEIGHT_PX // 2), none, fill=(120, 120, 120), font_size=15)
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--things", default=THINGS)
    parser.add_argument("--targets", default=TARGETS)
    parser.add_argument("--seeds", type=int, default=5, help="how many demonstrations of each, from 0")
    parser.add_argument("--results", type=Path, default=Path("results/things"))
    args = parser.parse_args()
    seeds = range(args.seeds)
    rows = {thing: strips(thing, args.targets.split(","), seeds) for thing in tqdm(args.things.split(","), "things")}
    args.results.mkdir(parents=True, exist_ok=True)
    sheet(rows).save(args.results / "things.png")
    shown = {
        thing: {"succeeds" if success else "fails": named for success, (named, _) in sorted(row.items(), reverse=True)}
        for thing, row in rows.items()
    }
    save(args.results / "things.json", {"seeds": [0, seeds[-1]], "shown": shown}, "things.png")


if __name__ == "__main__":
    main()
