"""A step that paints pictures: `cei-convert --steps=[grey_pictures]`. What policies see loses its colours, which differ between labs."""

from dataclasses import replace

import numpy as np

from cei_converters.conversion.episode import Retargeted
from cei_converters.conversion.steps import OnRetargeted

LUMA = np.array([0.299, 0.587, 0.114])  # BT.601, as PIL's grey


class GreyPictures(OnRetargeted):
    """Makes the pictures of all cameras grey; the dataset's card and its episodes' records say that they were painted."""

    def __call__(self, episode: Retargeted) -> Retargeted:
        """See `OnRetargeted`."""
        pictures = episode.pictures
        for key in pictures.features:
            grey = np.rint(pictures.decode(key) @ LUMA).astype(np.uint8)
            pictures = pictures.paint(key, np.repeat(grey[..., None], 3, axis=-1))
        return replace(episode, pictures=pictures)
