"""What takes readings to a field: the calibration of a run (CPF), polynomials of the temperature (TPF, TCF), a ground calibration
file (RPCMAG); and offsets that stand in a file of their own (TOF, OPF).

Each checks its file when it is made. `at(t, frame)` gives the calibration at temperatures, `unknown` names the parameters that the file
gives no uncertainty for, `ranges` the temperatures for which it holds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from . import alignment
from .document import Document
from .kinds import AXES, PAIRS
from .quantities import covariance_table, stated_covariance, stated_std
from .state import State, Term, diagonal, horner, powers
from .steps import Applied

#: Printed matrices have six decimals and printed angles full seconds of arc (5e-6); a turned sign of a misalignment is far above.
_PRINTED = 1e-5
_CORRECT = "correct the file, or fit again"


class Range(NamedTuple):
    """Temperatures for which a file holds, degC."""

    file: str
    key: str
    low: float
    high: float


def _range(document: Document, key: str) -> Range:
    low, high = document.needed(key, (2,))
    if low > high:
        raise document.refuse(key, "must rise")
    return Range(document.file, key, float(low), float(high))


def _positive(document: Document, key: str, sigma: np.ndarray) -> None:
    if not (sigma > 0.0).all():
        raise document.refuse(key, "must be positive")


def _directions(document: Document, key: str, xi_deg: np.ndarray) -> None:
    """Angles, degrees, that three directions can have between them."""
    if not np.isfinite(alignment.base_vectors(xi_deg)[0]).all():
        raise document.refuse(key, "no three directions have such angles between them")


class RunCalibration:
    """The calibration of one run, CPF. It needs no temperature."""

    needs_temperature = False

    def __init__(self, document: Document, how: Applied) -> None:
        self.document = document
        self.how = how
        assert how.convention is not None
        self._convention = how.convention
        self._matrices()
        self._linearisation()
        self._uncertainty()
        self.ranges = self._ranges()
        limits = document.numbers("valid.field_coil_nt", (3, 2))
        #: Largest field per coil axis that was calibrated, nT.
        self.field_limit_coil_nt = None if limits is None or not how.to_coil else np.abs(limits).max(axis=1)

    def _matrices(self) -> None:
        document = self.document
        stated = document.needed("matrix.sigma", (3, 3))
        self.sigma = np.diagonal(stated)
        if (stated != np.diag(self.sigma)).any():
            raise document.refuse("matrix.sigma", "must be diagonal")
        _positive(document, "matrix.sigma", self.sigma)
        xi = np.array([float(document.needed(f"angle_deg.xi_{pair}", ())) for pair in PAIRS])
        _directions(document, "angle_deg", xi)
        self.omega, self.omega_by = alignment.omega(self._convention, xi)
        #: omega sigma.
        self.transfer = self.omega * self.sigma
        self.b_or = document.needed("offset.b_or_ent", (3,))
        self._same("matrix.omega", self.omega, f"is not that of the angles in the convention {self._convention}")
        self._same("matrix.phi_tilde", self.transfer, "is not omega sigma")
        #: R_nom rho, from the sensor frame to coil axes.
        self.rotation = None
        if self.how.to_coil:
            for key in ("matrix.rho", "matrix.r_nom"):
                if not alignment.is_rotation(document.needed(key, (3, 3)), _PRINTED):
                    raise document.refuse(key, "is no rotation", _CORRECT)
            self.rotation = document.needed("matrix.r_nom", (3, 3)) @ document.needed("matrix.rho", (3, 3))
            self._same("matrix.phi", self.rotation @ self.transfer, "is not r_nom rho omega sigma")

    def _same(self, key: str, wanted: np.ndarray, rule: str) -> None:
        stated = self.document.numbers(key, (3, 3))
        if stated is not None and np.abs(stated - wanted).max() > _PRINTED * max(1.0, self.sigma.max()):
            raise self.document.refuse(key, rule, _CORRECT)

    def _linearisation(self) -> None:
        self._c2 = self._c3 = None
        if self.how.linearise:
            self._c2 = self.document.needed("linearisation.applied.c2_per_ent", (3,))
            self._c3 = self.document.needed("linearisation.applied.c3_per_ent2", (3,))

    def prepared(self, readings: np.ndarray) -> np.ndarray:
        """The readings that the matrix takes, enT: linearised where the file says so."""
        if self._c2 is None:
            return readings
        return readings + readings * readings * (self._c2 + self._c3 * readings)

    def _ranges(self) -> list[Range]:
        if self.document.get("valid.temperature_degc") is not None:
            return [_range(self.document, "valid.temperature_degc")]
        spread = self.document.numbers("conditions.sensor_degc", (3,))
        if spread is None:
            return []
        return [Range(self.document.file, "conditions.sensor_degc", float(spread[0]), float(spread[2]))]

    def _uncertainty(self) -> None:
        """The covariance of Phi and B_or where the file has it, otherwise standard uncertainties."""
        document = self.document
        self.unknown: list[str] = []
        self._std: dict[str, np.ndarray] = {}
        table = covariance_table(document, "covariance_combined")
        if table is None and not document.table("std_combined"):
            table = covariance_table(document, "covariance")
        self._joint = None
        if table is not None and self.rotation is not None:
            names = [f"phi_{row}{column}" for row in AXES for column in AXES] + [f"b_or_{axis}" for axis in AXES]
            self._joint = table.of(names)
        if self._joint is not None:
            if not np.isfinite(self._joint).all():
                raise document.refuse("covariance.matrix", "holds a value that is not determined (nan)")
            return
        for key, shape in (("sigma", (3,)), ("xi_deg", (3,)), ("b_or_ent", (3,)), ("phi", (3, 3))):
            std = stated_std(document, f"std.{key}")
            if std is not None and (std.shape != shape or not (std >= 0.0).all()):
                raise document.refuse(f"std.{key}", f"must be {' x '.join(map(str, shape))} numbers from zero on")
            if std is not None:
                self._std[key] = std
            elif key != "phi":
                self.unknown.append(f"std.{key}")

    def unknown_in(self, frame: str) -> list[str]:
        """Parameters of a frame that the file gives no uncertainty for."""
        if self._joint is not None:
            return []
        if frame == "coil":
            return [f"std.{key}" for key in ("phi", "b_or_ent") if key not in self._std]
        return self.unknown

    def at(self, t: np.ndarray, frame: str) -> State:
        if frame == "coil":
            assert self.rotation is not None
            return State((self.rotation @ self.transfer)[None], self.b_or[None], self._terms_of_phi())
        if self._joint is not None:
            terms = self._terms_of_transfer()
        elif self.unknown:
            terms = []
        else:
            by_sigma = [self.omega * np.eye(3)[i] for i in range(3)]
            by_xi = [change * self.sigma for change in self.omega_by]
            variances = np.concatenate([self._std["sigma"], self._std["xi_deg"]]) ** 2
            terms = [
                Term(np.array(by_sigma + by_xi)[None], None, diagonal(variances)[None]),
                Term(None, np.eye(3)[None], diagonal(self._std["b_or_ent"] ** 2)[None]),
            ]
        return State(self.transfer[None], self.b_or[None], terms)

    def _terms_of_phi(self) -> list[Term]:
        by_phi = np.eye(9).reshape(9, 3, 3)
        if self._joint is not None:
            return [self._with_offset(by_phi)]
        if self.unknown_in("coil"):
            return []
        return [
            Term(by_phi[None], None, diagonal(self._std["phi"].ravel() ** 2)[None]),
            Term(None, np.eye(3)[None], diagonal(self._std["b_or_ent"] ** 2)[None]),
        ]

    def _terms_of_transfer(self) -> list[Term]:
        """Derivatives of omega sigma by the elements of Phi, exactly: Phi = P W with a rotation P and W triangular. From
        P^T dPhi W^-1 = P^T dP + dW W^-1, the first antisymmetric, the second triangular."""
        assert self.rotation is not None
        inverse = np.linalg.inv(self.transfer)
        turned = self.rotation.T @ np.eye(9).reshape(9, 3, 3) @ inverse
        transposed = np.swapaxes(turned, 1, 2)
        if self._convention == alignment.ROSETTA:
            triangular = np.triu(turned) + np.triu(transposed, 1)
        else:
            triangular = np.tril(turned) + np.tril(transposed, -1)
        return [self._with_offset(triangular @ self.transfer)]

    def _with_offset(self, by_phi: np.ndarray) -> Term:
        assert self._joint is not None
        d_matrix = np.concatenate([by_phi, np.zeros((3, 3, 3))])
        d_offset = np.concatenate([np.zeros((9, 3)), np.eye(3)])
        return Term(d_matrix[None], d_offset[None], self._joint[None])


class _Polynomials:
    """Some polynomials of a temperature with the covariances that the file states."""

    def __init__(self, document: Document, names: list[str]) -> None:
        self.coefficients = [document.needed(name, (-1,)) for name in names]
        self.covariance = [stated_covariance(document, n, len(c)) for n, c in zip(names, self.coefficients)]
        self.unknown = [f"covariance.{n}" for n, c in zip(names, self.covariance) if c is None]

    def values(self, t: np.ndarray) -> np.ndarray:
        """(n, number of polynomials)."""
        return np.stack([horner(c, t) for c in self.coefficients], axis=1)

    def variances(self, t: np.ndarray) -> np.ndarray:
        """The same for the variances."""
        found = []
        for covariance in self.covariance:
            assert covariance is not None
            by = powers(t, len(covariance))
            found.append(((by @ covariance) * by).sum(axis=1))
        return np.stack(found, axis=1)


class TemperatureCalibration:
    """Sensitivities and angles as polynomials of the temperature, TPF and TCF, without the offset."""

    needs_temperature = True
    field_limit_coil_nt = None

    def __init__(self, document: Document, how: Applied) -> None:
        assert how.convention is not None
        self._convention = how.convention
        names = [f"sigma_{axis}" for axis in AXES] + [f"xi_{pair}" for pair in PAIRS]
        self._polynomials = _Polynomials(document, names)
        self.ranges = [_range(document, "valid_degc")]
        ends = np.array([self.ranges[0].low, self.ranges[0].high])
        values = self._polynomials.values(ends)
        _positive(document, "sigma_x, sigma_y, sigma_z", values[:, :3])
        _directions(document, "xi_xy, xi_xz, xi_yz", values[:, 3:])
        self._together = self._joint(document, names)
        self.unknown = [] if self._together is not None else self._polynomials.unknown
        #: What the polynomials miss.
        self._remainder = np.zeros(6)
        for key, at in (("sigma_remainder", 0), ("xi_remainder_deg", 3)):
            if (stated := document.numbers(key, (3,))) is not None:
                self._remainder[at : at + 3] = stated

    def _joint(self, document: Document, names: list[str]) -> np.ndarray | None:
        """The covariance of all coefficients where the file states it; one of type A does not stand for combined ones."""
        if document.table("covariance_combined"):
            return None
        table = covariance_table(document, "together")
        if table is None:
            return None
        wanted = [f"{n}.{k}" for n, c in zip(names, self._polynomials.coefficients) for k in range(len(c))]
        found = table.of(wanted)
        if found is None:
            missing = [name for name in wanted if name not in table.parameters]
            raise document.refuse("together.parameters", f"lacks {', '.join(missing)}")
        if not np.isfinite(found).all():
            raise document.refuse("together.matrix", "holds a value that is not determined (nan)")
        return found

    def unknown_in(self, frame: str) -> list[str]:
        return self.unknown

    def at(self, t: np.ndarray, frame: str) -> State:
        values = self._polynomials.values(t)
        sigma, xi = values[:, :3], values[:, 3:]
        omega, omega_by = alignment.omega(self._convention, xi)
        terms = []
        if not self.unknown:
            by_sigma = omega[:, None] * np.eye(3)[None, :, None, :]
            by_xi = omega_by * sigma[:, None, None, :]
            terms.append(Term(np.concatenate([by_sigma, by_xi], axis=1), None, self._covariance(t)))
        return State(omega * sigma[:, None, :], np.zeros((1, 3)), terms)

    def _covariance(self, t: np.ndarray) -> np.ndarray:
        if self._together is None:
            found = diagonal(self._polynomials.variances(t))
        else:
            by = np.zeros((len(t), 6, len(self._together)))
            at = 0
            for i, coefficients in enumerate(self._polynomials.coefficients):
                by[:, i, at : at + len(coefficients)] = powers(t, len(coefficients))
                at += len(coefficients)
            found = by @ self._together @ np.swapaxes(by, 1, 2)
        return found + np.diag(self._remainder**2)


class GroundCalibration:
    """A ground calibration file of Rosetta RPC-MAG (RO-IGEP-TR0028 sections 3.3 and 4.2.3.2) with its offset."""

    needs_temperature = True
    field_limit_coil_nt = None
    _STATEMENTS = {
        "omega_convention": "Rosetta",
        "offset_acts": "before the matrix",
        "offset_sign": "subtracted",
        "offset_unit": "enT",
        "model": "B = omega sigma (B_r - B_off)",
    }

    def __init__(self, document: Document, how: Applied) -> None:
        for key, known in self._STATEMENTS.items():
            stated = document.text(key)
            if stated != known:
                rule = "is missing" if stated is None else f"is `{stated}`, not `{known}`"
                raise document.refuse(key, rule, "convert the values, or name a file that states it")
        self._values = {
            label: document.needed(label, (3,))
            for label in ("A_0", "A_1", "B_RES", "SIGMA_00", "SIGMA_01", "XI_10", "XI_11", "K_0", "K_1", "K_2")
        }
        self._k_inverse = np.array([self._values[f"K_{row}"] for row in range(3)])
        if np.tril(self._k_inverse, -1).any():
            raise document.refuse("K_1, K_2", "must be zero before the diagonal, as rows of an upper triangular matrix")
        self.ranges = [_range(document, "valid_degc")]
        ends = np.array([self.ranges[0].low, self.ranges[0].high])
        _positive(document, "SIGMA_00, SIGMA_01", self._line("SIGMA_00", "SIGMA_01", ends))
        _directions(document, "XI_10, XI_11", self._line("XI_10", "XI_11", ends))
        self.unknown: list[str] = []
        self._variance: dict[str, np.ndarray] = {}
        # Without a transfer to the centre K is the identity, and without a residual field nothing is taken off: both are exact.
        exact = {"B_RES": np.zeros(3)} | {f"K_{row}": np.eye(3)[row] for row in range(3)}
        for label, value in self._values.items():
            std = stated_std(document, f"std.{label}")
            if std is None and label in exact and (value == exact[label]).all():
                std = np.zeros(3)
            if std is None:
                self.unknown.append(f"std.{label}")
                continue
            if std.shape != (3,) or not (std >= 0.0).all():
                raise document.refuse(f"std.{label}", "must be three numbers from zero on")
            self._variance[label] = std**2

    def _line(self, constant: str, slope: str, t: np.ndarray) -> np.ndarray:
        return self._values[slope] * t[:, None] + self._values[constant]

    def _line_variance(self, constant: str, slope: str, t: np.ndarray) -> np.ndarray:
        return self._variance[constant] + self._variance[slope] * t[:, None] ** 2

    def unknown_in(self, frame: str) -> list[str]:
        return self.unknown

    def at(self, t: np.ndarray, frame: str) -> State:
        sigma = self._line("SIGMA_00", "SIGMA_01", t)
        q, q_by = alignment.base_vectors(self._line("XI_10", "XI_11", t))
        omega = q @ self._k_inverse
        offset = self._line("A_0", "A_1", t) - self._values["B_RES"]
        terms = []
        if not self.unknown:
            by_sigma = omega[:, None] * np.eye(3)[None, :, None, :]
            by_xi = q_by @ self._k_inverse * sigma[:, None, None, :]
            by_k = q[:, None] @ np.eye(9).reshape(1, 9, 3, 3) * sigma[:, None, None, :]
            every = np.broadcast_to
            k_variances = np.concatenate([self._variance[f"K_{row}"] for row in range(3)])
            variances = [
                self._line_variance("SIGMA_00", "SIGMA_01", t),
                self._line_variance("XI_10", "XI_11", t),
                every(k_variances, (len(t), 9)),
            ]
            offset_variances = self._line_variance("A_0", "A_1", t) + self._variance["B_RES"]
            d_matrix = np.concatenate([by_sigma, by_xi, by_k], axis=1)
            terms = [
                Term(d_matrix, None, diagonal(np.concatenate(variances, axis=1))),
                Term(None, np.eye(3)[None], diagonal(offset_variances)),
            ]
        return State(omega * sigma[:, None, :], offset, terms)


class PolynomialOffset:
    """An offset as polynomials of the temperature."""

    def __init__(self, document: Document, quantity: str) -> None:
        self.quantity = quantity
        names = [f"{quantity}_{axis}" for axis in AXES]
        missing = [name for name in names if document.get(name) is None]
        if missing:
            raise document.refuse(
                ", ".join(missing), "is missing: the offset of these components is not known", "name an offset of all components"
            )
        self._polynomials = _Polynomials(document, names)
        self.unknown = self._polynomials.unknown
        self.ranges = [_range(document, "valid_degc")]

    def at(self, t: np.ndarray) -> tuple[np.ndarray, list[Term]]:
        terms = [] if self.unknown else [Term(None, np.eye(3)[None], diagonal(self._polynomials.variances(t)))]
        return self._polynomials.values(t), terms


class MeasuredOffset:
    """The offset of one measurement in several positions, OPF."""

    def __init__(self, document: Document, quantity: str) -> None:
        self.quantity = quantity
        offset = document.numbers("offset_ent", (3,), finite=False)
        if offset is None:
            raise document.refuse("offset_ent", "is missing")
        if not np.isfinite(offset).all():
            names = ", ".join(a for a, v in zip(AXES, offset) if not np.isfinite(v))
            raise document.refuse("offset_ent", f"is not determined for {names}", "name an offset of all components")
        self._offset = offset
        self.unknown: list[str] = []
        self._covariance = self._stated(document)
        spread = document.numbers("conditions.sensor_degc", (3,))
        self.ranges = []
        if spread is not None:
            self.ranges.append(Range(document.file, "conditions.sensor_degc", float(spread[0]), float(spread[2])))

    def _stated(self, document: Document) -> np.ndarray:
        names = [f"offset_{axis}" for axis in AXES]
        for path in ("covariance_combined", "covariance"):
            table = covariance_table(document, path)
            found = table.of(names) if table is not None else None
            if found is not None:
                return found
        std = document.numbers("offset_std_ent", (3,))
        if std is None:
            self.unknown.append("offset_std_ent")
            return np.zeros((3, 3))
        return np.diag(std**2)

    def at(self, t: np.ndarray) -> tuple[np.ndarray, list[Term]]:
        terms = [] if self.unknown else [Term(None, np.eye(3)[None], self._covariance[None])]
        return self._offset[None], terms
