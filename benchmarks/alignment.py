"""The alignment's speed and quality: ours beside the paper's way, mink and dex-retargeting, on recorded demonstrations.

usage: python benchmarks/alignment.py [--demonstrations 8] [--frames 24] [--pairs 128] [--lambda_m 0.05] [--results results/alignment]

All methods run in this one process, ours again before each of the others, on the same middle part of the same demonstrations
(development seeds 0 and up, recorded once to outputs/alignment-benchmark) and from the same first frames. Times are wall-clock milliseconds a
demonstration-frame. The paper's way solves all demonstrations as one batch; its learning rate is the best of three by mean
objective. Then: scaling to 400 demonstrations, the floor set by matching, and live use.

mink and dex-retargeting solve another problem, see others.py; they are left out where they are not installed
(`uv pip install --python .venv --group baselines --constraint requirements.lock`).
"""

import argparse
import csv
import json
import os
import resource
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from measure import STARTED, say_of
from numba import njit
from others import available

from cei_converters.cli import DatasetConfig, quiet_libraries
from cei_converters.dataset.provenance import versions
from cei_converters.record import RecordConfig, record
from cei_converters.sources.reader import DatasetReader
from cei_gym.alignment import (
    AlignmentProblem,
    InitialisationOptions,
    Motion,
    PaperOptions,
    SolverOptions,
    Stream,
    Track,
    make_solver,
)
from cei_gym.alignment.judge.report import make_report
from cei_gym.alignment.kernels import distance
from cei_gym.alignment.kernels.target import empty_pose, empty_source, load_source, make_target
from cei_gym.alignment.start.starts import find_basins
from cei_gym.embodiment import load_embodiment
from cei_gym.functional import directional_chamfer_distance, sample_representation
from cei_gym.kinematics import KinematicTree

SOURCE = "Panda-PandaGripper"
TARGETS = ("UR5e-FourierRight", "IIWA-Inspire", "Kinova3-FourierLeft", "Panda-RobotiqThreeFinger")
WORK = Path("outputs/alignment-benchmark")
LEARNING_RATES = (1e-3, 3e-3, 1e-2)
LONG_FRAMES = 105  # of the paper's table "time cost of transfer"
CORES = os.cpu_count() or 1


