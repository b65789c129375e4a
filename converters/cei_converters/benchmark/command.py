"""`cei-benchmark`: a benchmark by its name."""

import sys

from cei_converters.benchmark import listing, policy, replay
from cei_converters.cli.command_line import EXIT_OK, EXIT_USAGE
from cei_gym.errors import unknown

BENCHMARKS = {
    "policy": (policy.main, "how often policies trained on them succeed"),
    "replay": (replay.main, "how often transferred demonstrations succeed, beside the paper's figures"),
    "results": (listing.main, "nothing: which figures are older than the code that they measure"),
}
"""Name to entry point, and what it measures."""


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-benchmark`."""
    name, *options = (sys.argv[1:] if args is None else args) or ["--help"]
    if name in ("-h", "--help"):
        print("usage: cei-benchmark NAME --option=value ...\n")
        for benchmark, (_, what) in BENCHMARKS.items():
            print(f"  {benchmark}  {what}; see cei-benchmark {benchmark} --help")
        return EXIT_OK
    if name not in BENCHMARKS:
        print(f"error: {unknown('benchmark', name, BENCHMARKS)}", file=sys.stderr)
        return EXIT_USAGE
    return BENCHMARKS[name][0](options)


if __name__ == "__main__":
    from cei_converters import start

    raise SystemExit(start.benchmark())
