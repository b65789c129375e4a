"""Triangles of several links sorted into cubic cells, to ask whether a point is near one of them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.pointcloud.distance import square_distance

_MOST_CELLS = 8_000_000  # 32 MB


class TriangleGrid(NamedTuple):
    """F triangles of L links, in a dense grid of cells a link.

    Attributes:
        triangles: (F, 3, 3) float32 corners in their link's frame, metres.
        cell_m: edge of a cell.
        origin: (L, 3) lower corner of each link's grid in its frame, metres.
        count: (L, 3) int64 cells along each axis.
        first_cell: (L,) int64 number of the first cell of each link.
        start: (cells + 1,) int64 first entry of each cell.
        entry: (entries,) int32 triangles that pass through a cell, cell after cell.
    """

    triangles: Array
    cell_m: float
    origin: Array
    count: Array
    first_cell: Array
    start: Array
    entry: Array


def build(triangles_of_links: Sequence[Array], reach_m: float) -> TriangleGrid:
    """Sorts triangles so that points up to `reach_m` away from them fall into the grid.

    Args:
        triangles_of_links: L arrays (F_l, 3, 3) in link frames, metres; an array may be empty.
        reach_m: largest distance that will be asked about, metres.
    """
    links = len(triangles_of_links)
    triangles = np.concatenate([np.empty((0, 3, 3)), *triangles_of_links]).astype(np.float32)
    link = np.repeat(np.arange(links), [len(part) for part in triangles_of_links])
    origin, extent = np.zeros((links, 3)), np.zeros((links, 3))
    for i, part in enumerate(triangles_of_links):
        if len(part):
            origin[i] = part.min(axis=(0, 1)) - reach_m
            extent[i] = part.max(axis=(0, 1)) + reach_m - origin[i]
    cell_m = max(reach_m, float((extent.prod(axis=1).sum() / _MOST_CELLS) ** (1 / 3)))
    count = np.ceil(extent / cell_m).astype(np.int64)
    ends = np.cumsum(count.prod(axis=1))
    first_cell = np.concatenate([[0], ends[:-1]]).astype(np.int64)
    start = np.zeros(int(ends[-1]) + 1 if links else 1, dtype=np.int64)
    unsorted = TriangleGrid(triangles, cell_m, origin, count, first_cell, start, np.empty(0, dtype=np.int32))
    _sort(unsorted, link, start[1:], False)
    np.cumsum(start, out=start)
    entry = np.empty(start[-1], dtype=np.int32)
    _sort(unsorted._replace(entry=entry), link, start[:-1].copy(), True)
    return unsorted._replace(entry=entry)


@njit(cache=True, nogil=True)
def _sort(grid, link, cursor, write):
    """Moves a cell's cursor on by one for every triangle through the cell; with `write`, notes it there."""
    reach = 0.8661 * grid.cell_m  # half a cell's diagonal, rounded up
    for f in range(len(link)):
        i = link[f]
        a, b, c = grid.triangles[f, 0], grid.triangles[f, 1], grid.triangles[f, 2]
        low, high = np.empty(3, np.int64), np.empty(3, np.int64)  # the cells of its bounding box
        for axis in range(3):
            least, most = min(a[axis], b[axis], c[axis]), max(a[axis], b[axis], c[axis])
            low[axis] = (least - grid.origin[i, axis]) / grid.cell_m
            high[axis] = (most - grid.origin[i, axis]) / grid.cell_m
        box = (high[0] - low[0] + 1) * (high[1] - low[1] + 1) * (high[2] - low[2] + 1)
        for x in range(low[0], high[0] + 1):
            for y in range(low[1], high[1] + 1):
                for z in range(low[2], high[2] + 1):
                    if box > 8:  # a large triangle misses most cells of its bounding box
                        u = grid.origin[i, 0] + (x + 0.5) * grid.cell_m
                        v = grid.origin[i, 1] + (y + 0.5) * grid.cell_m
                        w = grid.origin[i, 2] + (z + 0.5) * grid.cell_m
                        if square_distance(u, v, w, grid.triangles, f) > reach * reach:
                            continue
                    cell = grid.first_cell[i] + (x * grid.count[i, 1] + y) * grid.count[i, 2] + z
                    if write:
                        grid.entry[cursor[cell]] = f
                    cursor[cell] += 1


