"""Controls that look at nothing: how often a task succeeds by chance."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from cei_converters.cli import DatasetConfig
from cei_converters.sources.reader import DatasetReader


def blindly(dataset: DatasetConfig, mean: bool, seeds: Iterable[int], length: int) -> list[bool]:
    """Whether what demonstrations do succeeds in episodes of other starts, whatever is there.

    Args:
        dataset: of the demonstrations, which says what they replay in.
        mean: hold the mean of all their actions, instead of replaying the first of them.
        seeds: of the episodes.
        length: most steps of one.
    """
    import gymnasium as gym

    import cei_gym

    cei_gym.register_environments()
    demonstrations = DatasetReader(dataset.repo_id, dataset.root)
    actions = demonstrations.read(0).action
    if mean:
        means = [demonstrations.read(i).action.mean(axis=0) for i in range(len(demonstrations))]
        actions = np.mean(means, axis=0, keepdims=True)
    assert demonstrations.metadata is not None
    environment = demonstrations.metadata.environment
    options: dict[str, Any] = environment.kwargs | {"clouds": False, "max_episode_steps": length}
    env = gym.make(str(environment.id), **options)
    successes: list[bool] = []
    for seed in seeds:
        env.reset(seed=seed)
        t, over, success = 0, False, False
        while not over:
            _, _, success, truncated, _ = env.step(actions[min(t, len(actions) - 1)].astype(np.float32))
            t, over = t + 1, bool(success or truncated)
        successes.append(bool(success))
    env.close()
    return successes
