"""`cei-benchmark`: a benchmark by its name."""

from cei_converters.cli.subcommands import Subcommand, dispatch

BENCHMARKS = {
    "anchors": Subcommand(
        "cei_converters.benchmark.anchors", "how often one demonstration succeeds all over the table, made a thousand"
    ),
    "modes": Subcommand(
        "cei_converters.benchmark.modes", "how often two motions of a hand succeed, from the same demonstrations"
    ),
    "policy": Subcommand("cei_converters.benchmark.policy", "how often policies trained on them succeed"),
    "real": Subcommand(
        "cei_converters.benchmark.real",
        "the same between a gripper and a hand, beside the paper's table of real robots",
    ),
    "replay": Subcommand(
        "cei_converters.benchmark.replay",
        "how often transferred demonstrations succeed, beside the paper's figures",
    ),
    "results": Subcommand(
        "cei_converters.benchmark.listing",
        "nothing: which figures are older than the code that they measure",
    ),
}
"""By name, and what each measures."""


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-benchmark`."""
    return dispatch("cei-benchmark", BENCHMARKS, args, "benchmark")


if __name__ == "__main__":
    from cei_converters import start

    raise SystemExit(start.benchmark())
