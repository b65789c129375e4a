"""Run every command and every piece of code of the documents and examples, made small. `.ci/run` does, with the wheels installed.

Each document is run in a folder of its own, in which are the datasets that the README has made, as a reader has them. A block is run
as it stands, without being listed anywhere; what cannot run here is named below with the reason, which is printed.
`tests/test_documents.py` sees to it that nothing escapes: no block of another language, no exception or shortening that is out of date.

Usage: python documents.py CHECKOUT [DOCUMENT ...]   (not a pytest module; `make documents` runs it with what is installed in .venv)
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

SMALLER = [
    (r"--episodes=50\b", "--episodes=4"),  # docs/converting.md deletes the last of them
    (r"--augment\.grid=10,10", "--augment.grid=2,1"),
    (r"--batch_size=(128|64)\b", "--batch_size=4"),
    (r"--steps=100000", "--steps=2 --save_freq=2 --num_workers=0 --log_freq=1"),
    (r"--policy\.type=dp3", "--policy.type=dp3 --policy.size=small --policy.points=64 --policy.device=cpu"),
    (
        r"--policy\.type=act",
        "--policy.type=act --policy.device=cpu --policy.pretrained_backbone_weights=null",
    ),  # no network
    (r"--duration=5", "--duration=1"),
    (r"--eval\.n_episodes=20 --eval\.batch_size=2", "--eval.n_episodes=1 --eval.batch_size=1 --policy.device=cpu"),
    (r"--env\.type=cei", "--env.type=cei --env.episode_length=10"),
    (r"(direction_weight\.py)", r"\1 UR5e-RobotiqThreeFinger --demonstrations=1"),
    (r"(blind_control\.py)", r"\1 --episodes=2"),
    (r"(transfer\.py)", r"\1 --demonstrations 2"),
]
"""What makes a command, or a script, quick, by what stands in it."""

ELSEWHERE = {
    r"make (demo|setup|test)": "`.ci/run` runs it",
    r"source \.venv/bin/activate": "the environment is another here",
    r"pip install .*": "the wheels are installed",
    r"uv pip install .*": "optional: what a benchmark compares with",
    r"python benchmarks/(alignment|census|first_frame|image_policy|live_pictures|observation|pictures|camera_fit|score|start_up|twin)\.py.*": "minutes; tests/test_benchmarks.py runs it smaller",
    r"python benchmarks/camera\.py": "compares with MuJoCo's renderer, which needs a GL library",
    r"python benchmarks/scale\.py.*": "minutes however small; it records and converts by benchmarks/transfer.py, which is run",
    r"cei-robot show .*": "serves until it is ended; tests/test_robot_show.py opens it in a browser",
    r"CEI_GYM_PACKAGE_PATH=\S+ cei-benchmark replay --targets=XArm7.*": "half an hour; tests/test_benchmark_command.py runs it smaller",
    r"CEI_GYM_PACKAGE_PATH=\S+ cei-benchmark real( --stage=replay --films)?": "hours; tests/test_real_benchmark.py runs it smaller",
    r"CEI_GYM_PACKAGE_PATH=\S+ cei-benchmark (anchors|modes)( --stage=replay)?": "hours; tests/test_anchors_and_modes.py runs them smaller",
    r"CEI_GYM_PACKAGE_PATH=\S+ cei-benchmark replay --tasks=.*": "an hour; tests/test_benchmark_command.py runs it smaller",
    r"cei-record .* --seed=100 .*": "for what follows it; README.md records others",
    r"cei-(convert|replay) .*--dataset\.repo_id=(lab|me)/lift .*": "needs a file of robosuite's; tests/test_robosuite_tasks.py makes one",
    r"CEI_GYM_PACKAGE_PATH=\S+ cei-convert .*--target=XArm7-ShadowHand .*": "needs ../shared/robots; tests/test_target_pose_auto.py runs another",
    r"cei-calibrate .*--by=outlines .*": "needs ../shared; tests/test_outlines.py runs it",
    r"cei-(convert|view) .*--source\.root=data/g1 .*|cei-convert .*--dataset\.root=data/g1 .*": "needs ../shared; tests/test_outlines.py finds its camera",
    r"CEI_GYM_PACKAGE_PATH=\S+ python benchmarks/pads\.py": "needs ../shared/robots; a picture",
    r"cei-benchmark policy --tasks=\w+ --targets=\S+ --variants=.*": "an hour; tests/test_policy_benchmark.py runs it smaller",
    r"cei-benchmark replay --tasks=(Lift,|Door |PickCube,Pick-Can).*": "half an hour; tests/test_benchmark_command.py runs it smaller",
    r"cei-benchmark replay (--tables=main|--seed=1000 --results=\S+)": "an hour; tests/test_benchmark_command.py runs it smaller",
}
"""Commands that are not run here, as patterns, and why."""

BEFORE = {
    "policies/README.md": """
        import re, dill, torch
        from lerobot.configs import FeatureType, PolicyFeature
        from lerobot_policy_dp3 import DP3Config, DP3Policy
        sizes = {"observation.state": (24,), "observation.point_cloud": (512, 3)}
        config = DP3Config(device="cpu", size="simple", horizon=4, n_action_steps=3,
            input_features={key: PolicyFeature(FeatureType.STATE, shape) for key, shape in sizes.items()},
            output_features={"action": PolicyFeature(FeatureType.ACTION, (26,))})
        names = [(r"^unet\\.", "model."), (r"\\.conv1\\.", ".blocks.0."), (r"\\.conv2\\.", ".blocks.1."),
            (r"^(model\\.(?:down|up)_modules\\.[0-9]+)\\.2\\.", r"\\1.1.conv.")]
        original = {}
        for name, weight in DP3Policy(config).model.state_dict().items():
            for pattern, text in names:
                name = re.sub(pattern, text, name)
            original[name] = weight
        for key, size in {"agent_pos": 24, "action": 26, "point_cloud": 3}.items():
            original[f"normalizer.params_dict.{key}.scale"] = torch.ones(size)
            original[f"normalizer.params_dict.{key}.offset"] = torch.zeros(size)
        torch.save({"state_dicts": {"ema_model": original}}, "latest.ckpt", pickle_module=dill)
        """,
}
"""What a document's Python takes as given."""

