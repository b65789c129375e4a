"""What this project uses of mujoco-menagerie, which ships no types."""

from pathlib import Path

class MenagerieError(Exception): ...

class EntryPoint:
    name: str
    file: str

class Robot:
    name: str
    asset: str
    default_model: str
    entry_names: tuple[str, ...]
    def entry(self, name: str | None = None) -> EntryPoint: ...
    def path(self, cache: Cache | None = None) -> Path: ...

class Cache:
    base_url: str
    root: Path | None
    def is_cached(self, robot: Robot) -> bool: ...

def names() -> list[str]: ...
def get(name: str) -> Robot: ...
