"""Values, units, standard uncertainties and covariances of a file, under the paths of its keys.

Where a file states combined uncertainties (`std_combined`, `covariance_combined`: type A and type B), these are taken, otherwise those of
type A.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .document import Document, as_numbers
from .kinds import Kind

#: Units by the end of a key, for kinds of files without a table of quantities.
_BY_END = (
    ("nt_per_eu", "nT/EU"),
    ("_nt_per_k", "nT/K"),
    ("ent_per_root_hz", "enT/sqrt(Hz)"),
    ("nt_per_root_hz", "nT/sqrt(Hz)"),
    # Coefficients of the orders 1, 2, ... of a drift.
    ("_ent_per_h", "enT/h^k"),
    ("_nt_per_h", "nT/h^k"),
    ("_per_ent2", "1/enT^2"),
    ("_per_ent", "1/enT"),
    ("_per_k", "1/K"),
    ("_degc", "degC"),
    ("_deg", "deg"),
    ("_ent", "enT"),
    ("_nt", "nT"),
    ("_hz", "Hz"),
    ("_ms", "ms"),
    ("_s", "s"),
    ("_h", "h"),
)
#: What describes a file and is no quantity of it.
_NOT_VALUES = ("format", "version", "provenance", "apply", "convention", "warnings", "warning_kinds", "std", "std_b", "std_combined", "together", "together_combined")


class Covariance(NamedTuple):
    """Covariance of some numbers of a file."""

    #: Names of rows and columns.
    parameters: tuple[str, ...]
    #: Units of the parameters.
    units: tuple[str, ...]
    matrix: np.ndarray

    def of(self, names: list[str]) -> np.ndarray | None:
        """The part of some parameters in their order; None where one of them is not among them."""
        if not set(names) <= set(self.parameters):
            return None
        where = [self.parameters.index(name) for name in names]
        return self.matrix[np.ix_(where, where)]


class Quantities(NamedTuple):
    """What a file states, by the path of its keys."""

    values: dict[str, Any]
    units: dict[str, str]
    std: dict[str, Any]
    covariance: dict[str, Covariance]


def power_unit(unit: str, order: int) -> str:
    """Unit of the coefficient of an order."""
    return unit if order == 0 else f"{unit}/degC^{order}"


def known_coefficients(document: Document, path: str) -> np.ndarray | None:
    """Coefficients of a polynomial; None where there are none, or where they are not determined (nan)."""
    found = document.numbers(path, (-1,), finite=False)
    if found is None or np.isnan(found).all():
        return None
    return document.numbers(path, (-1,))


def stated_covariance(document: Document, name: str, count: int) -> np.ndarray | None:
    """Covariance of the coefficients of a polynomial: the combined one where it is stated."""
    for table in ("covariance_combined", "covariance"):
        found = document.numbers(f"{table}.{name}", (count, count))
        if found is not None:
            return found
    return None


def covariance_table(document: Document, path: str) -> Covariance | None:
    """A covariance with the names of its parameters."""
    table = document.table(path)
    if "parameters" not in table:
        return None
    parameters = document.texts(f"{path}.parameters")
    count = len(parameters)
    units = document.texts(f"{path}.units") if "units" in table else [""] * count
    if len(units) != count or len(set(parameters)) != count:
        raise document.refuse(f"{path}.parameters", "must be one name and one unit per parameter")
    matrix = document.numbers(f"{path}.matrix", (count, count), finite=False)
    if matrix is None:
        raise document.refuse(f"{path}.matrix", "is missing")
    return Covariance(tuple(parameters), tuple(units), matrix)


def stated_std(document: Document, path: str) -> np.ndarray | None:
    """A standard uncertainty: the combined one where it is stated beside `std`, or for `offset_std_ent` under `std_combined.offset_ent`."""
    begin, _, rest = path.partition(".")
    if begin != "std":
        name, between, unit = path.partition("_std_")
        rest = f"{name}_{unit}" if between else ""
    if rest:
        combined = document.numbers(f"std_combined.{rest}", finite=False)
        if combined is not None:
            return combined
    return document.numbers(path, finite=False)


def _plain(found: np.ndarray) -> Any:
    """A number as a float, lists of them as an array."""
    return float(found) if found.ndim == 0 else found


def quantities(document: Document, kind: Kind) -> Quantities:
    """All of a file."""
    all_of = Quantities({}, {}, {}, {})
    for name, unit in kind.polynomials:
        for path in (name, f"off_centre.coefficients.{name}"):
            coefficients = known_coefficients(document, path)
            if coefficients is None:
                continue
            all_of.values[path], all_of.units[path] = coefficients, unit
            if path == name:
                matrix = stated_covariance(document, name, len(coefficients))
            else:
                matrix = document.numbers(f"off_centre.covariance.{name}", (len(coefficients), len(coefficients)))
            if matrix is None:
                continue
            orders = range(len(coefficients))
            names = tuple(f"{path}.{k}" for k in orders)
            all_of.covariance[path] = Covariance(names, tuple(power_unit(unit, k) for k in orders), matrix)
            # Rounding may make a variance near zero negative.
            all_of.std[path] = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
    for quantity in kind.quantities or ():
        found = document.numbers(quantity.path, finite=False)
        if found is None:
            continue
        all_of.values[quantity.path], all_of.units[quantity.path] = _plain(found), quantity.unit
        std = stated_std(document, quantity.std) if quantity.std else None
        if std is None:
            continue
        if quantity.takes is not None:
            if std.ndim != 1 or len(std) <= quantity.takes:
                raise document.refuse(quantity.std, "lacks a number")
            std = std[quantity.takes]
        elif quantity.diagonal:
            std = np.diag(std)
        if std.shape != found.shape:
            raise document.refuse(quantity.std, f"has not the shape of `{quantity.path}`")
        all_of.std[quantity.path] = _plain(std)
    if kind.quantities is None:
        _every_number(document, all_of)
    for path in ("covariance_combined", "covariance"):
        if (table := covariance_table(document, path)) is not None:
            all_of.covariance["covariance"] = table
            break
    for path in ("together_combined", "together"):
        if (table := covariance_table(document, path)) is not None:
            all_of.covariance["together"] = table
            break
    return all_of


def _unit(path: str) -> str:
    """The unit that the end of a key names; empty where it names none, or a rate that is not known."""
    key = path.rpartition(".")[2]
    return next((unit for end, unit in _BY_END if key.endswith(end) and ("_per_" in end or "_per_" not in key)), "")


def _every_number(document: Document, all_of: Quantities) -> None:
    """The numbers of a kind without a table: units by the ends of the keys, uncertainties by `std` in them."""

    def walk(path: str, value: Any) -> None:
        if isinstance(value, dict) and "value" in value and isinstance(value.get("unit"), str):
            # A parameter that names itself.
            for key, into in (("value", all_of.values), ("std", all_of.std)):
                found = as_numbers(value.get(key))
                if found is not None:
                    into[path] = _plain(found)
            all_of.units[path] = value["unit"]
        elif isinstance(value, dict):
            for key, inner in value.items():
                if path or (key not in _NOT_VALUES and not key.startswith("covariance")):
                    walk(f"{path}.{key}" if path else key, inner)
        elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
            names = [item.get("name") for item in value]
            named = all(isinstance(name, str) for name in names) and len(set(names)) == len(names)
            for index, item in enumerate(value):
                walk(f"{path}.{names[index] if named else index}", item)
        elif not isinstance(value, bool) and (found := as_numbers(value)) is not None:
            all_of.values[path] = _plain(found)
            unit = _unit(path)
            if unit:
                all_of.units[path] = unit

    walk("", document.data)
    # `offset_std_degc` is the uncertainty of `offset_degc`.
    for path in list(all_of.values):
        of = path.replace("_std", "", 1)
        if of != path and of in all_of.values:
            all_of.std[of] = all_of.values.pop(path)
            all_of.units.pop(path, None)
    for key, value in document.table("std").items():
        if as_numbers(value) is None:
            continue
        std = stated_std(document, f"std.{key}")
        named = [path for path in all_of.values if path == key or path.endswith(f".{key}")]
        if len(named) >= 1 and std is not None:
            # The first one is that of the file itself, later ones of its parts.
            all_of.std[min(named, key=lambda p: p.count("."))] = _plain(std)
