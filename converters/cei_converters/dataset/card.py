"""The dataset card: README.md of a recorded or converted dataset."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset import schema
from cei_converters.dataset.card_markdown import flat, listed, markdown_table
from cei_converters.dataset.card_records import augmented, evidence, painting, quality, verified
from cei_converters.dataset.license import CARD_PATH, FIELDS, license_files
from cei_converters.dataset.metadata import METADATA_PATH, Metadata, Source
from cei_converters.dataset.records import RECORDS_PATH, Records
from cei_converters.dataset.step_time import STEP_TIMES

CITATION = """@article{wu2026cei,
  title   = {{CEI}: A Unified Interface for Cross-Embodiment Visuomotor Policy Learning in {3D} Space},
  author  = {Wu, Tong and Li, Shoujie and Gong, Junhao and Guo, Changqing and Li, Xingting and Mu, Shilong
             and Ding, Wenbo},
  year    = {2026}
}"""


def write_card(root: Path, repo_id: str, metadata: Metadata) -> None:
    """Write README.md into a finished dataset."""
    from huggingface_hub import DatasetCard, DatasetCardData

    info, records = json.loads((root / "meta/info.json").read_text()), Records(root)
    sources = _sources(metadata)
    data = DatasetCardData(
        **_license(sources),
        tags=["LeRobot", "cei-gym", "cross-embodiment", metadata.embodiment],
        task_categories=["robotics"],
        source_datasets=list(dict.fromkeys(source.repo_id for source in sources)) or None,
        configs=[{"config_name": "default", "data_files": "data/*/*.parquet"}],
    )
    sections = [
        _introduction(repo_id, metadata, info),
        quality(root, metadata, records),
        augmented(records),
        verified(metadata, records),
        evidence(metadata, records),
        _cameras(metadata, info, records),
        _time(metadata, info),
        _columns(metadata),
        _layout(metadata, info),
        _usage(repo_id, metadata),
        _provenance(root, metadata, records),
        f"## Citation\n\nThe method is that of\n\n```bibtex\n{CITATION}\n```",
    ]
    body = "\n\n".join(section for section in sections if section)
    DatasetCard(f"---\n{data.to_yaml()}\n---\n\n{body}\n").save(root / CARD_PATH)


def _sources(metadata: Metadata) -> list[Source]:
    """What episodes were converted from, each once; none if they were recorded."""
    sources = [provenance.source for provenance in metadata.provenances]
    return [source for i, source in enumerate(sources) if source is not None and source not in sources[:i]]


def _license(sources: list[Source]) -> dict[str, Any]:
    """What the card's head says of licenses: the source's as it is; of several that differ, all identifiers."""
    found = [{name: getattr(source, name) for name in FIELDS} for source in sources]
    if not found or all(each == found[0] for each in found):
        return found[0] if found else {}
    named = [name for source in sources for name in _listed_license(source)]
    return {"license": list(dict.fromkeys(named)) or None}


def _listed_license(source: Source) -> list[str]:
    return [each for each in (source.license if isinstance(source.license, list) else [source.license]) if each]


def _introduction(repo_id: str, metadata: Metadata, info: dict[str, Any]) -> str:
    sources = _sources(metadata)
    size = f"{info['total_episodes']} episodes, {info['total_frames']} frames at {info['fps']} Hz"
    if not sources:
        origin = f"Demonstrations of **{metadata.embodiment}**, recorded in simulation with CEI-Gym: {size}."
    else:
        named = {f"**{source.embodiment}** (`{source.repo_id}`)": None for source in sources}
        origin = (
            f"Demonstrations of **{metadata.embodiment}**, converted from {' and '.join(named)} with CEI-Gym: {size}. No {metadata.embodiment} was operated: the joint "
            "trajectories are those that bring its functional pads where the source robot's were, found by "
            "minimising the Directional Chamfer Distance" + _shown(metadata, info)
        )
    title = f"# {repo_id}\n\n{origin} It is a [LeRobot](https://github.com/huggingface/lerobot) v3.0 dataset."
    environment = metadata.environment
    return title + (f"\n\nEnvironment: `{environment.id}`." if environment.id else "")


def _shown(metadata: Metadata, info: dict[str, Any]) -> str:
    """The end of a sentence: which robot clouds show."""
    if schema.POINT_CLOUD not in info["features"]:
        return "."
    if (metadata.clouds or {}).get("swap", True):
        return ", and the point clouds show it in the source's place."
    return ". **The point clouds still show the source robot** (`--clouds.swap=false`)."


def _cameras(metadata: Metadata, info: dict[str, Any], records: Records) -> str:
    """What the source's cameras became; empty for a recorded dataset."""
    sources = _sources(metadata)
    if not sources:
        return ""
    seen = dict.fromkeys(camera for source in sources for camera in source.depth_cameras)
    if schema.POINT_CLOUD not in info["features"]:
        text = "There are no point clouds: the source has no depth, so it was converted in joints."
    elif seen:
        text = f"Point clouds were made from the depth of {listed(seen)}."
    else:
        text = "Point clouds were made from the source's."
    dtypes = {key: feature["dtype"] for key, feature in info["features"].items()}
    pictures = [key for key, dtype in dtypes.items() if dtype in ("image", "video")]
    painted = Counter(key for record in records for key in record.get("painted", ()))
    if untouched := [key for key in pictures if painted[key] < len(records)]:
        shown = " or ".join(dict.fromkeys(source.embodiment for source in sources))
        text += (
            f" Pictures of {listed(untouched)} are the source's, passed through untouched: **they still show "
            f"{shown}, not {metadata.embodiment}**."
        )
    for key, count in sorted(painted.items()):
        of = [record["painting"][key] for record in records if key in record.get("painting", ())]
        steps = listed(metadata.provenance.options.get("steps") or ())
        by = painting(metadata.embodiment, of) if of else f"by steps of a package ({steps})."
        text += f" In {count} of {len(records)} episodes pictures of `{key}` were painted, {by}"
    stretched = sum("source_frames" in record for record in records)
    if stretched and "video" in dtypes.values():
        text += (
            f" In {stretched} of {len(records)} episodes {metadata.embodiment} needs more time, so frames "
            f"repeat (`source_frames` in `{RECORDS_PATH}`); their videos were encoded again."
        )
    return f"## Cameras\n\n{text}"


