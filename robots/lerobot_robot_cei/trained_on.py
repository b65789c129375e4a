"""What a policy was trained on, as far as a robot must fit it: joints, where demonstrations start, cameras, clouds, rate."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import draccus
import numpy as np
from draccus.utils import DraccusException

from cei_converters.dataset import schema
from cei_converters.dataset.essentials import KEY, Remains, essentials, find_essentials
from cei_converters.dataset.locate import INFO_PATH, read_info
from cei_converters.dataset.metadata import Metadata, plain
from cei_converters.dataset.opening import find_metadata
from cei_converters.dataset.starts import find_starts
from cei_converters.dataset.step_time import StepTime
from cei_converters.sources.calibration import Calibration
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment, load_embodiment
from cei_gym.errors import CEIError, one_line
from cei_gym.pointcloud import CloudOptions
from cei_gym.untrusted import load_json

STEP = "cei_clouds"
"""What the step is called in a checkpoint."""
PICTURES_STEP = "cei_pictures"
"""What the step that paints pictures is called there."""
STEPS_PATH = "policy_preprocessor.json"
"""Where a checkpoint has its steps."""
_M_PER_RAD = 0.1  # a gripper's fingers go 4 cm in all
_STEP_TIME = "step_time_s"
"""Not in checkpoints of before it was known."""
_FIELDS = ("joint_names", "starts", "fps", "cloud_shape", KEY)


@dataclass(frozen=True)
class TrainedOn:
    """The data behind a policy.

    Attributes:
        metadata: whose demonstrations they are, base, cameras and workspace, options of clouds, how long steps took.
        joint_names: n entries of `observation.state`, `<joint>.pos_rad` or `.pos_m`, in their order.
        starts: (k, n) where demonstrations start, the middle of each of k motions, rad or m.
        fps: frames a second.
        cloud_shape: of `observation.point_cloud`, (N, 3 or 6); None where there is none.
    """

    metadata: Metadata
    joint_names: tuple[str, ...]
    starts: Array
    fps: float
    cloud_shape: tuple[int, int] | None = None

    @classmethod
    def of_dataset(cls, root: Path) -> Self | None:
        """Of a dataset's folder; None if it says nothing of a robot.

        Raises:
            CEIError: what it says is wrong, or it has no joint positions.
        """
        metadata, info = find_metadata(root), read_info(root)
        if metadata is None:
            return None
        features = info["features"]
        cloud = features.get(schema.POINT_CLOUD)
        raw = {
            "joint_names": schema.feature_names(features[schema.STATE]),
            "starts": find_starts(root),
            "fps": info["fps"],
            "cloud_shape": None if cloud is None else schema.cloud_shape(cloud, f"{root.name}: {schema.POINT_CLOUD}"),
            KEY: essentials(metadata),
            _STEP_TIME: plain(metadata.step_time_s),
        }
        return cls.decode(raw, root.name)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Of a checkpoint's folder (`pretrained_model`), or of a dataset's.

        Raises:
            CEIError: it is neither, or says nothing of a robot.
        """
        if (path / INFO_PATH).is_file():
            if (known := cls.of_dataset(path)) is None:
                raise CEIError(f"{path} is no dataset of CEI-Gym: it does not say which robot's it is.")
            return known
        if not (path / STEPS_PATH).is_file():
            raise CEIError(f"{path} is neither a checkpoint (with {STEPS_PATH}) nor a dataset (with {INFO_PATH}).")
        try:
            steps = load_json((path / STEPS_PATH).read_text())["steps"]
            found = [
                step["config"]["trained_on"] for step in steps if step.get("registry_name") in (STEP, PICTURES_STEP)
            ]
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise CEIError(f"{path / STEPS_PATH} cannot be read: {one_line(error)}.") from error
        if not found:
            raise CEIError(
                f"{path / STEPS_PATH} has no step {STEP!r}: the policy looks at no clouds, was trained on other data, or without lerobot_robot_cei. "
                "Name the dataset that it was trained on instead (cei-deploy: --trained_on)."
            )
        return cls.decode(found[0], f"{path.name}/{STEPS_PATH}")

    @classmethod
    def decode(cls, raw: object, where: str) -> Self:
        """From JSON types, which may be a stranger's.

        Raises:
            CEIError: a field is missing or wrong, or the robot's description is not here.
        """
        if not isinstance(raw, dict) or any(name not in raw for name in _FIELDS):
            raise CEIError(f"{where}: what a policy was trained on should have {', '.join(_FIELDS)}.")
        names, shape = raw["joint_names"], raw["cloud_shape"]
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise CEIError(f"{where}: joint_names should be names, not {one_line(names, 60)}.")
        try:
            starts = np.asarray(raw["starts"], float)
        except (TypeError, ValueError):
            starts = np.array(np.nan)
        if starts.ndim != 2 or starts.shape[1] != len(names) or not len(starts) or not np.isfinite(starts).all():
            raise CEIError(f"{where}: starts should be rows of {len(names)} joint positions.")
        if type(raw["fps"]) not in (int, float) or not 0 < raw["fps"] < 10_000:
            raise CEIError(f"{where}: fps should be above 0, not {one_line(raw['fps'], 60)}.")
        if shape is not None:
            if not isinstance(shape, list | tuple) or len(shape) != 2 or shape[1] not in (3, 6):
                raise CEIError(f"{where}: cloud_shape should be (N, 3 or 6), not {one_line(shape, 60)}.")
            shape = (int(shape[0]), int(shape[1]))
        metadata = find_essentials({schema.STATE: {"info": {KEY: raw[KEY]}}}, where)
        assert isinstance(metadata, Remains)
        if raw.get(_STEP_TIME) is not None:
            metadata = replace(metadata, step_time_s=StepTime.decode(raw[_STEP_TIME], where))
        known = cls(metadata, tuple(names), starts, float(raw["fps"]), shape)
        try:
            points = known.clouds().points
        except DraccusException as error:
            raise CEIError(f"{where}: clouds: {one_line(error)}.") from error
        if shape is not None and points != shape[0]:
            raise CEIError(f"{where}: clouds have {points} points, but cloud_shape is {shape}.")
        return known

    def encode(self) -> dict[str, Any]:
        """As JSON types, for `decode`."""
        return {
            "joint_names": list(self.joint_names),
            "starts": self.starts.tolist(),
            "fps": self.fps,
            "cloud_shape": None if self.cloud_shape is None else list(self.cloud_shape),
            KEY: essentials(self.metadata),
            _STEP_TIME: plain(self.metadata.step_time_s),
        }

    def embodiment(self) -> Embodiment:
        """The robot.

        Raises:
            CEIError: it is not described here, or otherwise than where the policy was trained.
        """
        known = load_embodiment(self.metadata.embodiment)
        schema.check_joint_names(self.joint_names, known, "what the policy was trained on")
        return known

    def clouds(self) -> CloudOptions:
        """Options of the clouds that the policy knows; of one that was trained on clouds as cameras see them, without another robot."""
        if self.metadata.clouds is not None:
            return draccus.decode(CloudOptions, self.metadata.clouds)
        return (
            CloudOptions(swap=False)
            if self.cloud_shape is None
            else CloudOptions(swap=False, points=self.cloud_shape[0])
        )

    def seen_by(self, calibration: Calibration) -> Self:
        """The same with a lab's cameras, workspace and base in the place of the recorded ones."""
        return replace(self, metadata=replace(self.metadata, scene=calibration.over(self.metadata.scene)))

    def waiting(self) -> str | None:
        """That steps of the data waited for joints, and what to do for a robot to wait likewise; None if they did not, or nobody knows."""
        found = self.metadata.step_time_s
        if found is None or not found.waits:
            return None
        return (
            f"{found.sentence(self.fps)} A robot waits likewise with --robot.wait_s={found.at_most or found.max:g}; without, targets come "
            "faster than demonstrations went."
        )

    def complaint(self, qpos: Array, embodiment: Embodiment, tolerance: float) -> str | None:
        """Why a robot must not begin where it stands; None if it may.

        Args:
            qpos: (n,) joint positions, rad or m.
            embodiment: whose.
            tolerance: largest distance of a joint from that of a start, rad; of one that slides, a tenth of it, m.
        """
        names = embodiment.joint_names
        near = tolerance * np.where(np.array(embodiment.joint_units) == "m", _M_PER_RAD, 1.0)
        outside = np.maximum(embodiment.lower - qpos, qpos - embodiment.upper) - near
        worst = int(outside.argmax())
        if outside[worst] > 0:
            return (
                f"{names[worst]} is said to stand at {qpos[worst]:.3g} {embodiment.joint_units[worst]}, outside its limits "
                f"{embodiment.lower[worst]:.3g} to {embodiment.upper[worst]:.3g}: are joints in another order, or unit?"
            )
        leads = embodiment.coupled.independent  # what follows goes along
        away = np.zeros_like(self.starts)
        away[:, leads] = np.abs(self.starts - qpos)[:, leads]
        nearest = int((away / near).max(axis=1).argmin())
        far = np.flatnonzero(away[nearest] > near)
        if not len(far):
            return None
        moves = ", ".join(f"{names[q]} from {qpos[q]:.3f} to {self.starts[nearest, q]:.3f}" for q in far)
        return (
            f"no demonstration starts where the robot stands (within {tolerance:g} rad, or {_M_PER_RAD * tolerance:g} m, of each joint). Move {moves}; "
            "or are joints in another order, or unit?"
        )


def find(name: str) -> Path:
    """Folder of a checkpoint or dataset: as named, else of the hub's checkpoint of that name, of which its steps alone are fetched.

    Raises:
        CEIError: there is neither.
    """
    folder = Path(name).expanduser()
    if folder.is_dir():
        return folder
    from huggingface_hub import hf_hub_download

    try:
        return Path(hf_hub_download(name, STEPS_PATH)).parent
    except Exception as error:  # network, authorisation, unknown names: the hub's client has no common class
        raise CEIError(
            f"{name} is neither a folder nor a checkpoint of the hub with {STEPS_PATH} ({one_line(error, 150)})."
        ) from error
