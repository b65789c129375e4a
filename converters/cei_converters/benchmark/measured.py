"""Which code each benchmark measures, as patterns of paths in the checkout (see `measured_code.select`).

A pattern stands for all that could change the figure, not for what did. What a figure's libraries were is in its versions.
"""

from cei_gym.errors import CEIError

_ALIGNMENT = tuple(
    f"cei_gym/{part}" for part in ("alignment/*", "embodiment/*", "functional/*", "kinematics/*", "compiled.py")
)
# The whole method, less what plays another robot's part live, what only makes more of a demonstration, and pictures, which no robot follows.
_PICTURES, _LIVE = "!cei_gym/painting/*", ("!cei_gym/wrapper.py", "!cei_gym/impersonation.py")
_METHOD = ("cei_gym/*", *_LIVE, "!cei_gym/augmentation.py", _PICTURES)
_ENVIRONMENTS = ("envs/cei_envs/*",)
# From an environment to demonstrations, by the scripted expert.
_RECORDED = (*_ENVIRONMENTS, "converters/cei_converters/simulation/*")
# From a dataset to another: not what is said of it, and not other formats.
_CONVERSION = (
    *("converters/cei_converters/convert.py", "converters/cei_converters/conversion/*"),
    *("!converters/cei_converters/conversion/quality_picture.py", "!converters/cei_converters/conversion/outcomes.py"),
    *("!converters/cei_converters/conversion/cameras.py", "!converters/cei_converters/conversion/painting.py"),
    *("converters/cei_converters/sources/*", "!converters/cei_converters/sources/robomimic*.py"),
    *("!converters/cei_converters/sources/robosuite.py", "!converters/cei_converters/sources/hdf5.py"),
    "!converters/cei_converters/sources/zarr_source.py",
    *("converters/cei_converters/dataset/*", "!converters/cei_converters/dataset/card*.py"),
    *("!converters/cei_converters/dataset/license.py", "!converters/cei_converters/dataset/hub.py"),
)
_PAINTING = tuple(f"converters/cei_converters/conversion/{name}.py" for name in ("cameras", "painting"))
_RECORD, _REPLAY = "converters/cei_converters/record.py", "converters/cei_converters/replay.py"


def _of_benchmark(*names: str) -> tuple[str, ...]:
    """Modules of this folder."""
    return tuple(f"converters/cei_converters/benchmark/{name}.py" for name in names)


_CELLS = _of_benchmark("cells", "jobs")
_REAL = "converters/cei_converters/benchmark/real_tasks.py"
_POLICY = ("policies/lerobot_policy_dp3/*", "envs/lerobot_env_cei/*")
_CLOUDS = ("cei_gym/pointcloud/*", "cei_gym/rendering/*", "cei_gym/embodiment/*", "cei_gym/kinematics/*")

