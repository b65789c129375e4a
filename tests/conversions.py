"""What commands are given and leave, and whether it is the same."""

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from cei_converters import record
from cei_converters.dataset.records import Records


def record_cubes(root: Path, episodes: int, seed: int, *more: str) -> None:
    """`cei-record` a Panda that picks cubes: the dataset `me/<name of its folder>`."""
    options = ["--env=CEI-PickCube-Panda-PandaGripper", f"--episodes={episodes}", f"--seed={seed}"]
    assert record.main([*options, f"--repo_id=me/{root.name}", f"--root={root}", *more]) == 0


def records(root: Path) -> list[dict[str, Any]]:
    """What a dataset says of its episodes."""
    return list(Records(root))


def same(one: Path, other: Path) -> None:
    """Whether datasets are the same but for when and how they were made."""
    files = [sorted(p.relative_to(root) for p in root.rglob("*") if p.is_file()) for root in (one, other)]
    assert files[0] == files[1]
    for file in files[0]:
        a, b = one / file, other / file
        if file.suffix == ".parquet":
            assert pq.read_table(a).equals(pq.read_table(b)), file
        elif file.suffix == ".json":
            contents = [json.loads(path.read_text()) for path in (a, b)]
            for content in contents:
                for name in ("date", "command"):
                    content.get("provenance", {}).pop(name, None)
            assert contents[0] == contents[1], file
        elif file.suffix == ".png":
            assert a.read_bytes() == b.read_bytes(), file
