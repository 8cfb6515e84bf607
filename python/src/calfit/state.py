"""A calibration at some temperatures: matrix, offset, and how both depend on parameters whose covariance is known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Term(NamedTuple):
    """Parameters with their covariance, and the derivatives of matrix and offset by them. The first length is that of the
    temperatures, or 1 where nothing depends on them; P parameters."""

    #: (n, P, 3, 3), or None where the matrix does not depend on them.
    d_matrix: np.ndarray | None
    #: (n, P, 3), or None where the offset does not depend on them.
    d_offset: np.ndarray | None
    #: (n, P, P).
    covariance: np.ndarray

    def variance(self, matrix: np.ndarray, without_offset: np.ndarray, rotation: np.ndarray | None) -> np.ndarray:
        """Variance of `matrix (reading - offset)` by these parameters: the diagonal of J C J^T, (n, 3)."""
        jacobian: np.ndarray | float = 0.0
        if self.d_matrix is not None:
            by_matrix = self.d_matrix @ without_offset[:, None, :, None]
            jacobian = np.swapaxes(by_matrix[..., 0], 1, 2)
        if self.d_offset is not None:
            jacobian = jacobian - matrix @ np.swapaxes(self.d_offset, 1, 2)
        if rotation is not None:
            jacobian = rotation @ jacobian
        return ((jacobian @ self.covariance) * jacobian).sum(axis=2)


class State(NamedTuple):
    """`B = matrix (reading - offset)`, nT, with the terms of its uncertainty."""

    #: (n, 3, 3), nT/enT.
    matrix: np.ndarray
    #: (n, 3), enT.
    offset: np.ndarray
    terms: list[Term]


def horner(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The polynomial of a temperature, coefficients lowest order first."""
    found = np.zeros_like(t)
    for coefficient in coefficients[::-1]:
        found = found * t + coefficient
    return found


def powers(t: np.ndarray, count: int) -> np.ndarray:
    """(1, T, T^2, ...), shape (n, count)."""
    return t[:, None] ** np.arange(count)


def diagonal(variances: np.ndarray) -> np.ndarray:
    """Matrices with these diagonals: (..., P) to (..., P, P)."""
    return variances[..., None] * np.eye(variances.shape[-1])
