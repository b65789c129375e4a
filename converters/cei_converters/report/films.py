"""Films of episodes, the source's beside the dataset's: from simulation where there is one, else drawn, with what a camera saw."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from cei_converters.dataset.place import temporary_folder
from cei_converters.simulation.video import side_by_side, write_video
from cei_converters.view.episode import View
from cei_converters.view.sheet import draw_moments
from cei_gym.arrays import Array
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.simulation.stage import Stage
    from cei_converters.sources.reader import DatasetReader
    from cei_converters.sources.source import Source

_MOST_FRAMES = 150  # of a drawn film: a frame takes a twentieth of a second, and more show no more


@dataclass(frozen=True)
class Film:
    """A film: MP4, and what it shows."""

    content: bytes
    caption: str


class Films:
    """Makes films of a dataset's episodes.

    Args:
        reader: of the dataset.
        source: of what it was converted from, if that can be replayed, too.
        stages: the dataset's environment, and the source's; None where there is none.
    """

    def __init__(
        self, reader: "DatasetReader", source: "Source | None", stages: "tuple[Stage | None, Stage | None]"
    ) -> None:
        self._reader, self._source, (self._stage, self._beside) = reader, source, stages

    def film(self, view: View) -> Film:
        """That of one episode.

        Raises:
            CEIError: it cannot be replayed, or what cameras saw cannot be decoded.
        """
        return self._drawn(view) if self._stage is None else self._replayed(view.sides[-1].demonstration.index)

    def _replayed(self, index: int) -> Film:
        from cei_converters.replay import film_beside

        assert self._stage is not None
        entry, pictures = self._stage.play(self._reader.read(index, clouds=False), filmed=True)
        beside = None if self._source is None or self._beside is None else (self._source, self._beside)
        views, labels = film_beside(self._reader, beside, entry, pictures)
        names = "; ".join(labels)
        return Film(_mp4(side_by_side(views, labels), self._reader.fps), f"Replayed in {self._stage.env_id}. {names}.")

    def _drawn(self, view: View) -> Film:
        step = -(-len(view) // _MOST_FRAMES)
        moments = range(0, len(view), step)
        panels = [draw_moments(view, side, moments, supersample=1) for side in view.sides]
        labels, caption = [side.label for side in view.sides], "Drawn from joints, pads and clouds"
        if self._reader.cameras:
            key = next(iter(self._reader.cameras))
            seen = self._reader.pictures(view.sides[-1].demonstration.index).decode(key)
            panels.insert(0, [_scaled(seen[t], panels[0][0].shape[0]) for t in moments])
            labels.insert(0, key)
            caption += f", beside what {key} saw: the source's robot, unless another was painted"
        return Film(_mp4(side_by_side(panels, labels), max(1, self._reader.fps / step)), f"{caption}.")


@contextlib.contextmanager
def open_films(reader: "DatasetReader", source: "Source | None") -> Iterator[tuple[Films, str]]:
    """Films, and why they do not show simulations; "" if they do."""
    from cei_converters.replay import stage_of

    with contextlib.ExitStack() as stack:
        stages: list[Stage | None] = []
        said = ""
        for each in (reader, source):
            stages.append(None)
            if each is None:
                continue
            try:
                if each.environment.id is None:
                    raise CEIError(f"{each.repo_id} names no environment.")
                if each.read(0, clouds=False).environment_state is None:
                    raise CEIError(f"{each.repo_id} does not say where its objects start.")
                stages[-1] = stack.enter_context(stage_of(each))
            except CEIError as error:
                said = said or str(error)
        yield Films(reader, source, (stages[0], stages[1])), said


def _mp4(frames: list[Array], fps: float) -> bytes:
    with temporary_folder() as folder:
        path = folder / "film.mp4"
        write_video(path, [_even(frame) for frame in frames], round(fps))
        return path.read_bytes()


def _even(frame: Array) -> Array:
    """Without a last row or column where there is an odd number of them, as H.264 wants it."""
    return frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2]


def _scaled(picture: Array, height: int) -> Array:
    """An RGB picture of that height."""
    width = round(picture.shape[1] * height / picture.shape[0])
    return np.asarray(Image.fromarray(picture).resize((width, height)))