MEASURED: dict[str, tuple[str, ...]] = {
    "cei-benchmark replay": (*_METHOD, *_RECORDED, *_CONVERSION, _RECORD, _REPLAY, *_CELLS),
    "cei-benchmark policy": (
        *("cei_gym/*", "!cei_gym/impersonation.py", "!cei_gym/augmentation.py", _PICTURES),
        *(*_RECORDED, *_CONVERSION, _RECORD, *_POLICY, "converters/cei_converters/benchmark/policy_stages.py"),
    ),
    "cei-benchmark real --stage=replay": (*_METHOD, *_RECORDED, *_CONVERSION, _RECORD, _REPLAY, *_CELLS, _REAL),
    "cei-benchmark real --stage=policy": (
        *("cei_gym/*", "!cei_gym/impersonation.py", "!cei_gym/augmentation.py", _PICTURES),
        *(*_RECORDED, *_CONVERSION, _RECORD, *_POLICY, _REAL),
        *_of_benchmark("policy_stages", "own_clouds", "jobs"),
    ),
    "cei-benchmark anchors --stage=replay": (
        *("cei_gym/*", *_LIVE, _PICTURES, *_RECORDED, *_CONVERSION, _RECORD, _REPLAY),
        *_of_benchmark("policy_stages", "real_tasks", "jobs", "anchors_stages", "anchors_replay"),
    ),
    "cei-benchmark anchors --stage=policy": (
        *("cei_gym/*", "!cei_gym/impersonation.py", _PICTURES, *_RECORDED, *_CONVERSION, _RECORD, *_POLICY),
        *_of_benchmark("policy_stages", "real_tasks", "jobs", "anchors_stages"),
    ),
    "cei-benchmark modes --stage=replay": (
        *(*_METHOD, *_RECORDED, *_CONVERSION, _RECORD, _REPLAY),
        *_of_benchmark("real_tasks", "jobs", "modes_stages", "modes_replay"),
    ),
    "cei-benchmark modes --stage=policy": (
        *("cei_gym/*", "!cei_gym/impersonation.py", "!cei_gym/augmentation.py", _PICTURES),
        *(*_RECORDED, *_CONVERSION, _RECORD, *_POLICY),
        *_of_benchmark("policy_stages", "real_tasks", "jobs", "modes_stages"),
    ),
    "benchmarks/alignment.py": (*_ALIGNMENT, *_RECORDED, "benchmarks/alignment.py", "benchmarks/others.py"),
    "benchmarks/augmentation.py": (
        *("cei_gym/*", *_LIVE, _PICTURES),
        *(*_RECORDED, *_CONVERSION, _RECORD, "benchmarks/augmentation.py"),
    ),
    "benchmarks/blind_control.py": (*_RECORDED, "cei_gym/embodiment/*", "benchmarks/blind_control.py"),
    "benchmarks/camera.py": (*_CLOUDS, *_ENVIRONMENTS, "benchmarks/camera.py", "benchmarks/measure.py"),
    "benchmarks/camera_fit.py": (*("cei_gym/painting/*", *_CLOUDS, *_ENVIRONMENTS, "benchmarks/camera_fit.py"),),
    "benchmarks/census.py": ("cei_gym/embodiment/*", "benchmarks/census.py"),
    "benchmarks/direction_weight.py": (*_METHOD, *_RECORDED, "benchmarks/direction_weight.py"),
    "benchmarks/first_frame.py": (*_ALIGNMENT, "benchmarks/first_frame.py"),
    "benchmarks/image_policy.py": (
        *("cei_gym/*", "!cei_gym/impersonation.py", "!cei_gym/augmentation.py", *_RECORDED, *_CONVERSION, _RECORD),
        *(*_PAINTING, "envs/lerobot_env_cei/*", "benchmarks/image_policy.py"),
    ),
    "benchmarks/impersonation.py": (
        *("cei_gym/*", "!cei_gym/augmentation.py", _PICTURES, *_RECORDED, "benchmarks/impersonation.py"),
    ),
    "benchmarks/live_pictures.py": (
        *("cei_gym/*", "!cei_gym/augmentation.py", *_RECORDED, "benchmarks/live_pictures.py", "benchmarks/compared.py"),
    ),
    "benchmarks/observation.py": (
        *(*_CLOUDS, "cei_gym/wrapper.py", *_ENVIRONMENTS, "benchmarks/observation.py", "benchmarks/measure.py"),
    ),
    "benchmarks/pads.py": ("cei_gym/embodiment/*", "cei_gym/functional/*", "cei_gym/rendering/*", "benchmarks/pads.py"),
    "benchmarks/pictures.py": (
        *("cei_gym/*", *_LIVE, "!cei_gym/augmentation.py", *_RECORDED),
        *("benchmarks/pictures.py", "benchmarks/compared.py"),
    ),
    "benchmarks/scale.py": (*_METHOD, *_RECORDED, *_CONVERSION, "benchmarks/scale.py", "benchmarks/transfer.py"),
    "benchmarks/score.py": (
        *("cei_gym/twin/calibration.py", "converters/cei_converters/conversion/quality.py", "benchmarks/score.py"),
    ),
    "benchmarks/start_up.py": (
        *(*_CLOUDS, "cei_gym/__init__.py", "cei_gym/compiled.py", *_ENVIRONMENTS, "benchmarks/start_up.py"),
    ),
    "benchmarks/things.py": (*_METHOD, *_RECORDED, "benchmarks/things.py"),
    "benchmarks/training.py": (*_POLICY, *_CONVERSION[-4:], "benchmarks/training.py"),
    "benchmarks/transfer.py": (*_METHOD, *_RECORDED, *_CONVERSION, "benchmarks/transfer.py"),
    "benchmarks/twin.py": (
        *(*_METHOD, *_RECORDED, "converters/cei_converters/conversion/evidence.py", "benchmarks/twin.py"),
    ),
}
"""What is measured, by what a command starts with, `python` left out."""


def measured_by(command: str) -> tuple[str, ...]:
    """What a command measures.

    Raises:
        CEIError: it is no benchmark that is known here.
    """
    for name, patterns in MEASURED.items():
        if f"{command.removeprefix('python ')} ".startswith(f"{name} "):
            return patterns
    raise CEIError(
        f"what '{command}' measures is not said; add it to MEASURED in cei_converters/benchmark/measured.py."
    )
