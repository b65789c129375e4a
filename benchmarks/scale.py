"""How a conversion's time and memory grow with the dataset: 100, 1,000 and 10,000 demonstrations of 105 frames.

usage: python benchmarks/scale.py [--target IIWA-Inspire] [--demonstrations 100 1000 10000] [--work DIR] [--results DIR]
       python benchmarks/scale.py --workers 400

The demonstrations are those of `transfer.py`, repeated; 10,000 of them are a million frames, and need 40 GB of disk and 45 minutes.
Each number is converted in a process of its own. Between two numbers, the slope: seconds and kilobytes that one more demonstration
takes. Writes scale.json. With `--workers`, so many are converted by one worker and by two instead, in turn: workers.json.
"""

import argparse
import os
import shutil
import tempfile
from itertools import pairwise
from pathlib import Path

from measure import save
from tqdm import tqdm
from transfer import FRAMES, SOURCE, convert, record

from cei_converters.dataset.columns import encode
from cei_converters.dataset.encoded import encode_episode
from cei_converters.dataset.writer import DatasetWriter, Header
from cei_gym.demonstration import Demonstration


def write(root: Path, demonstrations: list[Demonstration], count: int) -> None:
    """A dataset of repetitions, each encoded once."""
    headers = [Header.of(d) for d in demonstrations]
    encoded = [encode_episode(encode(d), h.features, d.task) for d, h in zip(demonstrations, headers, strict=True)]
    with DatasetWriter("benchmark/source", root) as writer:
        for i in tqdm(range(count), "writing the source dataset"):
            writer.append(headers[i % len(headers)], encoded[i % len(encoded)])


def converted(root: Path, target: str, count: int, workers: int) -> dict:
    """A conversion, its dataset not kept."""
    row = {"workers": workers, **convert(root, target, count, f"--workers={workers}")}
    del row["paper_s"]
    row["frames_a_second"] = round(count * FRAMES / row["whole_s"])
    shutil.rmtree(root.with_name(f"converted_{count}"))
    print("  ".join(f"{name} {value}" for name, value in row.items()), flush=True)
    return row


def slope(fewer: dict, more: dict) -> dict:
    """What one more demonstration takes, between two conversions."""
    n = more["demonstrations"] - fewer["demonstrations"]
    return {
        "from": fewer["demonstrations"],
        "to": more["demonstrations"],
        "ms_a_demonstration": round(1e3 * (more["whole_s"] - fewer["whole_s"]) / n, 1),
        "memory_kb_a_demonstration": round(1024 * (more["peak_memory_mb"] - fewer["peak_memory_mb"]) / n, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--target", default="IIWA-Inspire")
    parser.add_argument("--demonstrations", type=int, nargs="+", default=[100, 1000, 10000])
    parser.add_argument("--workers", type=int, help="compare one worker with two, on so many demonstrations")
    parser.add_argument("--work", type=Path, help="folder for datasets; default: a temporary one")
    parser.add_argument("--results", type=Path, default=Path("results/transfer"))
    args = parser.parse_args()
    jobs = [(args.workers, n) for n in (1, 2, 1, 2)] if args.workers else [(n, 2) for n in sorted(args.demonstrations)]
    with tempfile.TemporaryDirectory(dir=args.work) as folder:
        root = Path(folder) / "source"
        most = max(count for count, _ in jobs)
        write(root, record(range(min(10, most))), most)
        rows = [converted(root, args.target, count, workers) for count, workers in jobs]
    result = {"source": SOURCE, "target": args.target, "frames": FRAMES, "cores": os.cpu_count(), "conversions": rows}
    seeds = [0, min(10, most) - 1]
    if args.workers:
        save(args.results / "workers.json", result, seeds=seeds)
        return
    slopes = [slope(fewer, more) for fewer, more in pairwise(rows)]
    for row in slopes:
        print("  ".join(f"{name} {value}" for name, value in row.items()))
    save(args.results / "scale.json", result | {"slopes": slopes}, seeds=seeds)


if __name__ == "__main__":
    main()
