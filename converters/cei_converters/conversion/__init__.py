"""A conversion in shards: planned once, each shard converted anywhere in any order, put together, published by one rename."""
