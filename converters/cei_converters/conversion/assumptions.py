"""What a conversion says before it works: what becomes of cameras and columns, and what it takes for granted."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cei_converters.conversion.converter import Converter
    from cei_converters.sources.source import Source as Recorded


def about_cameras(reader: "Recorded", pass_through: bool, steps: bool, painted: bool = False) -> str:
    """One line: what becomes of the dataset's cameras, whose pictures pass through or not, are painted, or may be by steps that packages add."""
    if reader.depth_cameras:
        clouds = f"Clouds are made from the depth of {', '.join(reader.depth_cameras)}"
    elif reader.has_clouds:
        clouds = "Clouds are made from the recorded ones"
    else:
        clouds = "Neither depth nor clouds: converted in joints"
    if not reader.cameras:
        return clouds + "."
    if not pass_through:
        return f"{clouds}; left out, as they show objects where they were recorded: {', '.join(reader.cameras)}."
    if painted:
        return f"{clouds}; painted: {', '.join(reader.cameras)}."
    unless = ", unless a step paints others" * steps
    return (
        f"{clouds}; passed through untouched, so they still show the source robot{unless}: {', '.join(reader.cameras)}."
    )


def notes_on_robots(converter: "Converter") -> dict[str, list[str]]:
    """What was assumed or left out of the descriptions of robots, by their names; nothing of those of which nothing is said."""
    return {body.name: [*body.notes] for body in (converter.reader.embodiment, converter.transfer.target) if body.notes}


def about_columns(reader: "Recorded") -> list[str]:
    """A line each: which features are carried over as they are, and which are not, and why."""
    lines = [f"Carried over as they are: {', '.join(reader.carried)}."] if reader.carried else []
    reasons: dict[str, list[str]] = {}
    for name, reason in reader.dropped.items():
        reasons.setdefault(reason, []).append(name)
    return [*lines, *(f"Not carried over, {reason}: {', '.join(names)}." for reason, names in reasons.items())]


def about_table(z_m: float) -> str:
    """A line: where the table is taken to be."""
    return (
        f"warning: nothing says where the table is, so it is taken to be at {z_m:g} m (world), where the source's lowest point was; if it is "
        "elsewhere, give --table_z_m, or a --calibration with workspace_world."
    )
