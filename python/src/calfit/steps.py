"""The table `[apply]`: how the coefficients of a file are applied. What it says has to be known here, or the file is refused."""

from __future__ import annotations

from typing import NamedTuple

from . import alignment
from .document import Document

_CONVENTIONS = {"BepiColombo": alignment.BEPICOLOMBO, "Rosetta": alignment.ROSETTA}
FRAMES = {
    alignment.BEPICOLOMBO: "sensor (BepiColombo): x along sensor axis x, y in the plane of x and y",
    alignment.ROSETTA: "sensor (Rosetta): x along the first column of omega, y in the plane of the first two columns; the columns "
    "are the directions in which a field shows on one component only",
}
_BEFORE = "along the sensor axes, before sigma and omega"
_CORE = ("sigma", "omega")
#: Kinds that may hold the linearisation with which their runs were calibrated.
_LINEARISED = ("CPF", "TPF", "TCF")
_TO_COIL = ("rho", "r_nom")
_OFFSET = {"acts": "before the matrix", "sign": "subtracted", "unit": "enT"}
_REMEDY = "use a version of this package that knows it, or take the file from its source again"


class Applied(NamedTuple):
    """How a file is applied, as far as this package knows such files."""

    #: The readings are linearised first.
    linearise: bool
    #: `b_or` or `b_off`, or None for a file without an offset.
    offset: str | None
    #: `bepicolombo` or `rosetta`, or None for a file without omega.
    convention: str | None
    #: rho and r_nom follow, to coil axes.
    to_coil: bool
    #: The frame of the result as the file states it.
    frame: str


def applied(document: Document) -> Applied | None:
    """What a file says of its application; files without `[apply]` by the rules of their time. None for a kind that is not applied."""
    form = document.format
    if form not in ("CPF", "OPF", "TPF", "TOF", "TCF", "RPCMAG", "LINEARISATION"):
        return None
    if document.get("apply") is None:
        return _without_table(document)
    apply = document.table("apply")
    steps = document.texts("apply.steps")
    frame = document.text("apply.frame")
    if frame is None:
        raise document.refuse("apply.frame", "is missing")
    for key in apply:
        if key not in ("steps", "omega", "omega_formula", "q_formula", "offset", "frame"):
            document.notes.append(f"{document.file}: the key `apply.{key}` is not known and was left")
    rest = list(steps)
    linearise = rest[:1] == ["linearise"]
    if linearise:
        rest = rest[1:]
    subtract = rest[:1] == ["subtract_offset"]
    if subtract:
        rest = rest[1:]
    core = tuple(rest[:2]) == _CORE
    if core:
        rest = rest[2:]
    to_coil = core and tuple(rest) == _TO_COIL
    if rest and not to_coil:
        raise document.refuse("apply.steps", f"holds {steps}: `{rest[0]}` is not known there", _REMEDY)
    offset = _offset(document, subtract)
    convention = _convention(document, core)
    found = Applied(linearise, offset, convention, to_coil, frame)
    _belongs(document, found)
    return found


def _offset(document: Document, subtract: bool) -> str | None:
    table = document.table("apply.offset")
    if bool(table) != subtract:
        raise document.refuse("apply.offset", "and the step `subtract_offset` must stand together")
    if not table:
        return None
    for key, known in _OFFSET.items():
        if document.text(f"apply.offset.{key}") != known:
            raise document.refuse(f"apply.offset.{key}", f"is `{table.get(key)}`, not `{known}`", _REMEDY)
    quantity = document.text("apply.offset.quantity")
    if quantity not in ("b_or", "b_off"):
        raise document.refuse("apply.offset.quantity", f"is `{quantity}`, neither `b_or` nor `b_off`", _REMEDY)
    return quantity


def _convention(document: Document, core: bool) -> str | None:
    convention = document.text("apply.omega")
    if (convention is not None) != core:
        raise document.refuse("apply.omega", "and the steps `sigma`, `omega` must stand together")
    if convention is None:
        return None
    if convention not in alignment.FORMULA:
        raise document.refuse("apply.omega", f"is `{convention}`, neither `bepicolombo` nor `rosetta`", _REMEDY)
    known = alignment.FORMULA[convention]
    if document.format == "RPCMAG" and convention == alignment.ROSETTA:
        known = alignment.FORMULA_WITH_K
    formula = document.text("apply.omega_formula")
    if formula != known:
        raise document.refuse(
            "apply.omega_formula", f"is `{formula}`, which is not `{known}` of the convention {convention}", _REMEDY
        )
    q_formula = document.text("apply.q_formula")
    if q_formula is not None and q_formula != alignment.Q_FORMULA:
        raise document.refuse("apply.q_formula", "is not the one that is known", _REMEDY)
    return convention


def _belongs(document: Document, found: Applied) -> None:
    """Whether it is what files of the kind are applied like."""
    form = document.format
    core = found.convention is not None
    fits = {
        "CPF": core and found.offset == "b_or",
        "TPF": core and found.offset is not None and not found.to_coil,
        "TCF": core and found.offset in (None, "b_off") and not found.to_coil,
        "RPCMAG": core and found.offset == "b_off" and found.convention == alignment.ROSETTA and not found.to_coil,
        "OPF": not core and found.offset == "b_off",
        "TOF": not core and found.offset == "b_off",
        "LINEARISATION": not core and found.offset is None and found.linearise,
    }[form]
    if not fits:
        raise document.refuse("apply.steps", f"is not how {form} files are applied", _REMEDY)
    if form not in (*_LINEARISED, "LINEARISATION") and found.linearise:
        raise document.refuse("apply.steps", f"linearises, for which {form} files hold no coefficients", _REMEDY)
    if form == "CPF":
        stated = cpf_convention(document)
        if stated is not None and stated != found.convention:
            raise document.refuse(
                "matrix.omega_convention", f"contradicts `apply.omega`, {found.convention}", "correct the file, or fit again"
            )
    if form in _LINEARISED and found.linearise != bool(document.table("linearisation")):
        raise document.refuse("linearisation", "and the step `linearise` must stand together")


def cpf_convention(document: Document) -> str | None:
    """The convention that the matrices of a CPF state."""
    stated = document.text("matrix.omega_convention")
    if stated is None:
        return None
    if stated not in _CONVENTIONS:
        raise document.refuse("matrix.omega_convention", f"is `{stated}`, neither `BepiColombo` nor `Rosetta`", _REMEDY)
    return _CONVENTIONS[stated]


def _without_table(document: Document) -> Applied:
    """Files of before `[apply]`: a TPF is in the convention BepiColombo, a CPF in the one that it names."""
    form = document.format
    if form in ("OPF", "TOF"):
        return Applied(False, "b_off", None, False, _BEFORE)
    if form == "LINEARISATION":
        return Applied(True, None, None, False, "along the sensor axes, enT")
    if form == "CPF":
        convention = cpf_convention(document) or alignment.BEPICOLOMBO
        # Files of other programs may hold sensitivities and angles alone.
        to_coil = document.get("matrix.rho") is not None and document.get("matrix.r_nom") is not None
        return Applied(bool(document.table("linearisation")), "b_or", convention, to_coil, FRAMES[convention])
    if form == "TPF":
        linearise = bool(document.table("linearisation"))
        return Applied(linearise, "b_or", alignment.BEPICOLOMBO, False, FRAMES[alignment.BEPICOLOMBO])
    if form == "RPCMAG":
        return Applied(False, "b_off", alignment.ROSETTA, False, FRAMES[alignment.ROSETTA])
    raise document.refuse("apply", "is missing", "make the file again")