@njit(cache=True, nogil=True)
def mark_near(grid, points_world, R_link_world, p_link_world, reach_m, near):
    """Sets near (N,) where a triangle of any link is within `reach_m`; NaN and infinity are near nothing.

    R_link_world (L, 3, 3) and p_link_world (L, 3), metres, take the points (N, 3) into link frames.
    """
    start, entry, triangles = grid.start, grid.entry, grid.triangles
    cells, reach = 1.0 / grid.cell_m, reach_m / grid.cell_m
    links, centre, square_radius = _spheres(grid, R_link_world, p_link_world)
    for n in range(len(points_world)):
        a, b, c = points_world[n, 0], points_world[n, 1], points_world[n, 2]
        for k in range(len(links)):
            dx, dy, dz = a - centre[k, 0], b - centre[k, 1], c - centre[k, 2]
            if not dx * dx + dy * dy + dz * dz <= square_radius[k]:
                continue
            link = links[k]
            R = R_link_world[link]
            p = p_link_world[link]
            x0, y0, z0 = grid.origin[link, 0], grid.origin[link, 1], grid.origin[link, 2]
            nx, ny, nz = grid.count[link, 0], grid.count[link, 1], grid.count[link, 2]
            x = R[0, 0] * a + R[0, 1] * b + R[0, 2] * c + p[0]
            y = R[1, 0] * a + R[1, 1] * b + R[1, 2] * c + p[1]
            z = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c + p[2]
            u, v, w = (x - x0) * cells, (y - y0) * cells, (z - z0) * cells
            if not (0.0 <= u < nx and 0.0 <= v < ny and 0.0 <= w < nz):
                continue
            # A point on the robot nearly always has a triangle in its own cell.
            first = grid.first_cell[link]
            cell = first + (int(u) * ny + int(v)) * nz + int(w)
            near[n] = _any_within(start, entry, triangles, cell, cell, x, y, z, reach_m)
            for i in range(int(max(0.0, u - reach)), int(min(nx - 1.0, u + reach)) + 1):
                for j in range(int(max(0.0, v - reach)), int(min(ny - 1.0, v + reach)) + 1):
                    if near[n]:
                        break
                    row = first + (i * ny + j) * nz
                    low, high = row + int(max(0.0, w - reach)), row + int(min(nz - 1.0, w + reach))
                    near[n] = _any_within(start, entry, triangles, low, high, x, y, z, reach_m)
            if near[n]:
                break


@njit(cache=True, nogil=True)
def _spheres(grid, R_link_world, p_link_world):
    """The links that have cells, and a sphere around those in the world: centre (K, 3), m, and squared radius (K,)."""
    links = np.flatnonzero(grid.count[:, 0] * grid.count[:, 1] * grid.count[:, 2] > 0)
    centre, square_radius = np.empty((len(links), 3)), np.empty(len(links))
    for k in range(len(links)):
        half = 0.5 * grid.cell_m * grid.count[links[k]]
        square_radius[k] = (half**2).sum() * (1.0 + 1e-9)
        middle = grid.origin[links[k]] + half - p_link_world[links[k]]
        for axis in range(3):
            centre[k, axis] = (R_link_world[links[k], :, axis] * middle).sum()
    return links, centre, square_radius


@njit(cache=True, nogil=True)
def _any_within(start, entry, triangles, low, high, x, y, z, reach_m):
    """Whether a triangle in the cells from low to high, both included, is within reach."""
    for e in range(start[low], start[high + 1]):
        if square_distance(x, y, z, triangles, entry[e]) <= reach_m * reach_m:
            return True
    return False
