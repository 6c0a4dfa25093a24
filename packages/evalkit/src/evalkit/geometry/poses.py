"""Rigid transforms as (..., 4, 4) arrays and rotations as (..., 3, 3) arrays, batch first, float64.

A transform is named for what it maps: ``cam_from_obj @ points_in_obj``. Quaternions are xyzw.

:func:`compose`, :func:`apply` and all that make rotations add in a fixed order and call no BLAS, whose kernels differ
in the last bits from one processor to another: a pile of parts would end elsewhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
MAX_SWEEPS = 50  # of Jacobi's rotations; five or so are needed


def from_rotation_translation(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Rotation (..., 3, 3) and translation (..., 3) to a transform (..., 4, 4)."""
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    batch = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    pose = np.zeros((*batch, 4, 4))
    pose[..., :3, :3] = rotation
    pose[..., :3, 3] = translation
    pose[..., 3, 3] = 1.0
    return pose


def invert(pose: ArrayLike) -> Array:
    """Inverse of rigid transforms (..., 4, 4)."""
    pose = np.asarray(pose, float)
    rotation_t = np.swapaxes(pose[..., :3, :3], -1, -2)
    return from_rotation_translation(rotation_t, -np.einsum("...ij,...j->...i", rotation_t, pose[..., :3, 3]))


def compose(a_from_b: ArrayLike, b_from_c: ArrayLike) -> Array:
    """The products (..., n, m) of matrices (..., n, k) and (..., k, m): of transforms, or of rotations."""
    return np.asarray(np.einsum("...ij,...jk->...ik", np.asarray(a_from_b, float), np.asarray(b_from_c, float)))


def apply(pose: ArrayLike, points: ArrayLike) -> Array:
    """Transform points: pose (..., 4, 4), points (..., n, 3) -> (..., n, 3)."""
    pose, points = np.asarray(pose, float), np.asarray(points, float)
    columns = pose[..., None, :3, :]
    moved = points[..., 0:1] * columns[..., 0]
    moved += points[..., 1:2] * columns[..., 1]
    moved += points[..., 2:3] * columns[..., 2]
    return np.asarray(moved + columns[..., 3])


def rotation_angle(rotation_a: ArrayLike, rotation_b: ArrayLike) -> Array:
    """Angle in radians between rotations (..., 3, 3); accurate near 0 and near pi."""
    relative = np.swapaxes(np.asarray(rotation_a, float), -1, -2) @ np.asarray(rotation_b, float)
    sine = np.linalg.norm(relative - np.swapaxes(relative, -1, -2), axis=(-2, -1)) / np.sqrt(8.0)
    cosine = (np.trace(relative, axis1=-2, axis2=-1) - 1.0) / 2.0
    return np.asarray(np.arctan2(sine, cosine))


