"""Run every command and every piece of code of the documents and examples, made small. `.ci/run` does, with the wheels installed.

Each document is run in a folder of its own, in which are the datasets that the README has made, as a reader has them. What cannot run
here is named with the reason; anything else that a document says is run as it stands, so that a new block is run without being listed.

Usage: python documents.py CHECKOUT [DOCUMENT ...]   (not a pytest module)
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

SMALLER = [
    (r"--episodes=50\b", "--episodes=2"),
    (r"--augment\.grid=10,10", "--augment.grid=2,1"),
    (r"--batch_size=128", "--batch_size=4"),
    (r"--steps=100000", "--steps=2 --save_freq=2 --num_workers=0 --log_freq=1"),
    (r"--policy\.type=dp3", "--policy.type=dp3 --policy.size=small --policy.points=64 --policy.device=cpu"),
    (r"--eval\.n_episodes=20(\s+\\\n\s*)?( --eval\.batch_size=2)?", "--eval.n_episodes=1 --eval.batch_size=1"),
    (r"--env\.type=cei", "--env.type=cei --env.episode_length=10 --policy.device=cpu"),
]
"""What makes a command quick, by what stands in it."""

ELSEWHERE = {
    "make demo": "`.ci/run` runs it",
    "make test": "`.ci/run` runs it",
    "make setup": "`.ci/run` runs it",
    "source .venv/bin/activate": "the environment is another here",
    "pip install": "the wheels are installed",
    "python benchmarks/": "hours; tests/test_benchmarks.py runs each of them smaller",
    "cei-benchmark replay": "an hour; tests/test_benchmark_command.py runs it smaller",
    "cei-benchmark policy": "hours; tests/test_policy_benchmark.py runs it smaller",
}
"""Commands that are not run here, by how they begin, and why."""

BEFORE = {
    "README.md": """
        from cei_converters.sources.formats import open_source
        demonstration = open_source("me/pick_panda", "data/pick_panda").read(0)
        """,
    "policies/README.md": """
        import torch
        from lerobot.configs import FeatureType, PolicyFeature
        from lerobot_policy_dp3 import DP3Config, DP3Policy
        config = DP3Config(
            device="cpu",
            size="small",
            input_features={
                "observation.state": PolicyFeature(FeatureType.STATE, (9,)),
                "observation.point_cloud": PolicyFeature(FeatureType.STATE, (64, 3)),
            },
            output_features={"action": PolicyFeature(FeatureType.ACTION, (9,))},
        )
        policy = DP3Policy(config)
        checkpoint = {"state_dicts": {"ema_model": {}}}
        """,
}
"""What a document's Python takes as given."""

EXAMPLES = {
    "03_record_convert_replay.sh": ["out"],
    "07_train_and_evaluate.sh": ["out", "2", "2", "1"],
    "08_humanoid_to_arm.sh": ["{shared}/datasets/gr1_pick_n_place_v2.0"],
    "09_real_clouds.sh": ["{shared}/datasets/demogen_egg.zarr"],
}
"""Shell scripts, and what they are given. The examples in Python are run by tests/test_examples.py."""


@dataclass(frozen=True)
class Block:
    """A piece of a document."""

    document: str
    language: str
    text: str


def blocks(path: Path, name: str) -> list[Block]:
    """What a document has between fences that can be run."""
    found = re.findall(r"^```(\w+)\n(.*?)^```", path.read_text(), re.DOTALL | re.MULTILINE)
    return [Block(name, language, text) for language, text in found if language in ("bash", "sh", "python")]


def commands(text: str) -> list[str]:
    """Those of a shell block, each on one line, without comments."""
    lines = [re.sub(r"(^|\s+)#.*$", "", line) for line in re.sub(r"\\\n\s*", " ", text).splitlines()]
    return [line.strip() for line in lines if line.strip()]


def smaller(command: str) -> str:
    """The same, quick."""
    for pattern, text in SMALLER:
        command = re.sub(pattern, text, command)
    return command


def made_by(shell: list[str]) -> set[str]:
    """Folders and files that commands make, which must therefore not be there before."""
    options = r"--(?:root|new_root|output_dir|save_map|output|sheet|rrd|video)=(\S+)"
    return {path for command in shell for path in re.findall(options, command)}


