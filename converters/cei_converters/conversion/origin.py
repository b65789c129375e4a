"""Where a converted dataset comes from, for its metadata: source, options, and the content of all that was read."""

from pathlib import Path
from typing import TYPE_CHECKING

from cei_converters.conversion.assumptions import notes_on_robots
from cei_converters.conversion.config import ConvertConfig
from cei_converters.conversion.plan import BY_CONTENT, PLACED
from cei_converters.dataset.provenance import fingerprint
from cei_gym import plugins
from cei_gym.alignment import registry

if TYPE_CHECKING:
    from cei_converters.conversion.converter import Converter
    from cei_converters.dataset.metadata import Provenance


def files_by_content(config: ConvertConfig) -> dict[str, str]:
    """Fingerprints of the files that options name."""
    named = {name.replace("_", " "): getattr(config, name) for name in BY_CONTENT}
    return {name: fingerprint(Path(file)) for name, file in named.items() if file is not None}


def provenance_of(config: ConvertConfig, converter: "Converter", content: str) -> "Provenance":
    """How the dataset comes about; `content` is the fingerprint of the one that is converted."""
    from cei_converters.conversion import steps
    from cei_converters.dataset.license import source_license
    from cei_converters.dataset.metadata import Source
    from cei_converters.dataset.provenance import collect, command_line, published
    from cei_converters.sources import formats
    from cei_converters.sources.joint_map import load_joint_map
    from cei_gym.embodiment import fingerprint as identity

    reader, root = converter.reader, config.dataset.root
    source = Source(
        repo_id=reader.repo_id,
        embodiment=reader.embodiment.name,
        root_name=Path(root).name if root else None,
        revision=_revision(reader.root) if root is None else None,
        fingerprint=content,
        depth_cameras=reader.depth_cameras,
        carried=tuple(reader.carried),
        dropped=dict(reader.dropped),
        **source_license(reader.root),
    )
    options = published(config)
    del options["dataset"]  # which is the source
    options["table"] = {"z_m": reader.scene.support_z_m, "said_by": reader.table_from}
    if converter.placed is not None:
        options[PLACED] = converter.placed
    inputs = {
        "source embodiment": identity(reader.embodiment),
        "target embodiment": identity(converter.transfer.target),
        **files_by_content(config),
    }
    if config.joint_map is not None:
        options["joint_map"] = load_joint_map(config.joint_map)
    added = {
        **plugins.providers(steps.GROUP, config.steps or ()),
        **plugins.providers(registry.GROUP, [config.solver.backend] * (config.solver.backend not in registry.OWN)),
        **plugins.providers(formats.GROUP, [formats.format_of(config.dataset.root)]),
    }
    return collect(
        options,
        command_line("cei-convert", config),
        source=source,
        inputs=inputs,
        notes=notes_on_robots(converter),
        packages=added,
    )


def _revision(root: Path) -> str | None:
    """Commit of a dataset in the hub's cache, where folders are named by it."""
    return root.name if root.parent.name == "snapshots" else None
