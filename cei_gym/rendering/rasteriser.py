"""A z-buffer in compiled loops: inverse depth and geom id of the nearest triangle at every pixel centre."""

import numpy as np

from cei_gym.compiled import njit


@njit(cache=True, nogil=True)
def rasterise(
    vertices,
    caps,
    faces,
    vertex_range,
    face_range,
    one_sided,
    geom_id,
    scale,
    shift,
    R_camera_geom,
    p_camera_geom,
    intrinsics,
    near_m,
    inverse_depth,
    id_image,
):
    """Draws G geoms into both images, in place.

    Args:
        vertices, caps, faces, vertex_range, face_range, one_sided, geom_id: see `triangles.Triangles`.
        scale, shift: (G, 3) and (G,) metres, see `shapes`.
        R_camera_geom, p_camera_geom: (G, 3, 3) and (G, 3) poses in the camera's OpenCV frame, metres.
        intrinsics: fx, fy, cx, cy in pixels; integer coordinates are pixel centres.
        near_m: nearer parts of triangles are cut away.
        inverse_depth: (H, W) float64, 1/m, 0 where nothing was drawn.
        id_image: (H, W) int32, geom id.
    """
    fx, fy, cx, cy = intrinsics
    most = 0
    for g in range(len(geom_id)):
        most = max(most, vertex_range[g, 1] - vertex_range[g, 0])
    xyz = np.empty((most, 3))  # camera frame, metres
    uvw = np.empty((most, 3))  # pixel coordinates and inverse depth
    for g in range(len(geom_id)):
        first = vertex_range[g, 0]
        count = vertex_range[g, 1] - first
        R = R_camera_geom[g]
        p = p_camera_geom[g]
        if _outside(_radius(vertices, caps, first, count, scale[g], shift[g]), p, intrinsics, near_m, id_image.shape):
            continue
        for i in range(count):
            a = scale[g, 0] * vertices[first + i, 0]
            b = scale[g, 1] * vertices[first + i, 1]
            c = scale[g, 2] * vertices[first + i, 2] + shift[g] * caps[first + i]
            x = R[0, 0] * a + R[0, 1] * b + R[0, 2] * c + p[0]
            y = R[1, 0] * a + R[1, 1] * b + R[1, 2] * c + p[1]
            z = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c + p[2]
            xyz[i, 0], xyz[i, 1], xyz[i, 2] = x, y, z
            w = 1.0 / z if z >= near_m else 0.0  # 0 marks a vertex in front of the near plane
            uvw[i, 0], uvw[i, 1], uvw[i, 2] = fx * x * w + cx, fy * y * w + cy, w
        for f in range(face_range[g, 0], face_range[g, 1]):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            hidden = (uvw[i, 2] == 0.0) + (uvw[j, 2] == 0.0) + (uvw[k, 2] == 0.0)
            if hidden == 0:
                _draw(uvw, i, j, k, one_sided[g], geom_id[g], inverse_depth, id_image)
            elif hidden < 3:
                corners = _clip(xyz[i], xyz[j], xyz[k], intrinsics, near_m)
                for c in range(1, len(corners) - 1):
                    _draw(corners, 0, c, c + 1, one_sided[g], geom_id[g], inverse_depth, id_image)


@njit(cache=True, nogil=True)
def _radius(vertices, caps, first, count, scale, shift):
    """Radius of the geom's bounding sphere about its origin, metres."""
    square = 0.0
    for i in range(first, first + count):
        a = scale[0] * vertices[i, 0]
        b = scale[1] * vertices[i, 1]
        c = scale[2] * vertices[i, 2] + shift * caps[i]
        square = max(square, a * a + b * b + c * c)
    return np.sqrt(square)


@njit(cache=True, nogil=True)
def _outside(radius, p, intrinsics, near_m, shape):
    """Whether a sphere at p (camera frame) misses the view."""
    fx, fy, cx, cy = intrinsics
    if p[2] + radius < near_m:
        return True
    for axis, focal, low, high in (
        (0, fx, cx + 0.5, shape[1] - 0.5 - cx),
        (1, fy, cy + 0.5, shape[0] - 0.5 - cy),
    ):
        if focal * p[axis] + low * p[2] < -radius * np.hypot(focal, low):
            return True
        if -focal * p[axis] + high * p[2] < -radius * np.hypot(focal, high):
            return True
    return False


@njit(cache=True, nogil=True)
def _clip(a, b, c, intrinsics, near_m):
    """(3 or 4, 3) corners (u, v, 1/z) of what the near plane leaves of a triangle in the camera's frame."""
    fx, fy, cx, cy = intrinsics
    corners = np.empty((4, 3))
    count = 0
    for start, end in ((a, b), (b, c), (c, a)):
        if start[2] >= near_m:
            w = 1.0 / start[2]
            corners[count] = (fx * start[0] * w + cx, fy * start[1] * w + cy, w)
            count += 1
        if (start[2] >= near_m) != (end[2] >= near_m):
            t = (near_m - start[2]) / (end[2] - start[2])
            w = 1.0 / near_m
            x = start[0] + t * (end[0] - start[0])
            y = start[1] + t * (end[1] - start[1])
            corners[count] = (fx * x * w + cx, fy * y * w + cy, w)
            count += 1
    return corners[:count]


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(corners, a, b, c, one_sided, geom, inverse_depth, id_image):
    """Draws a triangle between rows a, b, c of (u, v, 1/z) corners; inverse depth is affine in the image."""
    au, av, aw = corners[a, 0], corners[a, 1], corners[a, 2]
    bu, bv, bw = corners[b, 0], corners[b, 1], corners[b, 2]
    cu, cv, cw = corners[c, 0], corners[c, 1], corners[c, 2]
    area = (cu - au) * (bv - av) - (cv - av) * (bu - au)  # positive for a front: y points down
    if area == 0.0 or (area < 0.0 and one_sided):
        return
    height, width = id_image.shape
    left = np.ceil(max(0.0, min(au, bu, cu)))
    right = np.floor(min(width - 1.0, max(au, bu, cu)))
    if left > right:
        return
    top = np.ceil(max(0.0, min(av, bv, cv)))
    bottom = np.floor(min(height - 1.0, max(av, bv, cv)))
    scale = 1.0 / area
    for y in range(int(top), int(bottom) + 1):
        for x in range(int(left), int(right) + 1):
            to_a = ((bu - cu) * (y - cv) - (bv - cv) * (x - cu)) * scale
            to_b = ((cu - au) * (y - av) - (cv - av) * (x - au)) * scale
            to_c = ((au - bu) * (y - bv) - (av - bv) * (x - bu)) * scale
            if to_a >= 0.0 and to_b >= 0.0 and to_c >= 0.0:
                w = to_a * aw + to_b * bw + to_c * cw
                if w > inverse_depth[y, x]:
                    inverse_depth[y, x] = w
                    id_image[y, x] = geom
