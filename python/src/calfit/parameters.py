"""Parameters of a sensor from one file or from several that belong together, and their application to readings."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np

from . import calibrations
from .alignment import is_rotation
from .calibrations import Limits, Range
from .document import Document, load
from .errors import Refused
from .kinds import AXES, Kind, kind_of
from .quantities import Covariance, Quantities, quantities
from .state import State
from .steps import FRAMES, Applied, applied

#: The temperature lies outside of the range of a file.
TEMPERATURE = 1 << 0
#: The field or the reading lies outside of what was calibrated.
FIELD = 1 << 16
#: There is no temperature, and the parameters depend on it or the file states a range of temperatures.
NO_TEMPERATURE = 1 << 17
#: A component of the reading is missing or is no finite number.
NO_READING = 1 << 18

#: Readings that are calibrated at a time.
_BLOCK = 16_384
_CALIBRATIONS = ("CPF", "TPF", "TCF", "RPCMAG")
_OFFSETS = ("TOF", "OPF")


class Turn(NamedTuple):
    """The rotation from the sensor frame to the reference, the variances of a turn about its axes, rad^2, and the convention whose sensor
    frame it starts from, where that is not the frame of the file."""

    rotation: np.ndarray
    variances: np.ndarray
    convention: str | None = None


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
        self._reference: Turn | None = None
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
        if document.format not in ("CPF", "RPCMAG") and (offsets or how.offset is None):
            how = how._replace(offset=None)
        try:
            self._calibration = _calibration(document, how)
        except calibrations.NoOffset as refused:
            # Its sensitivities are read all the same.
            self._cannot = refused
            how = how._replace(offset=None)
            self._calibration = _calibration(document, how)
        self._own_offset = how.offset
        self._reference = _stated_reference(document, how)
        if offsets:
            self._take_offset(offsets[0], "b_off")
        elif how.offset is None and self._cannot is None:
            self._cannot = document.refuse("apply.offset", "is missing: the file has no offset", "name a TOF or OPF beside it")
        if "off-centre" in (document.get("location"), document.get("run.location")):
            self.notes.append(
                f"{document.file} holds for the field beside the centre of the coil system, which is not that of its settings; "
                "apply the TCF, whose sensitivities are those at the centre"
            )
        if (form := document.text("thermistor_lag.form")) is not None:
            self.notes.append(
                f"the temperatures of {document.file} are those of a part of the sensor that goes after the thermistor with a {form} of "
                f"{document.get('thermistor_lag.lag_s')} s: those given to apply have to be of this part"
            )
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
            return
        for own in self._offset.ranges:
            for held in self._calibration.ranges:
                if max(own.low, held.low) > min(own.high, held.high):
                    rule = f"covers {own.low} to {own.high} degC, {held.file} {held.low} to {held.high}"
                    raise document.refuse(own.key, rule, "name files that hold at a common temperature")

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
        only); ``"reference"``, the reference cube of the sensor, to which the file states the rotation in ``[reference]``. For a file
        that states none, ``rotation`` (3 x 3, from the sensor frame to the reference) may be given, and its standard uncertainty
        about the three axes of the reference, degrees.

        ``outside``: what happens to a reading that has one of the flags: ``"flag"``, the field is given all the same where there is
        one; ``"null"``, it is nan; ``"error"``, the first of them is refused.

        Gives ``b`` and ``u``, nT, with the shape of the readings and a last axis of three, and ``flags`` (uint32) with the shape of
        the readings: bit 0 temperature outside, bit 16 field or reading outside, bit 17 no temperature, bit 18 no finite reading. ``u`` is the standard
        uncertainty of the field by that of the parameters; the noise of the reading is not in it; nan for temperatures outside of the
        calibration, where none is stated. Group delay and frequency response are not applied.
        """
        where = ", ".join(self.files)
        if self._cannot is not None:
            raise self._cannot
        if self._effects is not None and not effects_taken_off:
            raise self._effects
        if outside not in ("flag", "null", "error"):
            raise Refused(where, "outside", f"is `{outside}`", "use `flag`, `null` or `error`")
        turn = self._turn(where, frame, rotation, rotation_std_deg)
        frame = "sensor" if turn is not None else frame
        if frame not in ("sensor", "coil"):
            raise Refused(where, "frame", f"is `{frame}`", "use `sensor`, `coil` or `reference`")
        if frame == "coil" and self._calibration.rotation is None:
            raise Refused(where, "frame", "is `coil`, but no rotation to coil axes is stated", "use `sensor`, or name a CPF")
        readings, t, shape = self._shaped(where, x, y, z, t_degc)
        flags = self._flags_of_temperature(t)
        flags[~np.isfinite(readings).all(axis=1)] |= NO_READING
        b, u = np.empty_like(readings), np.empty_like(readings)
        for begin in range(0, len(readings), _BLOCK):
            at = slice(begin, begin + _BLOCK)
            b[at], u[at], without, beyond = self._block(readings[at], t[at], frame, turn)
            flags[at] |= np.where(beyond, FIELD, 0).astype(np.uint32)
            if outside == "error" and flags[at].any():
                raise self._outside(where, begin + int(np.argmax(flags[at] != 0)), readings, t, flags)
            without |= (outside == "null") & (flags[at] != 0)
            b[at][without] = np.nan
            # Polynomials of the temperature state no uncertainty beyond their temperatures.
            u[at][without | ((flags[at] & TEMPERATURE) != 0)] = np.nan
        return b.reshape(*shape, 3), u.reshape(*shape, 3), flags.reshape(shape)

    def _shaped(self, where: str, x: Any, y: Any, z: Any, t_degc: Any) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
        components = [_real(where, name, value) for name, value in zip(AXES, (x, y, z))]
        shape = components[0].shape
        for name, component in zip(AXES, components):
            if component.shape != shape:
                raise Refused(where, name, f"has the shape {component.shape}, x {shape}", "give arrays of one shape")
        if t_degc is None:
            if self._calibration.needs_temperature:
                raise Refused(where, "t_degc", "is missing, and the parameters depend on it", "give the temperature in degC")
            t = np.full(shape, np.nan)
        else:
            t = _real(where, "t_degc", t_degc)
            if t.shape not in ((), shape):
                raise Refused(where, "t_degc", f"has the shape {t.shape}, x {shape}", "give a number, or one per reading")
            t = np.broadcast_to(t, shape)
        return np.stack([c.ravel() for c in components], axis=1), t.ravel(), shape

    def _turn(self, where: str, frame: str, rotation: Any, std_deg: Any) -> Turn | None:
        """The rotation of the field that a frame needs."""
        given = rotation is not None or std_deg is not None
        if frame == "reference" and self._reference is not None:
            if given:
                raise Refused(where, "rotation", "is given, and the file states one in `reference`", "leave it out")
            return self._reference
        if frame != "reference":
            if given:
                raise Refused(where, "rotation", f"does not belong to the frame `{frame}`", "use frame=`reference`")
            return None
        return _given_reference(where, rotation, std_deg)

    def _flags_of_temperature(self, t: np.ndarray) -> np.ndarray:
        flags = np.zeros(len(t), dtype=np.uint32)
        there = np.isfinite(t)
        # A calibration that depends on no temperature may say for which ones it holds.
        if self._calibration.needs_temperature or self.ranges:
            flags[~there] |= NO_TEMPERATURE
        for held in self.ranges:
            flags[there & ((t < held.low) | (t > held.high))] |= TEMPERATURE
        return flags

    def _outside(self, where: str, index: int, readings: np.ndarray, t: np.ndarray, flags: np.ndarray) -> Refused:
        """What is wrong with a reading that has a flag."""
        remedy = 'leave it out, or use outside="flag"'
        if flags[index] & NO_READING:
            return Refused(where, "x, y, z", f"are {readings[index].tolist()} at index {index}", remedy)
        if flags[index] & NO_TEMPERATURE:
            return Refused(where, "t_degc", f"is not known for the reading at index {index}", remedy)
        if flags[index] & TEMPERATURE:
            held = next(r for r in self.ranges if not r.low <= t[index] <= r.high)
            rule = f"covers {held.low} to {held.high} degC; the reading at index {index} has {t[index]} degC"
            return Refused(held.file, held.key, rule, remedy)
        linearisation, field = self._calibration.linearisation, self._calibration.field
        if linearisation is not None and linearisation.limits.left_by(readings[index : index + 1])[0]:
            rule = f"covers {_spans(linearisation.limits)} enT; the reading at index {index} is {readings[index].tolist()}"
            return Refused(linearisation.limits.file, linearisation.limits.key, rule, remedy)
        rule = f"covers {_spans(field.limits)} nT; the field of the reading at index {index} lies outside"
        return Refused(field.limits.file, field.limits.key, rule, remedy)

    def _block(
        self, readings: np.ndarray, t: np.ndarray, frame: str, turn: Turn | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Field, uncertainty, where there is no field, and where it lies outside of what was calibrated."""
        there = np.isfinite(t)
        # Where no temperature is needed, it is not looked at.
        t = np.where(there, t, 0.0)
        lacks = ~np.isfinite(readings).all(axis=1)
        if self._calibration.needs_temperature:
            lacks |= ~there
        linearisation = self._calibration.linearisation
        with np.errstate(invalid="ignore", over="ignore"):
            prepared = readings if linearisation is None else linearisation.linearised(readings)
            state = self._state(t, frame)
            without = prepared - state.offset
            b = (state.matrix @ without[..., None])[..., 0]
            # Angles that no three axes have between them make no field.
            lacks |= np.isnan(b).any(axis=1)
            beyond = self._beyond(readings, b, frame) & ~lacks
            if turn is not None:
                state = state.turned(turn.rotation, turn.convention)
                b = (state.matrix @ without[..., None])[..., 0]
            if self._unknown(frame):
                return b, np.full_like(b, np.nan), lacks, beyond
            variance = np.zeros_like(b)
            for term in state.terms:
                variance = variance + term.variance(t, state.matrix, without)
            if turn is not None:
                # A small turn about the axes of the reference changes the field by its vector product with the field.
                square = b**2
                about = turn.variances
                variance = variance + np.stack(
                    [about[j] * square[:, k] + about[k] * square[:, j] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1
                )
            # Rounding may make a variance near zero negative.
            return b, np.sqrt(np.maximum(variance, 0.0)), lacks, beyond

    def _state(self, t: np.ndarray, frame: str) -> State:
        state = self._calibration.at(t, frame)
        if self._offset is None:
            return state
        offset, terms = self._offset.at(t)
        return State(state.matrix, offset, [*state.terms, *terms])

    def _unknown(self, frame: str) -> bool:
        return bool(self._calibration.unknown_in(frame)) or (self._offset is not None and bool(self._offset.unknown))

    def _beyond(self, readings: np.ndarray, b: np.ndarray, frame: str) -> np.ndarray:
        """Whether a reading or its field, in the sensor frame or in coil axes, lies outside of what was calibrated."""
        found = np.zeros(len(readings), dtype=bool)
        if self._calibration.linearisation is not None:
            found |= self._calibration.linearisation.limits.left_by(readings)
        if (field := self._calibration.field) is not None:
            # Limits along coil axes are those of a CPF, whose field may stand in them already.
            in_their_axes = b if field.rotation is None or frame == "coil" else b @ field.rotation.T
            found |= field.limits.left_by(in_their_axes)
        return found


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
    keys = ["conditions.sensor_channel" if d.format == "OPF" else "channel" for d in (main[0], offsets[0])]
    channels = [d.text(key) for d, key in zip((main[0], offsets[0]), keys)]
    if channels[0] != channels[1] and None not in channels:
        rule = f"is `{channels[1]}`, that of {main[0].file} is `{channels[0]}`"
        raise offsets[0].refuse(keys[1], rule, "name files whose temperatures are of one thermistor")


def _effects(documents: list[Document]) -> Refused | None:
    """The effects that were taken off the readings before the fit: the parameters hold for readings without them."""
    for document in documents:
        if document.format not in _CALIBRATIONS:
            continue
        if document.get("known_effects") is not None and (files := document.texts("known_effects")):
            return _taken_off(document, "known_effects", files)
        for key in ("model", "sweep.model"):
            # In a ground calibration file `model` is the equation.
            if isinstance(document.get(key), dict):
                file = document.text(f"{key}.file")
                return _taken_off(document, key, [] if file is None else [file])
        # Polynomials of before `known_effects` say so among their inputs only.
        inputs = document.get("provenance.input")
        if isinstance(inputs, list) and any(isinstance(i, dict) and i.get("role") == "model" for i in inputs):
            return _taken_off(document, "provenance.input", [])
    return None


def _taken_off(document: Document, key: str, files: list[str]) -> Refused:
    of = f"the effects of {', '.join(files)}" if files else "known effects"
    rule = f"says that {of} were taken off the readings before the fit, which this package does not do"
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


def _spans(limits: Limits) -> str:
    return ", ".join(f"{axis} {low} to {high}" for axis, (low, high) in zip(AXES, limits.values))


def _stated_reference(document: Document, how: Applied) -> Turn | None:
    """The rotation from the sensor frame of a file to the reference cube, where the file states it."""
    if not document.table("reference"):
        return None
    assert how.convention is not None
    known, stated = FRAMES[how.convention], document.text("reference.from")
    if stated != known:
        raise document.refuse("reference.from", f"is `{stated}`, not the frame of the file, `{known}`")
    rotation = document.needed("reference.rotation", (3, 3))
    if not is_rotation(rotation):
        raise document.refuse("reference.rotation", "is no rotation")
    std = float(document.needed("reference.std_deg", ()))
    if std < 0.0:
        raise document.refuse("reference.std_deg", "must not be negative")
    variances = np.full(3, np.radians(std) ** 2)
    # A matrix of one temperature has one rotation; where its angles move, the frame for which another convention states it moves with them.
    if document.format != "CPF" and document.get("reference.stated_rotation") is not None:
        stated_rotation = document.needed("reference.stated_rotation", (3, 3))
        if not is_rotation(stated_rotation):
            raise document.refuse("reference.stated_rotation", "is no rotation")
        return Turn(stated_rotation, variances, document.text("reference.stated_for"))
    return Turn(rotation, variances)


def _given_reference(where: str, rotation: Any, std_deg: Any) -> Turn:
    if rotation is None:
        raise Refused(where, "rotation", "is missing, and the file states none", "give the rotation from the sensor frame to the reference")
    matrix = _real(where, "rotation", rotation)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not is_rotation(matrix):
        raise Refused(where, "rotation", "is no rotation of three rows", "give an orthogonal matrix with determinant +1")
    std = _real(where, "rotation_std_deg", 0.0 if std_deg is None else std_deg)
    if std.shape not in ((), (3,)) or not (std >= 0.0).all():
        raise Refused(where, "rotation_std_deg", "must be one or three numbers from zero on", "give degrees")
    return Turn(matrix, np.radians(np.broadcast_to(std, (3,))) ** 2)