def _time(metadata: Metadata, info: dict[str, Any]) -> str:
    """How long steps took; empty if that is not known."""
    found = metadata.step_time_s
    if found is None:
        return ""
    text = f"## Time\n\n{found.sentence(info['fps'])} Step by step in `{RECORDS_PATH}`, under `{STEP_TIMES}`."
    others = [robot for robot in found.robots if robot != metadata.embodiment]
    if others:
        text += f" {metadata.embodiment} was not timed: a frame has the time of the step that it was converted from."
    return text


def _columns(metadata: Metadata) -> str:
    """What became of the source's other features, and where its table is; empty for a recorded dataset."""
    source, table = metadata.provenance.source, metadata.provenance.options.get("table", {})
    if source is None:
        return ""
    parts = []
    if source.carried:
        parts.append(f"Carried over from the source as they are, frame by frame: {listed(source.carried)}.")
    if source.dropped:
        rows: list[tuple[Any, ...]] = [(f"`{name}`", reason) for name, reason in source.dropped.items()]
        parts.append("Not carried over:\n\n" + markdown_table(("feature", "why"), rows))
    if table:
        parts.append(f"The table is taken to be at {table['z_m']:g} m (world), by {table['said_by']}.")
    return "## Other features\n\n" + "\n\n".join(parts) if parts else ""


