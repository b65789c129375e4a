"""Replaying some of the demonstrations that were made for each anchor."""

from collections import Counter
from typing import Any

import numpy as np

from cei_converters.benchmark.anchors_stages import AnchorStages, Place
from cei_converters.benchmark.policy_stages import repo_id
from cei_converters.cli import DatasetConfig
from cei_converters.replay import ReplayConfig, replay

NAME = "anchors_replay.json"


def settings(stages: AnchorStages, count: int) -> dict[str, Any]:
    """What a finished replay must have been made with to count."""
    return stages.made_with | {"replayed": count}


def replay_anchors(stages: AnchorStages, count: int) -> dict[str, Any]:
    """Replay `count` of what was made for each anchor, spread over its grid.

    Returns:
        `made`, how many there are of each anchor, in order; `base_m` of the robot; `episodes`, with their anchor, place, success and failure.

    Raises:
        CEIError: as `replay`.
    """
    places = stages.places()
    chosen = [place for anchor in stages.anchors for place in _spread(places, anchor.number, count)]
    root = stages.converted(stages.anchors[0])
    said = ",".join(str(place.episode) for place in chosen)
    replayed = replay(ReplayConfig(DatasetConfig(repo_id(root), root), episodes=said, video_episodes=0))
    made = Counter(place.anchor for place in places)
    entries = [
        {"anchor": place.anchor, "x_m": place.x_m, "y_m": place.y_m}
        | {name: entry[name] for name in ("success", "failure")}
        for place, entry in zip(chosen, replayed["results"], strict=True)
    ]
    return {"made": [made[a.number] for a in stages.anchors], "base_m": stages.base_m, "episodes": entries}


def _spread(places: list[Place], anchor: int, count: int) -> list[Place]:
    """At most `count` of an anchor's places, from its first to its last."""
    own = [place for place in places if place.anchor == anchor]
    chosen = np.unique(np.linspace(0, len(own) - 1, count).round().astype(int)) if own else []
    return [own[i] for i in chosen]
