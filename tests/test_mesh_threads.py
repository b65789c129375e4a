"""Meshes are read in several threads at once, and what a process does with warnings is none of their business."""

import sys
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest

from cei_gym.embodiment.mesh_files import read_mesh
from cei_gym.errors import CEIError

BOX = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def nothing_beside(name: str) -> bytes:
    raise FileNotFoundError(name)


def test_reading_in_threads_leaves_warnings_as_they_were() -> None:
    before, interval = list(warnings.filters), sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            meshes = list(pool.map(lambda _: read_mesh(BOX, "box.obj", nothing_beside), range(3000)))
        assert list(warnings.filters) == before
    finally:
        sys.setswitchinterval(interval)
        warnings.filters[:] = before
    assert all(mesh.content is BOX for mesh in meshes)  # as it is, to MuJoCo


@pytest.mark.parametrize("row", [b"v 1 0 0_1\n", b"v 1 0 0 # a corner\n"])
def test_what_readers_may_take_otherwise_does_not_go_to_mujoco_as_it_is(row: bytes) -> None:
    found = read_mesh(BOX.replace(b"v 1 0 0\n", row), "box.obj", nothing_beside)
    assert found.suffix == ".msh"
    assert len(found.vertices) >= 4


@pytest.mark.parametrize("row", [b"v 1 0 0x2\n", b"v 1 0 nothing\n", b"v 1 0-1\n"])
def test_what_is_no_number_is_refused(row: bytes) -> None:
    with pytest.raises(CEIError, match="cannot be read as OBJ"):
        read_mesh(BOX.replace(b"v 1 0 0\n", row), "box.obj", nothing_beside)