class Runner:
    """Runs documents one after the other.

    Args:
        checkout: of the project, whose documents are read.
        work: folder to run them in.
    """

    def __init__(self, checkout: Path, work: Path) -> None:
        self.checkout, self.work, self.home = checkout, work, work / "home"
        self.ran, self.left_out = 0, []
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        offline = {"HF_HUB_OFFLINE": "1", "HF_LEROBOT_HOME": str(self.home)}
        self.environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"PATH": path, **offline}

    def documents(self) -> list[str]:
        """All of them, the README first: it makes what the others start from."""
        folders = (".", "docs", "envs", "policies", "results", "results/*", "examples")
        found = {p.relative_to(self.checkout).as_posix() for f in folders for p in self.checkout.glob(f"{f}/*.md")}
        return sorted(found, key=lambda name: (name != "README.md", name))

    def run(self, name: str) -> None:
        """Run a document."""
        found = blocks(self.checkout / name, name)
        shell = [command for block in found if block.language != "python" for command in commands(block.text)]
        folder = self.work / name.replace("/", "_").removesuffix(".md")
        folder.mkdir()
        if name != "README.md":
            self._provide(folder, made_by(shell))
        for block in found:
            if block.language == "python":
                before = "\n".join(line.removeprefix(" " * 8) for line in BEFORE.get(name, "").splitlines())
                self._call([sys.executable, "-c", f"{before}\n{block.text}"], folder, f"{name}: Python")
                continue
            for command in commands(block.text):
                reason = next((why for start, why in ELSEWHERE.items() if command.startswith(start)), None)
                reason = reason or ("it is optional" if command.startswith("uv ") else None)
                if reason is not None:
                    self.left_out.append(f"{name}: {command[:70]} ({reason})")
                    continue
                self._call(["bash", "-c", smaller(command)], folder, f"{name}: {command[:90]}")

    def run_examples(self) -> None:
        """Run the shell scripts among the examples."""
        shared = self.checkout.parent / "shared"
        scripts = sorted(path.name for path in (self.checkout / "examples").glob("*.sh"))
        assert scripts == sorted(EXAMPLES), f"examples/ has {scripts}; say in EXAMPLES what each is given"
        for script, arguments in EXAMPLES.items():
            if any("{shared}" in a for a in arguments) and not shared.is_dir():
                self.left_out.append(f"examples/{script} (needs ../shared/datasets)")
                continue
            folder = self.work / script
            folder.mkdir()
            given = [argument.format(shared=shared) for argument in arguments]
            self._call(["bash", str(self.checkout / "examples" / script), *given], folder, f"examples/{script}")

    def _provide(self, folder: Path, made: set[str]) -> None:
        """What the README has left, but for what the document makes itself; and a stranger's dataset in LeRobot's cache."""
        for path in (self.work / "README").rglob("*"):
            to = folder / path.relative_to(self.work / "README")
            inside = any(to.is_relative_to(folder / each) for each in made)
            if path.is_file() and not inside:
                to.parent.mkdir(parents=True, exist_ok=True)
                os.link(path, to)
        for name, origin in (("lab/real", "pick_panda"), ("me/picked", "pick_iiwa")):
            if not (self.home / name).exists():
                shutil.copytree(self.work / "README/data" / origin, self.home / name)
                (self.home / name / "meta/cei.json").unlink()

    def _call(self, command: list[str], folder: Path, what: str) -> None:
        start = time.monotonic()
        done = subprocess.run(command, cwd=folder, env=self.environment, capture_output=True, text=True, check=False)
        print(f"{time.monotonic() - start:6.1f} s  {what}", flush=True)
        self.ran += 1
        if done.returncode != 0:
            raise SystemExit(f"{what}\nexits with {done.returncode}:\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")


def main() -> None:
    checkout = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        runner = Runner(checkout, Path(folder))
        wanted = sys.argv[2:]
        for name in runner.documents():
            if not wanted or name == "README.md" or name in wanted:
                runner.run(name)
        if not wanted:
            runner.run_examples()
        print(f"{runner.ran} commands and pieces of code run; not run here:")
        for each in runner.left_out:
            print(f"  {each}")


if __name__ == "__main__":
    main()
