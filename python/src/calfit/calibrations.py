"""What takes readings to a field: the calibration of a run (CPF), polynomials of the temperature (TPF, TCF), a ground calibration
file (RPCMAG); and offsets that stand in a file of their own (TOF, OPF).

Each checks its file when it is made. `at(t, frame)` gives the calibration at temperatures, `unknown` names the parameters that the file
gives no uncertainty for, `ranges` the temperatures for which it holds. What it holds for beside temperatures stands in `linearisation`,
with the readings, and in `field`, both None where the file does not say.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from . import alignment
from .document import Document
from .errors import Refused
from .kinds import AXES, PAIRS
from .quantities import covariance_table, known_coefficients, stated_covariance, stated_std
from .state import State, Term, constant, horner, over_temperature
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


class Limits(NamedTuple):
    """Lowest and highest values of three components for which a file holds."""

    file: str
    key: str
    #: (3, 2).
    values: np.ndarray

    def left_by(self, components: np.ndarray) -> np.ndarray:
        """Which of these, (n, 3), lie outside. A limit that is not determined holds nothing."""
        inside = (self.values[:, 0] <= components) & (components <= self.values[:, 1])
        return ~inside.all(axis=1)


def _limits(document: Document, key: str) -> Limits | None:
    stated = document.numbers(key, (3, 2), finite=False)
    return None if stated is None else Limits(document.file, key, stated)


class FieldRange(NamedTuple):
    """The fields for which a file holds, nT."""

    limits: Limits
    #: From the sensor frame to the axes of the limits; None: they are those of the sensor frame.
    rotation: np.ndarray | None = None


def _along_sensor_axes(document: Document) -> FieldRange | None:
    """Limits along the nominal sensor axes, which the axes of the sensor frame follow within the misalignment."""
    limits = _limits(document, "valid_field_nt")
    return None if limits is None else FieldRange(limits)


class Linearisation:
    """The polynomials of the readings that a calibration takes."""

    def __init__(self, document: Document) -> None:
        self._c2 = document.needed("linearisation.applied.c2_per_ent", (3,))
        self._c3 = document.needed("linearisation.applied.c3_per_ent2", (3,))
        limits = _limits(document, "linearisation.applied.reading_ent")
        if limits is None:
            raise document.refuse("linearisation.applied.reading_ent", "is missing")
        #: Of the readings, enT.
        self.limits = limits

    def linearised(self, readings: np.ndarray) -> np.ndarray:
        return readings + readings * readings * (self._c2 + self._c3 * readings)


def _linearisation(document: Document, how: Applied) -> Linearisation | None:
    return Linearisation(document) if how.linearise else None


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
        self._uncertainty()
        self.linearisation = _linearisation(document, how)
        stated = document.get("valid.temperature_degc") is not None
        self.ranges = [_range(document, "valid.temperature_degc")] if stated else []
        limits = _limits(document, "valid.field_coil_nt")
        self.field = None if limits is None or self.rotation is None else FieldRange(limits, self.rotation)

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
        self.b_or = document.needed("offset.b_or_ent", (3,))
        self._same("matrix.omega", self.omega, f"is not that of the angles in the convention {self._convention}")
        #: omega sigma.
        self.transfer = self._same("matrix.phi_tilde", self.omega * self.sigma, "is not omega sigma")
        #: R_nom rho, from the sensor frame to coil axes, and that times omega sigma.
        self.rotation = self._phi = None
        if self.how.to_coil:
            for key in ("matrix.rho", "matrix.r_nom"):
                if not alignment.is_rotation(document.needed(key, (3, 3))):
                    raise document.refuse(key, "is no rotation", _CORRECT)
            self.rotation = document.needed("matrix.r_nom", (3, 3)) @ document.needed("matrix.rho", (3, 3))
            self._phi = self._same("matrix.phi", self.rotation @ self.transfer, "is not r_nom rho omega sigma")

    def _same(self, key: str, wanted: np.ndarray, rule: str) -> np.ndarray:
        """The matrix as the file states it, which must be the one that follows from the rest of it; that one where it states none."""
        stated = self.document.numbers(key, (3, 3))
        if stated is None:
            return wanted
        if np.abs(stated - wanted).max() > _PRINTED * max(1.0, self.sigma.max()):
            raise self.document.refuse(key, rule, _CORRECT)
        return stated

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
            assert self._phi is not None
            return State(self._phi[None], self.b_or[None], self._terms_of_phi())
        if self._joint is not None:
            terms = self._terms_of_transfer()
        elif self.unknown:
            terms = []
        else:
            by_sigma = [self.omega * np.eye(3)[i] for i in range(3)]
            by_xi = [change * self.sigma for change in self.omega_by]
            variances = np.concatenate([self._std["sigma"], self._std["xi_deg"]]) ** 2
            terms = [
                Term(np.array(by_sigma + by_xi)[None], None, constant(variances)),
                Term(None, np.eye(3)[None], constant(self._std["b_or_ent"] ** 2)),
            ]
        return State(self.transfer[None], self.b_or[None], terms)

    def _terms_of_phi(self) -> list[Term]:
        by_phi = np.eye(9).reshape(9, 3, 3)
        if self._joint is not None:
            return [self._with_offset(by_phi)]
        if self.unknown_in("coil"):
            return []
        return [
            Term(by_phi[None], None, constant(self._std["phi"].ravel() ** 2)),
            Term(None, np.eye(3)[None], constant(self._std["b_or_ent"] ** 2)),
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
        return Term(d_matrix[None], d_offset[None], constant(self._joint))


class _Polynomials:
    """Some polynomials of a temperature with the covariances that the file states."""

    def __init__(self, document: Document, names: list[str]) -> None:
        self.coefficients = [document.needed(name, (-1,)) for name in names]
        self.covariance = [stated_covariance(document, n, len(c)) for n, c in zip(names, self.coefficients)]
        self.unknown = [f"covariance.{n}" for n, c in zip(names, self.covariance) if c is None]

    def values(self, t: np.ndarray) -> np.ndarray:
        """(n, number of polynomials)."""
        return np.stack([horner(c, t) for c in self.coefficients], axis=1)

    def over_temperature(self, together: np.ndarray | None = None) -> np.ndarray:
        """Their covariance: from that of all coefficients, or from those of every polynomial, which are then independent of each other."""
        counts = [len(c) for c in self.coefficients]
        whole = _blocks(self.covariance) if together is None else together
        parameters = [i for i, count in enumerate(counts) for _ in range(count)]
        orders = [k for count in counts for k in range(count)]
        return over_temperature(whole, parameters, orders, len(counts))


class NoOffset(Refused):
    """A file states an offset, but not that of all components."""


class TemperatureCalibration:
    """Sensitivities and angles as polynomials of the temperature, TPF and TCF, with their offset unless that of another file is taken."""

    needs_temperature = True
    rotation = None

    def __init__(self, document: Document, how: Applied) -> None:
        assert how.convention is not None
        self._convention = how.convention
        self.linearisation = _linearisation(document, how)
        self.field = _along_sensor_axes(document)
        names = [f"sigma_{axis}" for axis in AXES] + [f"xi_{pair}" for pair in PAIRS]
        if how.offset is not None:
            names += _of_offset(document, how.offset)
        self._polynomials = _Polynomials(document, names)
        self.ranges = [_range(document, "valid_degc")]
        ends = np.array([self.ranges[0].low, self.ranges[0].high])
        values = self._polynomials.values(ends)
        _positive(document, "sigma_x, sigma_y, sigma_z", values[:, :3])
        _directions(document, "xi_xy, xi_xz, xi_yz", values[:, 3:6])
        together = self._joint(document, names)
        self.unknown = [] if together is not None else self._polynomials.unknown
        # What the polynomials miss.
        remainder = np.zeros(len(names))
        for key, at in (("sigma_remainder", 0), ("xi_remainder_deg", 3)):
            if (stated := document.numbers(key, (3,))) is not None:
                remainder[at : at + 3] = stated
        self._covariance = np.zeros((1, len(names), len(names)))
        if not self.unknown:
            self._covariance = self._polynomials.over_temperature(together)
            self._covariance[0] += np.diag(remainder**2)

    def _joint(self, document: Document, names: list[str]) -> np.ndarray | None:
        """The covariance of all coefficients: where the file states it, or with the change of all of them by every source that the runs share.
        One of type A does not stand for combined ones."""
        is_combined = bool(document.table("covariance_combined"))
        place = "together_combined" if is_combined else "together"
        table = covariance_table(document, place)
        if table is None:
            return self._with_common(document, names) if is_combined else None
        counts = [len(c) for c in self._polynomials.coefficients]
        wanted = [f"{n}.{k}" for n, count in zip(names, counts) for k in range(count)]
        # The covariance of a transfer to the centre is without the offset, which is another measurement.
        joint = wanted if set(wanted) <= set(table.parameters) else wanted[: sum(counts[:6])]
        found = table.of(joint)
        if found is None:
            missing = [name for name in joint if name not in table.parameters]
            raise document.refuse(f"{place}.parameters", f"lacks {', '.join(missing)}")
        if not np.isfinite(found).all():
            raise document.refuse(f"{place}.matrix", "holds a value that is not determined (nan)")
        if len(joint) == len(wanted):
            return found
        offset = self._polynomials.covariance[6:]
        if any(c is None for c in offset):
            return None
        return _blocks([found, *offset])

    def _with_common(self, document: Document, names: list[str]) -> np.ndarray | None:
        """The blocks of type A of the coefficients of every quantity, and what the runs share."""
        sources, table = document.get("common"), document.get("covariance")
        if not isinstance(sources, list) or not isinstance(table, dict):
            return None
        counts = [len(c) for c in self._polynomials.coefficients]
        whole = _blocks([document.needed(f"covariance.{n}", (count, count)) for n, count in zip(names, counts)])
        for source in sources:
            parts = [np.asarray(source.get(n, np.zeros(count)), dtype=np.float64) for n, count in zip(names, counts)]
            if any(part.shape != (count,) for part, count in zip(parts, counts)):
                raise document.refuse("common", "has another number of changes than coefficients")
            change = np.concatenate(parts)
            whole += np.outer(change, change)
        return whole

    def unknown_in(self, frame: str) -> list[str]:
        return self.unknown

    def at(self, t: np.ndarray, frame: str) -> State:
        values = self._polynomials.values(t)
        sigma, xi, offset = values[:, :3], values[:, 3:6], values[:, 6:]
        omega, omega_by = alignment.omega(self._convention, xi)
        terms = []
        if not self.unknown:
            by_sigma = omega[:, None] * np.eye(3)[None, :, None, :]
            by_xi = omega_by * sigma[:, None, None, :]
            d_matrix, d_offset = np.concatenate([by_sigma, by_xi], axis=1), None
            if offset.size:
                d_matrix = np.concatenate([d_matrix, np.zeros((len(t), 3, 3, 3))], axis=1)
                d_offset = np.concatenate([np.zeros((6, 3)), np.eye(3)])[None]
            terms.append(Term(d_matrix, d_offset, self._covariance))
        return State(omega * sigma[:, None, :], offset if offset.size else np.zeros((1, 3)), terms)


class _Coefficient(NamedTuple):
    """A number of a ground calibration file: its component of a label, and which parameter has it as coefficient of which order."""

    label: str
    component: int
    name: str
    parameter: int
    order: int
    sign: float = 1.0


def _ground_coefficients() -> list[_Coefficient]:
    """All of them. Parameters: sigma, xi, the elements of K^-1 from its diagonal on, the offset; three, three, six, three."""
    found = []
    for order, labels in enumerate((("SIGMA_00", "XI_10", "A_0"), ("SIGMA_01", "XI_11", "A_1"))):
        for label, names, first in zip(labels, (AXES, PAIRS, AXES), (0, 3, 12)):
            found += [_Coefficient(label, i, f"{label}_{name}", first + i, order) for i, name in enumerate(names)]
    for place, (row, column) in enumerate(zip(*np.triu_indices(3))):
        found.append(_Coefficient(f"K_{row}", int(column), f"K_{row}_{AXES[column]}", 6 + place, 0))
    # B_off = A_0 + A_1 T - B_RES.
    return found + [_Coefficient("B_RES", i, f"B_RES_{axis}", 12 + i, 0, -1.0) for i, axis in enumerate(AXES)]


class GroundCalibration:
    """A ground calibration file of Rosetta RPC-MAG (RO-IGEP-TR0028 sections 3.3 and 4.2.3.2) with its offset."""

    needs_temperature = True
    linearisation = None
    rotation = None
    _COEFFICIENTS = _ground_coefficients()
    _PARAMETERS = 15
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
        self.field = _along_sensor_axes(document)
        self.unknown: list[str] = []
        stated = self._stated_covariance(document)
        if stated is None:
            stated = self._of_independent_values(document)
        of = self._COEFFICIENTS
        signs = np.array([c.sign for c in of])
        self._covariance = over_temperature(
            stated * np.outer(signs, signs), [c.parameter for c in of], [c.order for c in of], self._PARAMETERS
        )

    def _stated_covariance(self, document: Document) -> np.ndarray | None:
        """The covariance of all values where the file states it; what has no row is exact."""
        table = covariance_table(document, "covariance")
        if table is None:
            return None
        place = {name: at for at, name in enumerate(table.parameters)}
        rows = [i for i, c in enumerate(self._COEFFICIENTS) if c.name in place]
        at = [place[self._COEFFICIENTS[i].name] for i in rows]
        found = np.zeros((len(self._COEFFICIENTS),) * 2)
        found[np.ix_(rows, rows)] = table.matrix[np.ix_(at, at)]
        if not np.isfinite(found).all():
            raise document.refuse("covariance.matrix", "holds a value that is not determined (nan)")
        return found

    def _of_independent_values(self, document: Document) -> np.ndarray:
        """The covariance of values that are independent of each other, with the standard uncertainties that the file states."""
        # Without a transfer to the centre K is the identity, and without a residual field nothing is taken off: both are exact.
        exact = {"B_RES": np.zeros(3)} | {f"K_{row}": np.eye(3)[row] for row in range(3)}
        stds: dict[str, np.ndarray] = {}
        for label, value in self._values.items():
            std = stated_std(document, f"std.{label}")
            if std is None:
                std = np.zeros(3)
                if label not in exact or (value != exact[label]).any():
                    self.unknown.append(f"std.{label}")
            if std.shape != (3,) or not (std >= 0.0).all():
                raise document.refuse(f"std.{label}", "must be three numbers from zero on")
            stds[label] = std
        return np.diag([stds[c.label][c.component] ** 2 for c in self._COEFFICIENTS])

    def _line(self, at_zero: str, slope: str, t: np.ndarray) -> np.ndarray:
        return self._values[slope] * t[:, None] + self._values[at_zero]

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
            by_k = np.zeros((len(t), 6, 3, 3))
            for place, (row, column) in enumerate(zip(*np.triu_indices(3))):
                by_k[:, place, :, column] = q[:, :, row] * sigma[:, column, None]
            d_matrix = np.concatenate([by_sigma, by_xi, by_k, np.zeros((len(t), 3, 3, 3))], axis=1)
            d_offset = np.concatenate([np.zeros((12, 3)), np.eye(3)])
            terms = [Term(d_matrix, d_offset[None], self._covariance)]
        return State(omega * sigma[:, None, :], offset, terms)


def _of_offset(document: Document, quantity: str) -> list[str]:
    """Names of the polynomials of an offset."""
    names = [f"{quantity}_{axis}" for axis in AXES]
    missing = [name for name in names if known_coefficients(document, name) is None]
    if missing:
        rule = "is missing: the offset of these components is not known"
        raise NoOffset(document.file, ", ".join(missing), rule, "name an offset of all components")
    return names


def _blocks(parts: list[np.ndarray]) -> np.ndarray:
    """A matrix with others along its diagonal."""
    ends = np.cumsum([len(part) for part in parts])
    whole = np.zeros((ends[-1], ends[-1]))
    for end, part in zip(ends, parts):
        whole[end - len(part) : end, end - len(part) : end] = part
    return whole


class PolynomialOffset:
    """An offset as polynomials of the temperature."""

    def __init__(self, document: Document, quantity: str) -> None:
        self.quantity = quantity
        self._polynomials = _Polynomials(document, _of_offset(document, quantity))
        self.unknown = self._polynomials.unknown
        self.ranges = [_range(document, "valid_degc")]
        self._terms = [] if self.unknown else [Term(None, np.eye(3)[None], self._polynomials.over_temperature())]

    def at(self, t: np.ndarray) -> tuple[np.ndarray, list[Term]]:
        return self._polynomials.values(t), self._terms


#: A sensor whose temperature moves by less during a run is at rest, K.
_AT_REST_K = 1.0


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
            low, mean, high = (float(degc) for degc in spread)
            # Of a sensor that moves the offset is that at the mean temperature, and holds for what counts as rest about it.
            if high - low > _AT_REST_K:
                low, high = mean - 0.5 * _AT_REST_K, mean + 0.5 * _AT_REST_K
            self.ranges.append(Range(document.file, "conditions.sensor_degc", low, high))

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
        terms = [] if self.unknown else [Term(None, np.eye(3)[None], constant(self._covariance))]
        return self._offset[None], terms
