"""Whether options are about what a dataset has."""

from typing import TYPE_CHECKING

from cei_converters.cli.options import check_of_use
from cei_converters.conversion.config import ConvertConfig
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.sources.source import Source


def check_fit(config: ConvertConfig, reader: "Source") -> None:
    """Check that a dataset has what options are about.

    Raises:
        CEIError: an option changes nothing with this dataset.
    """
    if reader.metadata is not None and config.source_pose is not None:
        raise CEIError(f"{reader.repo_id} says where its base is (meta/cei.json); leave out --source_pose.")
    if not (reader.has_clouds or reader.depth_cameras):
        check_of_use(
            config, dict.fromkeys(("clouds.*", "check_clouds"), "where a dataset has neither depth nor clouds")
        )
