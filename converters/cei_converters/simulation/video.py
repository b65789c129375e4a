"""Pictures of episodes: an H.264 video, and a contact sheet."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import av
import numpy as np
from PIL import Image, ImageDraw

from cei_gym.arrays import Array

GAP_PX = 4


def write_video(path: Path, frames: Iterable[Array], fps: int) -> None:
    """Write RGB frames (H, W, 3) uint8, all of one even size, as MP4 that browsers play."""
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "23", "preset": "veryfast"})
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            stream.height, stream.width = frame.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def side_by_side(views: Sequence[Sequence[Array]], labels: Sequence[str]) -> list[Array]:
    """Frames with one view beside the other, labelled; a view that ends early keeps its last frame."""
    length = max(len(view) for view in views)
    rows = []
    for t in range(length):
        panels = [label_picture(view[min(t, len(view) - 1)], text) for view, text in zip(views, labels, strict=True)]
        gap = np.full((panels[0].shape[0], GAP_PX, 3), 255, np.uint8)
        row = panels[0]
        for panel in panels[1:]:
            row = np.concatenate([row, gap, panel], axis=1)
        rows.append(row)
    return rows


def label_picture(picture: Array, text: str) -> Array:
    """A copy of a picture with a line of text in its upper left corner."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    draw.rectangle((0, 0, draw.textlength(text) + 8, 14), fill=(255, 255, 255))
    draw.text((4, 2), text, fill=(20, 20, 20))
    return np.asarray(image)


def contact_sheet(views: Sequence[Sequence[Array]], labels: Sequence[str], columns: int = 6) -> Array:
    """One row a view, `columns` moments from start to end."""
    rows = []
    for view, text in zip(views, labels, strict=True):
        moments = np.linspace(0, len(view) - 1, columns).round().astype(int)
        pictures = [np.asarray(view[t]) for t in moments]
        pictures[0] = label_picture(pictures[0], text)
        rows.append(np.concatenate(pictures, axis=1))
    return np.concatenate(rows, axis=0)
