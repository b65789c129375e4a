"""`meta/cei_episodes.jsonl`: what is known of each episode (seed, quality, ...), a line each, of which memory holds one."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Self, overload

from cei_converters.dataset.metadata import METADATA_PATH, RECORDS_OF_1_0, plain, restore_with
from cei_gym.errors import CEIError
from cei_gym.untrusted import load_json

RECORDS_PATH = "meta/cei_episodes.jsonl"
ROWS = "rows"
"""Field of a record: which episode it is of, by a digest of its joints (`identity`)."""

Record = dict[str, Any]
"""Free-form JSON types by name."""


def fidelity_of(record: Record) -> Record:
    """How faithfully an episode follows, `score` and `parts` in its record; empty if it has none. Datasets of before called it `quality`."""
    found = record.get("fidelity", record.get("quality"))
    return found if isinstance(found, dict) and "parts" in found else {}


def quality_of(record: Record) -> Record:
    """How likely an episode works, `probability` and `by` what that is known; empty if it is not known."""
    found = record.get("quality")
    return found if isinstance(found, dict) and "probability" in found else {}


class Records(Sequence[Record]):
    """The records of a dataset, in the order of its episodes; none if it has no such file. All are checked at once.

    Args:
        root: folder of the dataset.

    Raises:
        CEIError: the file cannot be read, or a line is no JSON object.
    """

    def __init__(self, root: Path) -> None:
        self._path = root / RECORDS_PATH
        self._starts = [0]
        try:
            with self._path.open("rb") as file:
                for index, line in enumerate(file):
                    self._parse(index, line)
                    self._starts.append(self._starts[-1] + len(line))
        except FileNotFoundError:
            pass
        except OSError as error:
            raise CEIError(f"{self._path} cannot be read: {error}.") from error

    def __len__(self) -> int:
        return len(self._starts) - 1

    @overload
    def __getitem__(self, index: int) -> Record: ...
    @overload
    def __getitem__(self, index: slice) -> list[Record]: ...
    def __getitem__(self, index: int | slice) -> Record | list[Record]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        index = range(len(self))[index]
        with self._path.open("rb") as file:
            file.seek(self._starts[index])
            return self._parse(index, file.readline())

    def __iter__(self) -> Iterator[Record]:
        if len(self):
            with self._path.open("rb") as file:
                for index, line in enumerate(file):
                    yield self._parse(index, line)

    def _parse(self, index: int, line: bytes) -> Record:
        where = f"{self._path}, line {index + 1}"
        try:
            record = load_json(line.decode())
        except ValueError as error:  # CEIError and UnicodeDecodeError, too
            raise CEIError(f"{where} cannot be read: {error}; it should be a JSON object.") from error
        if not isinstance(record, dict):
            raise CEIError(f"{where} should be a JSON object.")
        return record


def load_records(root: Path, total_episodes: int) -> Sequence[Record]:
    """Read the records of a dataset, of format 1.0 too, which has them in `meta/cei.json`; none, and a line that says so, where they are not
    as many as its episodes.

    Raises:
        CEIError: as `Records`.
    """
    if (root / RECORDS_PATH).exists() or not (root / METADATA_PATH).is_file():
        found: Sequence[Record] = Records(root)
    else:
        found = load_json((root / METADATA_PATH).read_text()).get(RECORDS_OF_1_0, [])
        if not isinstance(found, list) or not all(isinstance(record, dict) for record in found):
            raise CEIError(f"{root / METADATA_PATH}: {RECORDS_OF_1_0} should be JSON objects.")
    if len(found) in (0, total_episodes):
        return found
    print(
        f"{RECORDS_PATH} of {root} is of {len(found)} episodes, not of its {total_episodes}: ignored. {restore_with(root)}"
    )
    return ()


class RecordWriter:
    """Context manager that writes them, one by one.

    Args:
        root: folder of the dataset.
    """

    def __init__(self, root: Path) -> None:
        (root / RECORDS_PATH).parent.mkdir(parents=True, exist_ok=True)
        self._file = (root / RECORDS_PATH).open("w")

    def __enter__(self) -> Self:
        return self

    def add(self, record: Record) -> None:
        """Append the next episode's."""
        self._file.write(json.dumps(plain(record), allow_nan=False) + "\n")

    def close(self) -> None:
        """Complete the file. May be called more than once."""
        self._file.close()

    def __exit__(self, *_: object) -> None:
        self.close()
