"""What an embodiment is, whatever it is called and wherever its files are."""

import hashlib
import json
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from cei_gym.embodiment.embodiment import Embodiment

_WHERE = ("name", "description", "folder", "package_path", "xacro_args", "servo", "self_contact", "remark")
"""Of a specification: what it is called, where files are whose content is in the model, and what a simulation alone knows."""

_SHOWN = {"arm": ("mount_pos_m", "mount_quat_wxyz", "until_body", "leave_out"), "end_effector": ("joints",)}
"""What came later and the model shows anyway, so that robots without it are what they were."""


def fingerprint(embodiment: Embodiment) -> str:
    """SHA-256 of the compiled model (kinematics, meshes, colours, limits) and of what is known beside it (pads, poses, couplings, speeds).

    It changes with what a YAML, a description, what that includes, or a mesh says; not with their names, places or comments.
    """
    digest, model = hashlib.sha256(), embodiment.model
    for name in sorted(dir(model)):
        if not name.startswith("_") and "path" not in name:
            value = getattr(model, name)
            if isinstance(value, (np.ndarray, bytes)):
                digest.update(f"{name} {np.shape(value)} ".encode())
                digest.update(np.ascontiguousarray(value).tobytes())
    known = {field.name: getattr(embodiment, field.name) for field in fields(embodiment)}
    for name in ("name", "model", "coupled", "notes"):
        known.pop(name)
    for name in ("arm", "end_effector"):
        part = known.pop(name)
        known[name] = (
            None if part is None else {k: v for k, v in asdict(part).items() if k not in (*_WHERE, *_SHOWN[name])}
        )
    digest.update(json.dumps(known | asdict(embodiment.coupled), sort_keys=True, default=_plain).encode())
    return f"sha256:{digest.hexdigest()}"


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else str(value)