EXAMPLES = {
    "03_record_convert_replay.sh": ["out"],
    "07_train_and_evaluate.sh": ["out", "2", "2", "1"],
    "08_humanoid_to_arm.sh": ["{shared}/datasets/gr1_pick_n_place_v2.0"],
    "09_real_clouds.sh": ["{shared}/datasets/demogen_egg.zarr"],
    "11_policy_on_a_robot.sh": ["out", "2", "2", "1"],
    "10_so101_to_panda.sh": ["{shared}/datasets/so101_pick_v3.0", "{shared}/robots/so101"],
}
"""Shell scripts, and what they are given. The examples in Python are run by tests/test_examples.py."""

SHELL, PYTHON = ("bash", "sh", "shell", "console"), ("python",)
"""Languages of blocks that are run."""

NOT_OURS = ("build", "dist", "outputs", "data", "node_modules")
"""Folders of a checkout whose documents are not the project's."""

LIMIT_S = 600
"""No command takes longer."""


@dataclass(frozen=True)
class Block:
    """What a document has between fences.

    Attributes:
        document: its path in the checkout.
        language: what stands behind the fence, or nothing.
        text: the lines between, not indented.
    """

    document: str
    language: str
    text: str

    def commands(self) -> list[str]:
        """Those of a shell block, each on one line, without comments and prompts."""
        lines = [re.sub(r"(^|\s+)#.*$", "", line) for line in re.sub(r"\\\n\s*", " ", self.text).splitlines()]
        if self.language == "console":
            lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        return [line.strip() for line in lines if line.strip()]

    def file(self) -> str | None:
        """Where a YAML block belongs, as its first line says: `# robots/arms/Mine.yaml`; None if it does not."""
        found = re.match(r"# (\w[\w/]*\.ya?ml)\n", self.text)
        return found[1] if found and self.language == "yaml" else None