@dataclass(frozen=True)
class Row:
    """One method on one target: milliseconds a frame, and what they bought."""

    target: str
    method: str
    threads: int
    ms_per_frame: float
    objective_mean_m: float
    objective_p95_m: float
    pad_distance_mm: float
    normal_angle_deg: float
    joint_step_p95_rad: float
    joint_step_max_rad: float
    iterations: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", default=TARGETS)
    parser.add_argument("--demonstrations", type=int, default=8)
    parser.add_argument("--frames", type=int, default=24, help="of each demonstration, from its middle")
    parser.add_argument("--pairs", type=int, default=128, help="point-normal pairs of each representation")
    parser.add_argument("--lambda_m", type=float, default=0.05)
    parser.add_argument("--results", type=Path, default=Path("results/alignment"))
    parser.add_argument("--redraw", action="store_true", help="only draw the picture of the results there are")
    args = parser.parse_args()
    quiet_libraries()
    args.results.mkdir(parents=True, exist_ok=True)
    options = SolverOptions(lambda_m=args.lambda_m)
    name = f"speed_lambda_{args.lambda_m:g}"
    path = args.results / f"{name}.json"
    if args.redraw:
        draw(json.loads(path.read_text()), path.with_suffix(".png"))
        return
    result = {
        "command": f"python benchmarks/alignment.py --demonstrations {args.demonstrations} --frames {args.frames} --pairs {args.pairs} "
        f"--lambda_m {args.lambda_m:g}",
        "seeds": [0, args.demonstrations - 1],
        "commit": STARTED.commit,
        "versions": versions(["cei-gym", "numba", "numpy", "torch", "pytorch-kinematics", "mujoco", "mink"]),
        "cores": CORES,
        "methods": [],
        "scaling": [],
        "floor": [],
        "live": [],
    }
    say_of(args.results, [f"{name}.json", f"{name}.csv", f"{name}.png"], result["seeds"])
    whole = demonstrations(args.demonstrations)
    qpos = [q[max(0, (len(q) - args.frames) // 2) :][: args.frames] for q in whole]
    for target in args.targets:
        problem, motions = prepare(target, args.pairs, qpos, options)
        rows = compare(target, problem, motions, options)
        print_rows(rows)
        result["methods"] += [asdict(row) for row in rows]
        result["floor"].append(floor(target, problem, motions, options, rows[0]))
        result["live"].append(live(target, problem, motions, options))
        path.write_text(json.dumps(result, indent=1) + "\n")
    problem, motions = prepare("IIWA-Inspire", args.pairs, qpos, options)
    result["scaling"] = scale(problem, motions[0].u0, args.pairs, whole, options)
    path.write_text(json.dumps(result, indent=1) + "\n")
    with (args.results / f"{name}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(result["methods"][0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in result["methods"]
        )
    draw(result, args.results / f"{name}.png")


def demonstrations(count: int) -> list[np.ndarray]:
    """(T, n) joint positions of the Panda in each recorded demonstration."""
    root = WORK / f"source-{count}"
    if not root.exists():
        record(RecordConfig(f"CEI-PickCube-{SOURCE}", "cei/pick_cube_panda", str(root), count, 0))
    config = DatasetConfig("cei/pick_cube_panda", str(root))
    reader = DatasetReader(config.repo_id, config.root)
    return [reader.read(i, clouds=False).qpos for i in range(count)]


def place(pairs: int, qpos: Sequence[np.ndarray]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The source's points and normals (T, N, 3) of each demonstration; both bases coincide."""
    source = load_embodiment(SOURCE)
    representation, tree = sample_representation(source, pairs), KinematicTree(source)
    for q in qpos:
        yield representation.place(tree.forward(q))


def prepare(target: str, pairs: int, qpos: Sequence[np.ndarray], options: SolverOptions):
    """The problem, and the demonstrations as motions that start from one basin, solved at each one's own frame 0."""
    embodiment = load_embodiment(target)
    problem = AlignmentProblem(sample_representation(embodiment, pairs), KinematicTree(embodiment))
    placed = list(place(pairs, qpos))
    basin = find_basins(problem, options, placed[0][0][0], placed[0][1][0], InitialisationOptions())[0]
    solver = make_solver(problem, options)
    starts = [solver.track(p[:1], n[:1], basin, 200).u[0] for p, n in placed]
    return problem, [Motion(p, n, u0) for (p, n), u0 in zip(placed, starts, strict=True)]


def compare(target: str, problem: AlignmentProblem, motions: list[Motion], options: SolverOptions) -> list[Row]:
    """Every method on the same motions; ours, with one thread and with all, again before each of the others."""
    ours = make_solver(problem, options)
    moving = [replace(m, dt_s=0.05) for m in motions]
    own: dict[str, list] = {"ours": [], "ours, velocity limits": [], f"ours, {CORES} threads": []}
    rows = []

    def track(motion: Motion) -> Track:
        return ours.track(motion.points_base, motion.normals_base, motion.u0, dt_s=motion.dt_s)

    def run_ours() -> None:
        own["ours"].append(timed(lambda: [track(m) for m in motions]))
        own["ours, velocity limits"].append(timed(lambda: [track(m) for m in moving]))
        own[f"ours, {CORES} threads"].append(timed(lambda: ours.track_all(motions)))

    def row(method: str, threads: int, seconds: float, tracks: list[Track]) -> Row:
        return measure(target, method, threads, seconds, problem, motions, tracks, options.lambda_m)

    run_ours()  # compiles, and is dropped
    for times in own.values():
        times.clear()
    torch.set_num_threads(1)
    best = None
    for rate in LEARNING_RATES:
        run_ours()
        paper = make_solver(problem, replace(options, backend="paper", paper=PaperOptions(learning_rate=rate)))
        rows.append(row(f"paper, rate {rate:g}", 1, *timed(lambda paper=paper: paper.track_all(motions))))
        if best is None or rows[-1].objective_mean_m < best[0].objective_mean_m:
            best = rows[-1], paper
    assert best is not None
    run_ours()
    torch.set_num_threads(CORES)
    rows.append(row(best[0].method, CORES, *timed(lambda: best[1].track_all(motions))))
    torch.set_num_threads(1)
    batched = make_solver(problem, replace(options, backend="torch", device="cpu"))
    run_ours()
    rows.append(row("ours, torch backend", 1, *timed(lambda: batched.track_all(motions))))
    for name, function in available().items():
        run_ours()
        rows.append(row(name, 1, *others(function, problem, motions)))
    first = []
    for method, runs in own.items():
        seconds = float(np.median([s for s, _ in runs]))
        first.append(row(method, CORES if "threads" in method else 1, seconds, runs[0][1]))
    return first + rows


def others(function: Callable, problem: AlignmentProblem, motions: list[Motion]) -> tuple[float, list[Track]]:
    """A library that returns (T, m) joint positions a demonstration; what it sets up is not counted."""
    small = motions[0]
    function(problem, small.points_base[:2], small.normals_base[:2], small.u0)
    setup, _ = timed(lambda: function(problem, small.points_base[:1], small.normals_base[:1], small.u0))
    seconds, found = timed(lambda: [function(problem, m.points_base, m.normals_base, m.u0) for m in motions])
    nothing = [np.zeros(len(u)) for u in found]
    return max(seconds - setup * len(motions), 0.0), [Track(u, n, n) for u, n in zip(found, nothing, strict=True)]


def timed(function: Callable):
    start = time.perf_counter()
    value = function()
    return time.perf_counter() - start, value


def measure(
    target: str,
    method: str,
    threads: int,
    seconds: float,
    problem: AlignmentProblem,
    motions: list[Motion],
    tracks: list[Track],
    lambda_m: float,
) -> Row:
    """A row, its objective computed anew from the definition."""
    objective, distances, angles, steps, iterations = [], [], [], [], []
    for motion, track in zip(motions, tracks, strict=True):
        args = motion.points_base, motion.normals_base
        for t, u in enumerate(track.u):
            objective.append(directional_chamfer_distance(args[0][t], args[1][t], *problem.place(u), lambda_m))
        report = make_report(problem, *args, track, lambda_m, 30.0)
        distances.append(report.pad_distance_mm)
        angles.append(report.normal_angle_deg)
        steps.append(report.joint_step_rad[1:])
        iterations.append(track.iterations)
    step = np.concatenate(steps)
    return Row(
        target,
        method,
        threads,
        1e3 * seconds / len(objective),
        float(np.mean(objective)),
        float(np.quantile(objective, 0.95)),
        float(np.concatenate(distances).mean()),
        float(np.concatenate(angles).mean()),
        float(np.quantile(step, 0.95)),
        float(step.max()),
        float(np.concatenate(iterations).mean()),
    )


def print_rows(rows: list[Row]) -> None:
    reference = next((r for r in rows if r.method == "ours"), None)
    print(f"\n{rows[0].target}")
    print(f"{'method':28} {'ms/frame':>9} {'ratio':>7} {'objective':>10} {'p95':>9} {'pads mm':>8} {'deg':>5} ", end="")
    print(f"{'step p95':>8} {'max':>6} {'its':>6}")
    for r in rows:
        ratio = r.ms_per_frame / reference.ms_per_frame if reference else np.nan
        method = f"{r.method} ({r.threads} threads)" if r.threads > 1 and "threads" not in r.method else r.method
        print(
            f"{method:28} {r.ms_per_frame:9.3f} {ratio:7.1f} {r.objective_mean_m:10.6f} {r.objective_p95_m:9.6f} ",
            end="",
        )
        print(f"{r.pad_distance_mm:8.2f} {r.normal_angle_deg:5.1f} {r.joint_step_p95_rad:8.3f} ", end="")
        print(f"{r.joint_step_max_rad:6.3f} {r.iterations:6.1f}", flush=True)


def floor(target: str, problem: AlignmentProblem, motions: list[Motion], options: SolverOptions, ours: Row) -> dict:
    """How much of a frame is matching, and how much of that is the bare arithmetic of all pairs' costs."""
    arrays = make_target(problem.representation, problem.tree)
    n = len(problem.representation)
    source, pose = empty_source(n), empty_pose(arrays, n)
    load_source(motions[0].points_base[0], motions[0].normals_base[0], source)
    distance.evaluate(arrays, source, options.lambda_m, motions[0].u0, pose)

    def best_us(function: Callable, calls: int = 300) -> float:
        function(10)
        return 1e6 * min(timed(lambda: function(calls))[0] for _ in range(7)) / calls

    match_us = best_us(lambda calls: repeat_match(source, pose, np.float32(options.lambda_m), calls))
    bare_us = best_us(lambda calls: repeat_costs(source, pose, np.float32(options.lambda_m), calls))
    evaluations = ours.iterations + 1
    result = {
        "target": target,
        "evaluations_per_frame": evaluations,
        "match_us": match_us,
        "match_ns_per_pair": 1e3 * match_us / n**2,
        "bare_us": bare_us,
        "frame_us": 1e3 * ours.ms_per_frame,
        "matching_share": evaluations * match_us / (1e3 * ours.ms_per_frame),
        "times_the_floor": 1e3 * ours.ms_per_frame / (evaluations * bare_us),
    }
    print(
        f"floor: a matching of {n} x {n} takes {match_us:.1f} us ({result['match_ns_per_pair']:.2f} ns a pair), its bare "
        f"arithmetic {bare_us:.1f} us; {evaluations:.1f} evaluations a frame: matching is {result['matching_share']:.0%} of a "
        f"frame, and a frame {result['times_the_floor']:.1f} times its bare arithmetic"
    )
    return result


@njit
def repeat_match(source, pose, lambda_m, times):
    for _ in range(times):
        distance.match(source, pose, lambda_m)


@njit(fastmath=True)
def repeat_costs(source, pose, lambda_m, times):
    """The costs of all pairs, no minimum sought."""
    p, q = source.pairs32, pose.pairs32
    row = np.empty(q.shape[1], np.float32)
    for _ in range(times):
        for i in range(p.shape[1]):
            costs(p[0, i], p[1, i], p[2, i], lambda_m * p[3, i], lambda_m * p[4, i], lambda_m * p[5, i], q, row)


@njit(fastmath=True)
def costs(a, b, c, na, nb, nc, q, row):
    x, y, z, nx, ny, nz = q[0], q[1], q[2], q[3], q[4], q[5]
    for j in range(len(row)):
        dx, dy, dz = x[j] - a, y[j] - b, z[j] - c
        row[j] = np.sqrt(dx * dx + dy * dy + dz * dz) - (na * nx[j] + nb * ny[j] + nc * nz[j])


def live(target: str, problem: AlignmentProblem, motions: list[Motion], options: SolverOptions) -> dict:
    """Frame by frame, as they would come from a running robot."""
    times = []
    for motion in motions:
        stream = Stream(problem, options, u0=motion.u0, dt_s=0.05)
        for frame in zip(motion.points_base, motion.normals_base, strict=True):
            start = time.perf_counter()
            stream(*frame)
            times.append(time.perf_counter() - start)
    p50, p99 = np.quantile(times, [0.5, 0.99]) * 1e3
    result = {"target": target, "p50_ms": p50, "p99_ms": p99, "max_ms": 1e3 * max(times), "frames": len(times)}
    print(f"live: p50 {p50:.2f} ms, p99 {p99:.2f} ms, worst {result['max_ms']:.2f} ms of {len(times)} frames")
    return result


def scale(
    problem: AlignmentProblem, u0: np.ndarray, pairs: int, qpos: list[np.ndarray], options: SolverOptions
) -> list[dict]:
    """1 to 400 demonstrations of 105 frames, read in batches; the paper's table multiplies 25 demonstrations, too."""
    solver = make_solver(problem, options)
    long = [resample(q, LONG_FRAMES) for q in qpos]
    results = []
    print(
        f"\nscaling, {problem.embodiment.name}, {LONG_FRAMES} frames, {CORES} threads (the paper: 216 s for 400 on an RTX 4090)"
    )
    for count in (1, 25, 100, 400):
        start = time.perf_counter()
        objective = []
        for first in range(0, count, 25):
            batch = [long[i % len(long)] for i in range(first, min(first + 25, count))]
            motions = [Motion(p, n, u0, dt_s=0.05) for p, n in place(pairs, batch)]
            objective += [t.objective.mean() for t in solver.track_all(motions)]
        seconds = time.perf_counter() - start
        results.append(
            {
                "demonstrations": count,
                "seconds": seconds,
                "ms_per_frame": 1e3 * seconds / (count * LONG_FRAMES),
                "objective_mean_m": float(np.mean(objective)),
                "peak_memory_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            }
        )
        print(" ".join(f"{k} {v:.4g}" for k, v in results[-1].items()), flush=True)
    return results


def resample(qpos: np.ndarray, frames: int) -> np.ndarray:
    """(T, n) to (frames, n), linear in time."""
    at = np.linspace(0, len(qpos) - 1, frames)
    return np.stack([np.interp(at, np.arange(len(qpos)), column) for column in qpos.T], axis=1)


def label(row: dict) -> str:
    """A method's name in the picture; its best learning rate differs from target to target."""
    many = row["threads"] > 1 and row["method"].startswith("paper")
    return f"paper, best rate, {row['threads']} threads" if many else row["method"]


def draw(result: dict, path: Path) -> None:
    """Objective against time for each method; down and to the left is better."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    targets = list(dict.fromkeys(row["target"] for row in result["methods"]))
    figure, axes = plt.subplots(1, len(targets), figsize=(4 * len(targets), 4.4), sharex=True, squeeze=False)
    names = list(dict.fromkeys(label(row) for row in result["methods"]))
    for axis, target in zip(axes[0], targets, strict=True):
        for row in (r for r in result["methods"] if r["target"] == target):
            name = label(row)
            marker = "o" if name.startswith("ours") else "s" if name.startswith("paper") else "^"
            time_ms, objective_mm = row["ms_per_frame"], 1e3 * row["objective_mean_m"]
            axis.scatter(time_ms, objective_mm, color=f"C{names.index(name)}", marker=marker, s=60, label=name)
        axis.set(title=target, xscale="log", xlabel="ms a demonstration-frame")
        axis.grid(alpha=0.3, which="both")
    axes[0, 0].set_ylabel("mean Directional Chamfer Distance (mm)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=5, frameon=False, fontsize=9)
    figure.tight_layout(rect=(0, 0.12, 1, 1))
    figure.savefig(path, dpi=110)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
