"""A picture of the end-effectors that ship, half closed, with their pads.

usage: CEI_GYM_PACKAGE_PATH=../shared/robots python benchmarks/pads.py [--results DIR]

Those whose description is not here are left out, and named. Writes pads.png.
"""

import argparse
from pathlib import Path

import numpy as np
from measure import say_of
from PIL import Image, ImageDraw

from cei_gym.embodiment import build_embodiment, end_effector_names, load_end_effector
from cei_gym.errors import CEIError
from cei_gym.functional.picture import HEIGHT, WIDTH, draw_representation
from cei_gym.functional.representation import sample_representation

COLUMNS, SHRUNK = 4, 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=Path(__file__).parents[1] / "results/robots")
    options = parser.parse_args()
    views: list[Image.Image] = []
    for name in end_effector_names():
        try:
            representation = sample_representation(build_embodiment(None, load_end_effector(name)))
        except CEIError as error:
            print(f"{name} is left out: {error}")
            continue
        hand = representation.embodiment
        picture = draw_representation(representation, (hand.home + hand.closed) / 2)[:, WIDTH : 2 * WIDTH]
        view = Image.fromarray(picture).resize((WIDTH // SHRUNK, HEIGHT // SHRUNK), Image.Resampling.LANCZOS)
        ImageDraw.Draw(view).text((8, 6), name, fill=(30, 30, 40), font_size=15)
        views.append(view)
    rows = -(-len(views) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * WIDTH // SHRUNK, rows * HEIGHT // SHRUNK), (236, 240, 245))
    for i, view in enumerate(views):
        sheet.paste(view, (i % COLUMNS * view.width, i // COLUMNS * view.height))
    options.results.mkdir(parents=True, exist_ok=True)
    sheet.save(options.results / "pads.png")
    say_of(options.results, ["pads.png"], seeds=(0, 0))
    print(f"Wrote {options.results / 'pads.png'}: {len(views)} end-effectors, {int(np.prod(sheet.size))} pixels.")


if __name__ == "__main__":
    main()