def _layout(metadata: Metadata, info: dict[str, Any]) -> str:
    features = []
    for key, feature in info["features"].items():
        shape, names, more = feature["shape"], feature.get("names"), ""
        if key == schema.POINT_CLOUD:
            shape, names = schema.cloud_shape(feature, key), names or feature["info"]["columns"]
            more = " of each point; stored flat" if len(feature["shape"]) == 1 else ""
        if names:
            entries = ", ".join(map(str, names)) + more
            features.append((f"`{key}`", feature["dtype"], "x".join(map(str, shape)), entries))
    cameras = [
        (camera.name, f"{camera.width}x{camera.height}", np.round(np.diag(camera.K)[:2], 2).tolist())
        for camera in metadata.scene.cameras
    ]
    parts = ["## Layout, frames, units", markdown_table(("feature", "type", "shape", "entries"), features)]
    parts.append("\n".join(f"- {name}: {text}" for name, text in metadata.conventions.items()))
    if cameras:
        parts.append(markdown_table(("camera", "pixels", "focal length (px)"), cameras))
    parts.append(f"Poses, intrinsics and workspace are in `{METADATA_PATH}`.")
    parts.append(_read_by_policies(info))
    return "\n\n".join(parts)


def _read_by_policies(info: dict[str, Any]) -> str:
    """What policies are given, in words."""
    text = "Policies are given what begins with `observation`."
    if schema.PRIVILEGED_STATE in info["features"]:
        text += (
            f" `{schema.PRIVILEGED_STATE}`, the simulator's state of objects, is for replaying: no policy is given it."
        )
    if schema.ENVIRONMENT_STATE in info["features"]:
        text += (
            f" **`{schema.ENVIRONMENT_STATE}` is the simulator's state of objects: LeRobot's ACT and Diffusion take it by "
            "themselves, though no camera shows it.**"
        )
    return text


def _usage(repo_id: str, metadata: Metadata) -> str:
    replay = f"\n\n```bash\ncei-replay --dataset.repo_id={repo_id}\n```" if metadata.environment.id else ""
    return f"""## Use

```python
from lerobot.datasets.lerobot_dataset import LeRobotDataset

dataset = LeRobotDataset("{repo_id}")
```

```bash
lerobot-train --dataset.repo_id={repo_id} --policy.type=<policy> --output_dir=outputs/train
```{replay}"""


def _provenance(root: Path, metadata: Metadata, records: Records) -> str:
    parts = ["## How it was made"]
    if edited := [str(record["restored_from"]["repo_id"]) for record in records if "restored_from" in record]:
        counts = ", ".join(f"{n} of `{name}`" for name, n in Counter(edited).items())
        parts.append(
            f"With other tools, after what is said below: these are {counts}. Which is which is in `{RECORDS_PATH}`, under "
            "`restored_from`."
        )
    files = [path.name for path in license_files(root)]
    for number, provenance in enumerate(metadata.provenances):
        if metadata.merged:
            parts.append(f"### Part {number} (`provenance` in `{RECORDS_PATH}`)")
        if provenance.command:
            parts.append(f"```bash\n{provenance.command}\n```")
        rows: list[tuple[Any, ...]] = [("date", provenance.date)] if provenance.date else []
        if provenance.git_commit:
            rows.append(("commit of CEI-Gym", provenance.git_commit))
        rows += _source_rows(provenance.source, files)
        rows += [(f"content of {name}", f"`{value}`") for name, value in provenance.inputs.items()]
        rows += [(f"about {name}", note) for name, notes in provenance.notes.items() for note in notes]
        rows += [(f"version of {name}", value) for name, value in provenance.versions.items()]
        rows += [(f"`--{name}`", f"`{value}`") for name, value in flat(provenance.options)]
        parts.append(markdown_table(("", ""), rows))
    return "\n\n".join(parts)


def _source_rows(source: Source | None, files: list[str]) -> list[tuple[Any, ...]]:
    if source is None:
        return []
    named = [*_listed_license(source), *filter(None, (source.license_name, source.license_link)), *files]
    rows = [
        ("source", source.repo_id),
        ("source revision", source.revision),
        ("source files", source.fingerprint),
    ]
    return [
        *((name, f"`{value}`") for name, value in rows if value),
        ("license of the source", listed(named) if named else "none is named, so none is named here"),
    ]