def documents(checkout: Path) -> list[str]:
    """All of them, the README first: it makes what the others start from."""
    folders = [p for p in checkout.iterdir() if p.is_dir() and p.name not in NOT_OURS and p.name[0] != "."]
    folders.append(checkout / ".github")
    found = {*checkout.glob("*.md"), *(path for folder in folders for path in folder.rglob("*.md"))}
    return sorted((p.relative_to(checkout).as_posix() for p in found), key=lambda name: (name != "README.md", name))


def blocks(checkout: Path, document: str) -> list[Block]:
    """All of a document, in whatever language."""
    fenced = r"^ *(```+|~~~+) *([^\s`]*)[^\n`]*\n(.*?)^ *\1[ ]*$"
    found = re.findall(fenced, (checkout / document).read_text(), re.DOTALL | re.MULTILINE)
    return [Block(document, language, textwrap.dedent(text)) for _, language, text in found]


def left_out(command: str) -> str | None:
    """Why a command is not run here; None if it is."""
    return next((why for pattern, why in ELSEWHERE.items() if re.fullmatch(pattern, command)), None)


def smaller(command: str) -> str:
    """The same, quick."""
    for pattern, text in SMALLER:
        command = re.sub(pattern, text, command)
    return command


def made_by(command: str) -> list[str]:
    """Files and folders that a command makes; not those that it changes in place."""
    made = re.findall(r"--(?:new_root|new_policy|output_dir|save_map|output|sheet|rrd|video|json)=(\S+)", command)
    return [path for path in made if path not in re.findall(r"(?:--|\.)root=(\S+)", command)]


