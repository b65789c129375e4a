"""One episode of a report: why it is in it, and what there is to see of it."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace

from PIL import Image

from cei_converters.report.episodes import Episode
from cei_converters.report.films import Films
from cei_converters.report.page import MP4, PNG, WEBP, Medium
from cei_converters.report.plots import Series, plot_clouds, png
from cei_converters.sources.source import Source
from cei_converters.view.episode import View, load_view
from cei_converters.view.sheet import draw_sheet

_SHEET_PX = 1800  # how wide a contact sheet is kept


@dataclass(frozen=True)
class Shown:
    """It.

    Attributes:
        heading: in one line.
        why: sentences.
        media: pictures of it.
        film: a film of it, if films are wanted.
        series: how far pads are apart; None where the source is not known, or its objects were moved.
    """

    heading: str
    why: Sequence[str]
    media: Sequence[Medium]
    film: Medium | None = None
    series: Series | None = None


def show(
    reader: Source, source: Source | None, episode: Episode, best: bool, films: Films | None
) -> tuple[Shown, View]:
    """Read and draw one.

    Args:
        reader: of the dataset.
        source: of what it was converted from, if that is to be shown.
        episode: which.
        best: whether it is the best one.
        films: what makes films; None for none.

    Returns:
        It, and the view that it was drawn from.

    Raises:
        CEIError: it cannot be read, or the source is not what it was converted from.
    """
    view = load_view(reader, episode.index, source)
    name = f"Episode {episode.index}"
    heading = name if episode.fidelity is None else f"{name}, fidelity {episode.fidelity:.2f}"
    what = "source above, target below" if source is not None else "at five moments"
    if view.uncorrected is not None:
        what += "; at the bottom without its correction and with it"
    drawn = draw_sheet(replace(view, residuals={}))  # which are plotted for all that are shown
    sheet = Medium(WEBP, _webp(png(drawn)), f"{name}: {what}.")
    film = None
    if films is not None:
        made = films.film(view)
        film = Medium(MP4, made.content, f"{name}{', the best' if best else ''}. {made.caption}")
    label = f"episode {episode.index}{' (best)' if best else ''}"
    series = Series(label, view.times_s, view.residuals, best) if view.residuals else None
    return Shown(f"{heading}{', the best' if best else ''}", episode.why(), [sheet], film, series), view


def clouds(view: View) -> Medium | None:
    """Point clouds of a view's robots; None where there are none."""
    seen = [side.demonstration for side in view.sides if side.demonstration.point_cloud_world is not None]
    if not seen:
        return None
    more = "before and after" if len(seen) > 1 else seen[0].embodiment
    return Medium(PNG, plot_clouds(seen), f"Point clouds of episode {seen[-1].index}, two thirds into it: {more}.")


def _webp(content: bytes) -> bytes:
    """A picture, smaller: a page has several."""
    picture = Image.open(io.BytesIO(content)).convert("RGB")
    height = round(picture.height * _SHEET_PX / picture.width)
    if picture.width > _SHEET_PX:
        picture = picture.resize((_SHEET_PX, height))
    buffer = io.BytesIO()
    picture.save(buffer, format="WEBP", quality=82)
    return buffer.getvalue()
