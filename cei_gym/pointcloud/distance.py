"""Distance from a point to a triangle."""

from cei_gym.compiled import njit


@njit(cache=True, nogil=True, error_model="numpy")
def square_distance(x, y, z, triangles, f):
    """Square of the distance from (x, y, z) to row f of triangles (F, 3, 3), in float64.

    The least of the distances to the edges and, above the face, to the face. Sorting the point into
    a Voronoi region is quicker in theory, but fails on the slivers and collapsed triangles of robots' meshes.
    """
    ax, ay, az = float(triangles[f, 0, 0]), float(triangles[f, 0, 1]), float(triangles[f, 0, 2])
    ux, uy, uz = triangles[f, 1, 0] - ax, triangles[f, 1, 1] - ay, triangles[f, 1, 2] - az  # a to b
    vx, vy, vz = triangles[f, 2, 0] - ax, triangles[f, 2, 1] - ay, triangles[f, 2, 2] - az  # a to c
    px, py, pz = x - ax, y - ay, z - az
    uu = ux * ux + uy * uy + uz * uz
    uv = ux * vx + uy * vy + uz * vz
    vv = vx * vx + vy * vy + vz * vz
    up = ux * px + uy * py + uz * pz
    vp = vx * px + vy * py + vz * pz
    least = min(_to_segment(px, py, pz, ux, uy, uz), _to_segment(px, py, pz, vx, vy, vz))
    least = min(least, _to_segment(px - ux, py - uy, pz - uz, vx - ux, vy - uy, vz - uz))
    s, t, area = up * vv - vp * uv, vp * uu - up * uv, uu * vv - uv * uv
    if s > 0.0 and t > 0.0 and s + t < area:
        s, t = s / area, t / area
        dx, dy, dz = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
        least = min(least, dx * dx + dy * dy + dz * dz)
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _to_segment(px, py, pz, ux, uy, uz):
    """Square of the distance from p to the segment from the origin to u."""
    square = ux * ux + uy * uy + uz * uz
    along = max(0.0, min(1.0, (px * ux + py * uy + pz * uz) / square)) if square > 0.0 else 0.0
    dx, dy, dz = px - along * ux, py - along * uy, pz - along * uz
    return dx * dx + dy * dy + dz * dz
