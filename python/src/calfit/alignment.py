"""Angles between three directions, and the matrix omega that each of the two conventions makes of them (BC-MAG-TR-0085 section 15.1,
RO-IGEP-TR0028 section 3.3)."""

from __future__ import annotations

import numpy as np

BEPICOLOMBO = "bepicolombo"
ROSETTA = "rosetta"

#: What a file may call its omega, and the formula that belongs to it.
FORMULA = {BEPICOLOMBO: "omega = inverse(transpose(Q(xi)))", ROSETTA: "omega = Q(xi)"}
#: The same with the transfer to the centre of the coil system behind it.
FORMULA_WITH_K = "omega = Q(xi) inverse(K), the rows of inverse(K) are K_0, K_1, K_2"
Q_FORMULA = "Q = [[1, cos(xy), cos(xz)], [0, sin(xy), q], [0, 0, sqrt(sin(xz)^2 - q^2)]], q = (cos(yz) - cos(xy) cos(xz)) / sin(xy)"


def base_vectors(xi_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`Q(xi)` and its derivatives per degree of xy, xz, yz, for angles in degrees along the last axis.

    The columns of Q are three unit vectors with these angles between them, the first along x, the second in the plane of x and y.
    Shapes (..., 3, 3) and (..., 3, 3, 3). Angles that no three directions have between them give nan.
    """
    xy, xz, yz = np.moveaxis(np.radians(np.asarray(xi_deg, dtype=np.float64)), -1, 0)
    cxy, sxy, cxz, sxz, cyz, syz = np.cos(xy), np.sin(xy), np.cos(xz), np.sin(xz), np.cos(yz), np.sin(yz)
    with np.errstate(invalid="ignore", divide="ignore"):
        middle = (cyz - cxy * cxz) / sxy
        square = sxz**2 - middle**2
        height = np.sqrt(np.where(square > 0.0, square, np.nan))
        q = np.zeros((*xy.shape, 3, 3))
        q[..., 0, 0] = 1.0
        q[..., 0, 1], q[..., 1, 1] = cxy, sxy
        q[..., 0, 2], q[..., 1, 2], q[..., 2, 2] = cxz, middle, height
        # Derivatives of `middle` by the three angles; `height` follows from sin(xz)^2 - middle^2.
        middle_by = (cxz - middle * cxy / sxy, cxy * sxz / sxy, -syz / sxy)
        by = np.zeros((*xy.shape, 3, 3, 3))
        by[..., 0, 0, 1], by[..., 0, 1, 1] = -sxy, cxy
        by[..., 1, 0, 2] = -sxz
        for k, change in enumerate(middle_by):
            square_by = (2.0 * sxz * cxz if k == 1 else 0.0) - 2.0 * middle * change
            by[..., k, 1, 2] = change
            by[..., k, 2, 2] = square_by / (2.0 * height)
    return q, np.radians(by)


def omega(convention: str, xi_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`omega(xi)` of a convention and its derivatives per degree; shapes as of :func:`base_vectors`."""
    q, by = base_vectors(xi_deg)
    if convention == ROSETTA:
        return q, by
    # Inverse and transpose of a triangular matrix with unit first element, written out: exact where numbers are not finite as well.
    inverse = _inverse_upper(q)
    found = np.swapaxes(inverse, -1, -2)
    # d(X^-T) = -X^-T dX^T X^-T.
    around = found[..., None, :, :]
    return found, -around @ np.swapaxes(by, -1, -2) @ around


def _inverse_upper(q: np.ndarray) -> np.ndarray:
    a, b, c = q[..., 0, 1], q[..., 0, 2], q[..., 1, 2]
    d, e = q[..., 1, 1], q[..., 2, 2]
    inverse = np.zeros_like(q)
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse[..., 0, 0] = 1.0
        inverse[..., 1, 1], inverse[..., 2, 2] = 1.0 / d, 1.0 / e
        inverse[..., 0, 1] = -a / d
        inverse[..., 1, 2] = -c / (d * e)
        inverse[..., 0, 2] = (a * c - b * d) / (d * e)
    return inverse


def frame_of(convention: str, matrix: np.ndarray) -> np.ndarray:
    """The rotations from the frame of matrices that take readings to the field to the sensor frame of a convention, (n, 3, 3): the same
    sensor has a lower triangular matrix there (BepiColombo), or an upper triangular one (Rosetta)."""
    columns = matrix if convention == ROSETTA else np.swapaxes(np.linalg.inv(matrix), -1, -2)
    first, second = columns[..., 0], columns[..., 1]
    x = first / np.linalg.norm(first, axis=-1, keepdims=True)
    y = second - x * (x * second).sum(axis=-1, keepdims=True)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-2)


#: What the rows of a rotation may miss of right angles and of the length 1.
_ROUNDING = 1e-6


def is_rotation(matrix: np.ndarray) -> bool:
    """Whether a matrix is a proper rotation, but for rounding."""
    orthogonal = np.abs(matrix @ matrix.T - np.eye(3)).max() < _ROUNDING
    return bool(orthogonal and np.linalg.det(matrix) > 0.0)
