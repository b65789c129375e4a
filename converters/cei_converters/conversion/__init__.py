"""A conversion in shards: planned once, each shard converted anywhere in any order, put together, published by one rename."""

from cei_gym import extras

extras.require(__name__, "lerobot")
