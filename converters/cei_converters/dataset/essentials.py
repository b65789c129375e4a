"""What a dataset cannot be used without, where LeRobot's own tools carry it along: in `features` of `meta/info.json`.

They make a new `meta/` from `features`, so `meta/cei.json` is lost, and they merge datasets whose `features` are equal. So this is
in `features`, where it is the same for datasets that may be merged and differs for those that may not: another robot, another
scene, other clouds.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cei_converters.dataset import schema
from cei_converters.dataset.metadata import START, Metadata, plain
from cei_gym.errors import CEIError

KEY = "cei"
"""Where it is in a feature's `info`."""
CARRIERS = (schema.STATE, schema.ACTION)
"""The features that have it: one of them may be removed."""


@dataclass(frozen=True)
class Remains(Metadata):
    """What LeRobot's tools leave of a dataset's metadata. Lost are provenance, records, card, and where demonstrations start."""


def essentials(metadata: Metadata) -> dict[str, Any]:
    """These parts of metadata, as JSON types. Where demonstrations start is none: it differs from one conversion to the next."""
    environment = metadata.environment
    kwargs = {name: value for name, value in environment.kwargs.items() if name != START}
    return plain(
        {
            "format_version": metadata.format_version,
            "embodiment": metadata.embodiment,
            "scene": metadata.scene,
            "environment": {"id": environment.id, "kwargs": kwargs},
            "clouds": metadata.clouds,
        }
    )


def difference(one: Metadata, other: Metadata) -> str:
    """Say in words in which of them two datasets differ; empty where they do not."""
    ours, theirs = essentials(one), essentials(other)
    return " and ".join(name for name in ours if name != "format_version" and ours[name] != theirs[name])


def with_essentials(features: Mapping[str, dict[str, Any]], metadata: Metadata) -> dict[str, dict[str, Any]]:
    """Features that have them."""
    carried = {KEY: essentials(metadata)}
    return {
        key: {**feature, "info": {**(feature.get("info") or {}), **carried}} if key in CARRIERS else feature
        for key, feature in features.items()
    }


def find_essentials(features: object, where: str) -> Remains | None:
    """These parts; None if features, which may be a stranger's, have none.

    Raises:
        CEIError: they are wrong, or two features disagree.
    """
    infos = [
        features[key].get("info") for key in CARRIERS if isinstance(features, dict) and _is_dict(features.get(key))
    ]
    found = [info[KEY] for info in infos if _is_dict(info) and KEY in info]
    if not found:
        return None
    if any(each != found[0] for each in found):
        raise CEIError(f"{where}: info.{KEY} of {' and '.join(CARRIERS)} differ; they should be the same.")
    return Remains.decode(found[0], f"{where}: info.{KEY}")


def _is_dict(value: object) -> bool:
    return isinstance(value, dict)