def is_rotation(matrix: ArrayLike, tolerance: float = 1e-3) -> NDArray[np.bool_]:
    """Whether matrices (..., 3, 3) are finite, orthonormal to `tolerance`, and proper (determinant +1)."""
    matrix = np.asarray(matrix, float)
    finite = np.isfinite(matrix).all(axis=(-2, -1))
    safe = np.where(finite[..., None, None], matrix, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        gram = safe @ np.swapaxes(safe, -1, -2)
        orthonormal = (np.abs(gram - np.eye(3)) <= tolerance).all(axis=(-2, -1))
        return finite & orthonormal & (np.linalg.det(safe) > 0)


def nearest_rotation(matrix: ArrayLike) -> Array:
    """The proper rotations (..., 3, 3) closest in the Frobenius norm: mends rounding in files.

    U V^T of the singular vectors, the third of each completing the other two to a proper rotation (Umeyama 1991). By
    Jacobi's rotations of the columns (Hestenes 1958), for LAPACK's last bits depend on the processor.
    """
    matrix = np.asarray(matrix, float)
    left = np.array(matrix.reshape(-1, 3, 3).T, order="C")  # (column, component, n): becomes U times the lengths
    right = np.array(np.broadcast_to(np.eye(3)[..., None], left.shape), order="C")
    for _ in range(MAX_SWEEPS):
        turns = [_orthogonalize(left, right, p, q) for p, q in ((0, 1), (0, 2), (1, 2))]
        if not any(turns):
            break
    longest = np.argsort(-(left * left).sum(1), axis=0, kind="stable")[:2, None]
    left, right = np.take_along_axis(left, longest, 0), np.take_along_axis(right, longest, 0)
    u = _unit(left[0], np.eye(3)[:, :1])
    normal = np.cross(u, np.eye(3)[:, np.abs(u).argmin(0)], axis=0)  # where the second length vanishes any will do
    w = _unit(left[1], normal / np.sqrt((normal * normal).sum(0)))
    pairs = zip((u, w, np.cross(u, w, axis=0)), (*right, np.cross(right[0], right[1], axis=0)), strict=True)
    first, second, third = (one[:, None] * other for one, other in pairs)
    return np.asarray(np.moveaxis(first + second + third, -1, 0).reshape(matrix.shape))


def _orthogonalize(left: Array, right: Array, p: int, q: int) -> bool:
    """Turn columns p and q of both (3, 3, n), in place, until those of `left` are orthogonal; False where all are."""
    square, other, product = ((left[i] * left[j]).sum(0) for i, j in ((p, p), (q, q), (p, q)))
    oblique = np.abs(product) > 1e-15 * np.sqrt(square * other)
    if not oblique.any():
        return False
    theta = (other - square) / (2 * np.where(oblique, product, 1.0))
    tangent = np.where(oblique, np.copysign(1.0, theta) / (np.abs(theta) + np.sqrt(theta * theta + 1)), 0.0)
    cosine = 1 / np.sqrt(tangent * tangent + 1)
    sine = tangent * cosine
    for columns in (left, right):
        columns[p], columns[q] = cosine * columns[p] - sine * columns[q], sine * columns[p] + cosine * columns[q]
    return True


def _unit(vectors: Array, otherwise: Array) -> Array:
    """Vectors (3, n) of unit length; `otherwise` (3, n) where they vanish."""
    length = np.sqrt((vectors * vectors).sum(0))
    return np.asarray(np.where(length == 0, otherwise, vectors / np.where(length == 0, 1.0, length)))


def from_axis_angle(axis: ArrayLike, angle: ArrayLike) -> Array:
    """Rotations (..., 3, 3) about unit axes (..., 3) by angles (...) in radians (Rodrigues)."""
    direction, turn = np.array(axis, float), np.asarray(angle, float)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    batch = np.broadcast_shapes(direction.shape[:-1], turn.shape)
    x, y, z = np.moveaxis(np.broadcast_to(direction, (*batch, 3)), -1, 0)
    zero = np.zeros(batch)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*batch, 3, 3)
    sine, cosine = np.sin(turn)[..., None, None], np.cos(turn)[..., None, None]
    return np.asarray(np.eye(3) + sine * cross + (1.0 - cosine) * compose(cross, cross))


def from_quaternion_xyzw(quaternion: ArrayLike) -> Array:
    """Quaternions (..., 4) in x, y, z, w order, of any non-zero norm, to rotations (..., 3, 3)."""
    q = np.asarray(quaternion, float)
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(rows, -1).reshape(*q.shape[:-1], 3, 3)


def to_quaternion_xyzw(rotation: ArrayLike) -> Array:
    """Unit quaternions (..., 4) in x, y, z, w order, w >= 0, of rotations (..., 3, 3)."""
    from scipy.spatial.transform import Rotation  # slow to import, and nothing else here needs it

    quaternion = np.asarray(Rotation.from_matrix(np.asarray(rotation, float)).as_quat())
    return np.where(quaternion[..., 3:] < 0, -quaternion, quaternion)


def random_rotations(rng: np.random.Generator, count: int) -> Array:
    """`count` rotations (count, 3, 3), uniform over SO(3)."""
    return from_quaternion_xyzw(rng.standard_normal((count, 4)))


def rotation_between(source: ArrayLike, target: ArrayLike) -> Array:
    """The smallest rotations (..., 3, 3) that turn unit vectors `source` (..., 3) into `target` (..., 3).

    For opposite vectors, where the axis is free, half a turn about an axis normal to `source`.
    """
    a, b = np.broadcast_arrays(np.asarray(source, float), np.asarray(target, float))
    axis = np.cross(a, b)
    sine, cosine = np.linalg.norm(axis, axis=-1), (a * b).sum(-1)
    least = np.eye(3)[np.abs(a).argmin(-1)]
    normal = np.cross(a, least)
    axis = np.where((sine < 1e-12)[..., None], normal, axis)
    return from_axis_angle(axis, np.arctan2(sine, cosine))
