"""A step of one's own: `cei-convert --steps=[quiet_start]`. The target waits a quarter of a second before it moves."""

from dataclasses import replace

import numpy as np

from cei_converters.conversion.episode import Recorded
from cei_converters.conversion.steps import OnRecorded

WAIT_S = 0.25


class QuietStart(OnRecorded):
    """Shows the first frame for a while, in every channel, before it goes on; `source_frames` says so in the dataset."""

    def __call__(self, episode: Recorded) -> Recorded:
        """See `OnRecorded`."""
        demonstration = episode.demonstration
        frames = np.arange(len(demonstration))
        wait = np.zeros(round(WAIT_S * demonstration.fps), int)
        return replace(episode, demonstration=demonstration.at(np.concatenate([wait, frames])))