class Runner:
    """Runs documents and examples.

    Args:
        checkout: of the project, whose documents are read.
        work: folder to run them in.
    """

    def __init__(self, checkout: Path, work: Path) -> None:
        self.checkout, self.work, self.home = checkout, work, work / "home"
        self.ran: list[str] = []
        self.not_run: list[str] = []
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        offline = {"HF_HUB_OFFLINE": "1", "HF_LEROBOT_HOME": str(self.home), "OMP_NUM_THREADS": "1"}
        self.environment = os.environ | {"PATH": path} | offline
        self.environment.pop("PYTHONDONTWRITEBYTECODE", None)  # importing everything anew takes 14 s a process

    def run(self, document: str) -> None:
        """Run a document, in its order; what the README has run before it is there.

        Raises:
            SystemExit: what it says does not work.
        """
        found = blocks(self.checkout, document)
        first = {command for block in self._of_readme(document) for command in block.commands()}
        folder = self.work / document.replace("/", "_").removesuffix(".md")
        folder.mkdir()
        shell = [command for block in found if block.language in SHELL for command in block.commands()]
        if document != "README.md" and (shell or any(block.language in PYTHON for block in found)):
            self._provide(folder, [path for command in shell if command not in first for path in made_by(command)])
        for block in found:
            if (path := block.file()) is not None:
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                (folder / path).write_text(block.text)
            elif block.language in PYTHON:
                before = textwrap.dedent(BEFORE.get(document, ""))
                self._call([sys.executable, "-c", f"{before}\n{block.text}"], folder, f"{document}: Python")
            elif block.language in SHELL:
                for command in block.commands():
                    why = "README.md has run it" if command in first else left_out(command)
                    if why is not None:
                        self.not_run.append(f"{document}: {command[:70]} ({why})")
                        continue
                    self._call(["bash", "-c", smaller(command)], folder, f"{document}: {command[:90]}")
                    for path in made_by(smaller(command)):
                        if not (folder / path).exists():
                            raise SystemExit(f"{document}: {command}\nmakes no {path}")

    def run_example(self, script: str) -> None:
        """Run one of the shell scripts among the examples.

        Raises:
            SystemExit: it does not work.
        """
        shared = self.checkout.parent / "shared"
        arguments = [argument.format(shared=shared) for argument in EXAMPLES[script]]
        if str(shared) in arguments[0] and not Path(arguments[0]).exists():
            self.not_run.append(f"examples/{script} (needs ../shared)")
            return
        folder = self.work / script
        copied = shutil.copytree(self.checkout / "examples", folder / "examples") / script
        copied.write_text(smaller(copied.read_text()))
        self._call(["bash", str(copied), *arguments], folder, f"examples/{script}")

    def tasks(self, wanted: list[str]) -> Iterator[Callable[[], None]]:
        """What is to run when the README has: documents and examples, which do not depend on each other; the longest first."""
        for script in EXAMPLES if not wanted else ():
            yield partial(self.run_example, script)
        for document in documents(self.checkout)[1:]:
            if not wanted or document in wanted:
                yield partial(self.run, document)

    def provide_home(self) -> None:
        """Put what the README has made into LeRobot's cache, once as a stranger's."""
        for name, origin in (("lab/real", "pick_panda"), ("me/picked", "pick_iiwa")):
            shutil.copytree(self.work / "README/data" / origin, self.home / name)
        self._estrange(self.home / "lab/real")

    def _estrange(self, root: Path) -> None:
        """Make a dataset one that knows nothing of ours: joints and actions alone, by a lab's names."""
        import pyarrow.parquet as pq

        for path in (root / "meta").glob("cei*"):
            path.unlink()
        info = json.loads((root / "meta/info.json").read_text())
        ours = ("observation.depth", "observation.point_cloud", "privileged.")
        ours = [key for key in info["features"] if key.startswith(ours)]
        info["features"] = {key: feature for key, feature in info["features"].items() if key not in ours}
        info["robot_type"] = "panda"
        for key in ("observation.state", "action"):
            del info["features"][key]["info"]
            names = info["features"][key]["names"]
            info["features"][key]["names"] = [f"panda_{name.partition('.')[0]}" for name in names]
        (root / "meta/info.json").write_text(json.dumps(info))
        for path in root.glob("data/*/*.parquet"):
            table = pq.read_table(path).drop_columns(ours)
            pq.write_table(table.replace_schema_metadata(), path)

    def _of_readme(self, document: str) -> list[Block]:
        return [] if document == "README.md" else [b for b in blocks(self.checkout, "README.md") if b.language in SHELL]

    def _provide(self, folder: Path, made: list[str]) -> None:
        """Copy what the README has left, but for what the document makes itself; and put the checkout's benchmarks and results there."""
        for given in ("benchmarks", "examples"):
            (folder / given).symlink_to(self.checkout / given)
        shutil.copytree(self.checkout / "results", folder / "results")
        own = {(self.work / "README" / each).resolve() for each in made}
        shutil.copytree(
            self.work / "README",
            folder,
            ignore=lambda inside, names: [name for name in names if (Path(inside) / name).resolve() in own],
            dirs_exist_ok=True,
        )

    def _call(self, command: list[str], folder: Path, what: str) -> None:
        start = time.monotonic()
        options = {"cwd": folder, "env": self.environment, "capture_output": True, "text": True, "check": False}
        done = subprocess.run(command, stdin=subprocess.DEVNULL, timeout=LIMIT_S, **options)
        print(f"{time.monotonic() - start:6.1f} s  {what}", flush=True)
        self.ran.append(what)
        if done.returncode != 0:
            raise SystemExit(f"{what}\nexits with {done.returncode}:\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")


def main() -> None:
    checkout, wanted, start = Path(sys.argv[1]).resolve(), sys.argv[2:], time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        runner = Runner(checkout, Path(folder).resolve())
        runner.run("README.md")
        runner.provide_home()
        with ThreadPoolExecutor(2) as pool:
            running = [pool.submit(task) for task in runner.tasks(wanted)]
            try:
                for each in running:
                    each.result()
            except SystemExit:
                pool.shutdown(cancel_futures=True)
                raise
    print(f"{len(runner.ran)} commands and pieces of code run in {time.monotonic() - start:.0f} s; not run here:")
    for each in runner.not_run:
        print(f"  {each}")


if __name__ == "__main__":
    main()
