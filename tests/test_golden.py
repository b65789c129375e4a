"""`scripts/golden compare` names what differs between two sets of datasets, and nothing that only says when they were made."""

import json
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

SCRIPT = Path(__file__).parents[1] / "scripts/golden"


def write(
    folder: Path, action: float = 0.5, quality: float = 0.9, date: str = "today", picture: bytes = b"png"
) -> None:
    (folder / "new/data").mkdir(parents=True)
    pq.write_table(pa.table({"action": [[0.0, action]], "index": [0]}), folder / "new/data/file.parquet")
    (folder / "new.json").write_text(json.dumps({"results": [{"quality": quality}], "date": date, "root": str(folder)}))
    (folder / "new/quality.png").write_bytes(picture)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"date": "tomorrow"}, ["The same, bit for bit."]),
        ({"action": 0.75}, ["new/data/file.parquet: column action differs by up to 0.25"]),
        ({"quality": 0.8}, ["new.json: .results[0].quality: 0.9 became 0.8"]),
        ({"picture": b"gnp"}, ["new/quality.png: other bytes"]),
    ],
)
def test_differences_are_named(change: dict, said: list[str], tmp_path: Path) -> None:
    write(tmp_path / "old")
    write(tmp_path / "new", **change)
    command = [sys.executable, str(SCRIPT), "compare", str(tmp_path / "old"), str(tmp_path / "new")]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.stdout.splitlines() == said
    assert result.returncode == (said != ["The same, bit for bit."])
