"""A calibration at some temperatures: matrix, offset, and how both depend on parameters whose covariance is known.

The parameters of a calibration are polynomials of the temperature, so that their covariance is one as well: a stack of matrices, that
of T^k at place k.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from . import alignment


class Term(NamedTuple):
    """Parameters with their covariance, and the derivatives of matrix and offset by them. The first length of the derivatives is that
    of the temperatures, or 1 where they do not depend on them; P parameters."""

    #: (n, P, 3, 3), or None where the matrix does not depend on them.
    d_matrix: np.ndarray | None
    #: (n, P, 3), or None where the offset does not depend on them.
    d_offset: np.ndarray | None
    #: (K, P, P), the covariance over T^k.
    covariance: np.ndarray

    def variance(self, t: np.ndarray, matrix: np.ndarray, without_offset: np.ndarray) -> np.ndarray:
        """Variance of `matrix (reading - offset)` by these parameters: the diagonal of J C J^T, (n, 3)."""
        jacobian = np.zeros((1, 3, self.covariance.shape[1]))
        if self.d_matrix is not None:
            jacobian = np.einsum("npij,nj->nip", self.d_matrix, without_offset)
        if self.d_offset is not None:
            jacobian = jacobian - matrix @ np.swapaxes(self.d_offset, 1, 2)
        # All readings at once: products of small matrices, one per reading, are slow.
        rows = np.ascontiguousarray(jacobian).reshape(-1, jacobian.shape[2])
        powers = [np.einsum("mp,mp->m", np.einsum("mp,pq->mq", rows, c), rows).reshape(-1, 3) for c in self.covariance]
        return horner(np.stack(powers), t[:, None])


class State(NamedTuple):
    """`B = matrix (reading - offset)`, nT, with the terms of its uncertainty."""

    #: (n, 3, 3), nT/enT.
    matrix: np.ndarray
    #: (n, 3), enT.
    offset: np.ndarray
    terms: list[Term]

    def turned(self, rotation: np.ndarray, convention: str | None) -> State:
        """The same behind a rotation, which starts from the sensor frame of a convention where one is given, otherwise from that of the matrix."""
        if convention is None:
            terms = [t if t.d_matrix is None else t._replace(d_matrix=rotation @ t.d_matrix) for t in self.terms]
            return State(rotation @ self.matrix, self.offset, terms)
        # Angles that no three axes have between them make no field.
        known = np.where(np.isfinite(self.matrix).all(axis=(1, 2), keepdims=True), self.matrix, np.eye(3))
        frame = alignment.frame_of(convention, known)
        in_frame, inverse = frame @ self.matrix, np.linalg.inv(frame @ known)[:, None]
        terms = []
        for term in self.terms:
            if term.d_matrix is not None:
                # The frame turns so that the matrix stays triangular in it.
                d_matrix = frame[:, None] @ term.d_matrix
                seen = d_matrix @ inverse
                beside = np.tril(seen, -1) if convention == alignment.ROSETTA else np.triu(seen, 1)
                turn = np.swapaxes(beside, -1, -2) - beside
                term = term._replace(d_matrix=rotation @ (d_matrix + turn @ in_frame[:, None]))
            terms.append(term)
        return State(rotation @ in_frame, self.offset, terms)


def horner(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The polynomial of a temperature, coefficients lowest order first: numbers, or arrays that go with the temperatures."""
    found = np.zeros_like(t)
    for coefficient in coefficients[::-1]:
        found = found * t + coefficient
    return found


def constant(covariance: np.ndarray) -> np.ndarray:
    """A covariance that does not depend on the temperature, from the matrix or from variances of independent parameters."""
    return (np.diag(covariance) if covariance.ndim == 1 else covariance)[None]


def over_temperature(covariance: np.ndarray, parameters: list[int], orders: list[int], count: int) -> np.ndarray:
    """The covariance of `count` parameters from that of their coefficients: coefficient i is that of T^orders[i] of parameter
    parameters[i], and several of one order add."""
    found = np.zeros((2 * max(orders) + 1, count, count))
    order, parameter = np.array(orders), np.array(parameters)
    np.add.at(found, (order[:, None] + order, parameter[:, None], parameter[None, :]), covariance)
    return found
