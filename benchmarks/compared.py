"""What both benchmarks of painted pictures share: robots, tasks and sizes, and how far two pictures are apart."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from cei_gym.arrays import Array

SOURCE = "Panda-PandaGripper"
TASKS = "PickCube,StackCube,OpenDrawer"
TARGETS = "UR5e-FourierRight,IIWA-Inspire,Kinova3-FourierLeft,Panda-RobotiqThreeFinger"
WIDTH = 320
OFF, LAST_SEED, SHOWN = 10, 999, 6
AWAY_M = 5.0


def arguments(description: str | None, seeds: str) -> argparse.ArgumentParser:
    """What both are asked for."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", default=TASKS)
    parser.add_argument("--targets", default=TARGETS)
    parser.add_argument("--seeds", default=seeds)
    parser.add_argument("--results", type=Path)
    return parser


def parsed(parser: argparse.ArgumentParser) -> tuple[argparse.Namespace, list[int]]:
    """What was said, and the seeds, which are those of development."""
    args = parser.parse_args()
    seeds = [int(seed) for seed in args.seeds.split(",")]
    if max(seeds) > LAST_SEED:
        parser.error(f"seeds are those of development, up to {LAST_SEED}")
    return args, seeds


def size(width: int) -> dict[str, Any]:
    return {"image_width": width, "image_height": 3 * width // 4}


def similarity(one: Array, other: Array) -> float:
    """SSIM (Wang et al., 2004) of grey pictures, with a Gaussian window of 1.5 pixels."""
    a, b = (picture.mean(axis=-1) for picture in (one, other))

    def blur(image: Array) -> Array:
        return ndimage.gaussian_filter(image, 1.5)

    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b, both = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2, blur(a * b) - mean_a * mean_b
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    structure = (2 * mean_a * mean_b + c1) * (2 * both + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    return float(structure.mean())


def decibels(one: Array, other: Array) -> float:
    return float(10 * np.log10(255**2 / max(np.mean((one.astype(float) - other) ** 2), 1e-9)))
