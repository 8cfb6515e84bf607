"""Parameters of a sensor from one file or from several that belong together, and their application to readings."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from . import calibrations
from .alignment import is_rotation
from .calibrations import Range
from .document import Document, load
from .errors import Refused
from .kinds import AXES, Kind, kind_of
from .quantities import Covariance, Quantities, quantities
from .state import State
from .steps import Applied, applied

#: The temperature lies outside of the range of a file.
TEMPERATURE = 1 << 0
#: The field is larger than the one that was calibrated.
FIELD = 1 << 16
#: There is no temperature, and the parameters depend on it.
NO_TEMPERATURE = 1 << 17

#: Readings that are calibrated at a time.
_BLOCK = 16_384
_ROTATION = 1e-9
_CALIBRATIONS = ("CPF", "TPF", "TCF", "RPCMAG")
_OFFSETS = ("TOF", "OPF")


class Parameters:
    """What parameter files state of a sensor.

    ``values``, ``units``, ``std`` and ``covariance`` are named by the paths of the keys in the file, ``matrix.sigma`` for example.
    The coefficient of order k of a polynomial has the unit of the polynomial over degC^k. ``std`` and ``covariance`` are the combined
    ones where the file states those, otherwise those of type A. ``documents`` holds all keys of the files.
    """

    def __init__(self, documents: list[Document]) -> None:
        self._kinds = [kind_of(document) for document in documents]
        self._applied = [applied(document) for document in documents]
        self.documents: tuple[Document, ...] = tuple(documents)
        self.files: tuple[str, ...] = tuple(document.file for document in documents)
        self.format: str = "+".join(document.format for document in documents)
        self.values: dict[str, Any] = {}
        self.units: dict[str, str] = {}
        self.std: dict[str, Any] = {}
        self.covariance: dict[str, Covariance] = {}
        #: What a person should know.
        self.notes: list[str] = []
        _together(documents)
        self.sensor, self.mode = _sensor(documents[0])
        #: The frame of the result, in the words of the file that has sigma and omega.
        self.frame: str | None = next((how.frame for how in self._applied if how is not None and how.convention is not None), None)
        self._cannot: Refused | None = None
        self._effects = _effects(documents)
        self._calibration: Any = None
        self._offset: Any = None
        self._compose(documents)
        for document, kind in zip(documents, self._kinds):
            stated = quantities(document, kind)
            if not stated.values.keys().isdisjoint(self.values):
                # The range of temperatures stands in several files; its name says whose it is.
                stated = _renamed(stated, self.values, document.format)
            self.values |= stated.values
            self.units |= stated.units
            self.std |= stated.std
            self.covariance |= stated.covariance
            self.notes += document.notes

    def __repr__(self) -> str:
        return f"calfit.Parameters({self.format}: {', '.join(self.files)}; sensor {self.sensor!r}, mode {self.mode!r})"

    @property
    def offset(self) -> str | None:
        """The offset that ``apply`` subtracts: ``b_off``, that of the sensor, or ``b_or``, with the residual field of the facility."""
        if self._calibration is None or self._cannot is not None:
            return None
        return self._offset.quantity if self._offset is not None else self._own_offset

    def _compose(self, documents: list[Document]) -> None:
        """The calibration and the offset of the files. What is missing is only needed, and only told, by ``apply``."""
        self._own_offset: str | None = None
        main = [i for i, document in enumerate(documents) if document.format in _CALIBRATIONS]
        if not main:
            kind: Kind = self._kinds[0]
            self._cannot = documents[0].refuse("format", f"is {documents[0].format}: it {kind.lacks}", "or use `values` alone")
            return
        document, how = documents[main[0]], self._applied[main[0]]
        assert how is not None
        offsets = [d for d in documents if d.format in _OFFSETS]
        self._calibration = _calibration(document, how)
        if document.format in ("CPF", "RPCMAG"):
            self._own_offset = how.offset
        elif offsets:
            self._take_offset(offsets[0], "b_off")
        elif how.offset is None:
            self._cannot = document.refuse("apply.offset", "is missing: the file has no offset", "name a TOF or OPF beside it")
        else:
            self._take_offset(document, how.offset)
        if self.offset == "b_or":
            self.notes.append(
                f"{document.file}: the offset is b_or, that of the sensor and the residual field of the facility together"
            )
        unknown = list(self._calibration.unknown) + list(self._offset.unknown if self._offset is not None else [])
        if unknown:
            self.notes.append(f"{', '.join(self.files)}: no uncertainty is stated for {', '.join(unknown)}; u is nan")

    def _take_offset(self, document: Document, quantity: str) -> None:
        """An offset. One with a component that is not known is read, and refused by ``apply``."""
        kind = calibrations.MeasuredOffset if document.format == "OPF" else calibrations.PolynomialOffset
        try:
            self._offset = kind(document, quantity)
        except Refused as refused:
            self._cannot = refused

    @property
    def ranges(self) -> tuple[Range, ...]:
        """The temperatures for which the files hold, degC."""
        if self._calibration is None:
            return ()
        return tuple(self._calibration.ranges) + tuple(self._offset.ranges if self._offset is not None else ())

    def apply(
        self,
        x: Any,
        y: Any,
        z: Any,
        t_degc: Any = None,
        *,
        frame: str = "sensor",
        outside: str = "flag",
        rotation: Any = None,
        rotation_std_deg: Any = None,
        effects_taken_off: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Readings to a calibrated field.

        ``x``, ``y``, ``z``: raw readings along the sensor axes, enT, numbers or arrays of one shape. ``t_degc``: the temperature of
        the channel that the file names, a number or an array of the same shape; nan where there is none.

        ``frame``: ``"sensor"``, the orthogonal frame that the file states; ``"coil"``, coil axes in the position of the run (a CPF
        only); ``"reference"``, the sensor frame turned by ``rotation`` (3 x 3, from the sensor frame to the reference), whose standard
        uncertainty about the three axes of the reference, degrees, may be stated.

        ``outside``: what happens at temperatures for which the files do not hold: ``"flag"``, ``"null"`` (nan) or ``"error"``.

        Gives ``b`` and ``u``, nT, with the shape of the readings and a last axis of three, and ``flags`` (uint32) with the shape of
        the readings: bit 0 temperature outside, bit 16 field outside, bit 17 no temperature. ``u`` is the standard uncertainty of the
        field by that of the parameters; the noise of the reading is not in it. Group delay and frequency response are not applied.
        """
        where = ", ".join(self.files)
        if self._cannot is not None:
            raise self._cannot
        if self._effects is not None and not effects_taken_off:
            raise self._effects
        if outside not in ("flag", "null", "error"):
            raise Refused(where, "outside", f"is `{outside}`", "use `flag`, `null` or `error`")
        turn = _turn(where, frame, rotation, rotation_std_deg)
        frame = "sensor" if turn is not None else frame
        if frame not in ("sensor", "coil"):
            raise Refused(where, "frame", f"is `{frame}`", "use `sensor`, `coil` or `reference`")
        if frame == "coil" and getattr(self._calibration, "rotation", None) is None:
            raise Refused(where, "frame", "is `coil`, but no rotation to coil axes is stated", "use `sensor`, or name a CPF")
        readings, t, shape = self._shaped(where, x, y, z, t_degc)
        flags = self._flags_of_temperature(t)
        out = (flags & TEMPERATURE) != 0
        if outside == "error" and out.any():
            raise self._outside(int(np.argmax(out)), t)
        b, u = np.empty_like(readings), np.empty_like(readings)
        for begin in range(0, len(readings), _BLOCK):
            at = slice(begin, begin + _BLOCK)
            b[at], u[at], high = self._block(readings[at], t[at], frame, turn)
            flags[at] |= np.where(high, FIELD, 0).astype(np.uint32)
        bad = ~np.isfinite(readings).all(axis=1) | ((flags & NO_TEMPERATURE) != 0)
        if outside == "null":
            bad |= out
        b[bad], u[bad] = np.nan, np.nan
        return b.reshape(*shape, 3), u.reshape(*shape, 3), flags.reshape(shape)

    def _shaped(self, where: str, x: Any, y: Any, z: Any, t_degc: Any) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
        components = [_real(where, name, value) for name, value in zip(AXES, (x, y, z))]
        shape = components[0].shape
        for name, component in zip(AXES, components):
            if component.shape != shape:
                raise Refused(where, name, f"has the shape {component.shape}, x {shape}", "give arrays of one shape")
        if t_degc is None:
            if self._needs_temperature:
                raise Refused(where, "t_degc", "is missing, and the parameters depend on it", "give the temperature in degC")
            t = np.full(shape, np.nan)
        else:
            t = _real(where, "t_degc", t_degc)
            if t.shape not in ((), shape):
                raise Refused(where, "t_degc", f"has the shape {t.shape}, x {shape}", "give a number, or one per reading")
            t = np.broadcast_to(t, shape)
        return np.stack([c.ravel() for c in components], axis=1), t.ravel(), shape

    @property
    def _needs_temperature(self) -> bool:
        return self._calibration.needs_temperature or isinstance(self._offset, calibrations.PolynomialOffset)

    def _flags_of_temperature(self, t: np.ndarray) -> np.ndarray:
        flags = np.zeros(len(t), dtype=np.uint32)
        there = np.isfinite(t)
        if self._needs_temperature:
            flags[~there] |= NO_TEMPERATURE
        for held in self.ranges:
            flags[there & ((t < held.low) | (t > held.high))] |= TEMPERATURE
        return flags

    def _outside(self, index: int, t: np.ndarray) -> Refused:
        held = next(r for r in self.ranges if not r.low <= t[index] <= r.high)
        rule = f"covers {held.low} to {held.high} degC; the reading at index {index} has {t[index]} degC"
        return Refused(held.file, held.key, rule, 'leave it out, or use outside="flag"')

    def _block(
        self, readings: np.ndarray, t: np.ndarray, frame: str, turn: tuple[np.ndarray, np.ndarray] | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Field, uncertainty, and whether the field is larger than what was calibrated."""
        # A temperature that is not finite makes no number; where it is needed the result is nan, where not it is not looked at.
        t = np.where(np.isfinite(t), t, 0.0)
        prepared = self._calibration.prepared(readings) if hasattr(self._calibration, "prepared") else readings
        with np.errstate(invalid="ignore", over="ignore"):
            state = self._state(t, frame)
            without = prepared - state.offset
            b = (state.matrix @ without[..., None])[..., 0]
            high = self._beyond(t, prepared)
            if turn is not None:
                b = b @ turn[0].T
            if self._unknown(frame):
                return b, np.full_like(b, np.nan), high
            variance = np.zeros_like(b)
            for term in state.terms:
                variance = variance + term.variance(state.matrix, without, None if turn is None else turn[0])
            if turn is not None:
                # A small turn about the axes of the reference changes the field by its vector product with the field.
                square = b**2
                variance = variance + np.stack(
                    [turn[1][j] * square[:, k] + turn[1][k] * square[:, j] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1
                )
            # Rounding may make a variance near zero negative.
            return b, np.sqrt(np.maximum(variance, 0.0)), high

    def _state(self, t: np.ndarray, frame: str) -> State:
        state = self._calibration.at(t, frame)
        if self._offset is None:
            return state
        offset, terms = self._offset.at(t)
        return State(state.matrix, offset, [*state.terms, *terms])

    def _unknown(self, frame: str) -> bool:
        return bool(self._calibration.unknown_in(frame)) or (self._offset is not None and bool(self._offset.unknown))

    def _beyond(self, t: np.ndarray, prepared: np.ndarray) -> np.ndarray:
        limit = self._calibration.field_limit_coil_nt
        if limit is None:
            return np.zeros(len(prepared), dtype=bool)
        coil = self._calibration.at(t, "coil")
        field = (coil.matrix @ (prepared - coil.offset)[..., None])[..., 0]
        return (np.abs(field) > limit).any(axis=1) & np.isfinite(field).all(axis=1)


def read(
    path: str | os.PathLike[str],
    *more: str | os.PathLike[str],
    sensor: str | None = None,
    mode: str | None = None,
) -> Parameters:
    """Reads a parameter file, or a TPF (or a TCF without an offset) with the TOF or OPF that goes with it.

    ``sensor`` and ``mode`` say what the readings are of; files of others are refused.
    """
    parameters = Parameters([load(p) for p in (path, *more)])
    for key, wanted, stated in (("sensor", sensor, parameters.sensor), ("mode", mode, parameters.mode)):
        if wanted is not None and stated != wanted:
            raise Refused(parameters.files[0], key, f"is `{stated}`, not `{wanted}`", f"name a file of {key} `{wanted}`")
    return parameters


def _calibration(document: Document, how: Applied) -> Any:
    kind = {
        "CPF": calibrations.RunCalibration,
        "TPF": calibrations.TemperatureCalibration,
        "TCF": calibrations.TemperatureCalibration,
        "RPCMAG": calibrations.GroundCalibration,
    }[document.format]
    return kind(document, how)


def _sensor(document: Document) -> tuple[str | None, str | None]:
    """Sensor and mode, at the head of a file or with its run."""

    def stated(key: str) -> str | None:
        return document.text(key) if document.get(key) is not None else document.text(f"run.{key}") if _has_run(document) else None

    return stated("sensor"), stated("mode")


def _has_run(document: Document) -> bool:
    return isinstance(document.get("run"), dict)


def _together(documents: list[Document]) -> None:
    """Several files must be one calibration and one offset of one sensor in one mode, in one temperature."""
    if len(documents) == 1:
        return
    forms = [document.format for document in documents]
    for document in documents:
        if document.format not in _CALIBRATIONS + _OFFSETS:
            raise document.refuse("format", f"is {document.format}, which is not applied with other files", "read it by itself")
    main = [d for d in documents if d.format in _CALIBRATIONS]
    offsets = [d for d in documents if d.format in _OFFSETS]
    if len(main) > 1:
        raise main[1].refuse("format", f"is {main[1].format}: a second calibration beside {main[0].file}", "name one of them")
    if len(offsets) > 1:
        raise offsets[1].refuse("format", f"is {offsets[1].format}: a second offset beside {offsets[0].file}", "name one of them")
    if not main:
        raise offsets[0].refuse("format", f"is {' and '.join(forms)}: sigma and omega are missing", "name a TPF")
    if main[0].format in ("CPF", "RPCMAG") or (main[0].format == "TCF" and main[0].get("apply.offset") is not None):
        raise offsets[0].refuse("format", f"is a second offset beside that of {main[0].file}", "leave it out")
    first = _sensor(main[0])
    for key, wanted, stated in zip(("sensor", "mode"), first, _sensor(offsets[0])):
        if wanted != stated:
            rule = f"is `{stated}`, that of {main[0].file} is `{wanted}`"
            raise offsets[0].refuse(key, rule, "name files of one sensor in one mode")
    channels = [d.text("channel") for d in (main[0], offsets[0]) if d.format != "OPF"]
    if len(channels) == 2 and channels[0] != channels[1]:
        rule = f"is `{channels[1]}`, that of {main[0].file} is `{channels[0]}`"
        raise offsets[0].refuse("channel", rule, "name files whose temperatures are of one thermistor")


def _effects(documents: list[Document]) -> Refused | None:
    """The effects that were taken off the readings before the fit: the parameters hold for readings without them."""
    for document in documents:
        inputs = document.get("provenance.input")
        roles = [i.get("role") for i in inputs if isinstance(i, dict)] if isinstance(inputs, list) else []
        for key in ("model", "sweep.model"):
            if document.get(key) is None:
                continue
            if document.get(f"{key}.effect"):
                return _taken_off(document, key)
            # Nothing of the model concerned these readings.
            roles = [role for role in roles if role != "model"]
        if "model" in roles and document.format in _CALIBRATIONS:
            return _taken_off(document, "provenance.input")
    return None


def _taken_off(document: Document, key: str) -> Refused:
    rule = "says that known effects were taken off the readings before the fit, which this package does not do"
    return document.refuse(key, rule, "take them off, and say so by effects_taken_off=True; or fit without --model")


def _renamed(found: Quantities, taken: dict[str, Any], form: str) -> Quantities:
    """Names that another file has already, with the format before them."""

    def of(names: dict[str, Any]) -> dict[str, Any]:
        return {(f"{form}.{name}" if name in taken else name): value for name, value in names.items()}

    return Quantities(*(of(part) for part in found))


def _real(where: str, name: str, value: Any) -> np.ndarray:
    """Numbers of any real type; masked ones are nan."""
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(np.float64), np.nan)
    try:
        found = np.asarray(value)
    except ValueError as error:
        raise Refused(where, name, "is no array: its rows differ in length", "give numbers") from error
    if found.dtype.kind not in "iuf":
        raise Refused(where, name, f"is of type {found.dtype}", "give real numbers, nan where there is none")
    return found.astype(np.float64)


def _turn(where: str, frame: str, rotation: Any, std_deg: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """The rotation to the reference, and the variances of a turn about its axes, rad^2."""
    if frame != "reference":
        if rotation is not None or std_deg is not None:
            raise Refused(where, "rotation", f"does not belong to the frame `{frame}`", "use frame=`reference`")
        return None
    if rotation is None:
        raise Refused(where, "rotation", "is missing", "give the rotation from the sensor frame to the reference")
    matrix = _real(where, "rotation", rotation)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not is_rotation(matrix, _ROTATION):
        raise Refused(where, "rotation", "is no rotation of three rows", "give an orthogonal matrix with determinant +1")
    std = _real(where, "rotation_std_deg", 0.0 if std_deg is None else std_deg)
    if std.shape not in ((), (3,)) or not (std >= 0.0).all():
        raise Refused(where, "rotation_std_deg", "must be one or three numbers from zero on", "give degrees")
    return matrix, np.radians(np.broadcast_to(std, (3,))) ** 2
