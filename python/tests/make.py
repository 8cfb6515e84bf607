"""Parameter files as a program may write them, and a sensor from its definition. Nothing here calls the package."""

from __future__ import annotations

import copy
import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np

BEPICOLOMBO = "omega = inverse(transpose(Q(xi)))"
ROSETTA = "omega = Q(xi)"
OFFSET = {"acts": "before the matrix", "sign": "subtracted", "unit": "enT"}

SIGMA = (0.98, 1.02, 0.995)
XI_DEG = (89.8, 90.3, 90.05)
OFFSET_ENT = (12.5, -8.25, 3.75)


def toml(value: Any) -> str:
    """A value as TOML; numbers to their last digit."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(toml(v) for v in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace('"', '\\"') + '"'
    return repr(float(value)) if isinstance(value, (float, np.floating)) else repr(value)


def text(document: dict[str, Any], *, hashed: bool = True) -> str:
    """The text of a file: keys first, then tables, with the hash of its content as its format has it."""
    document = copy.deepcopy(document)
    tables = {k: document.pop(k) for k in list(document) if isinstance(document[k], dict)}
    lines = [f"{k} = {toml(v)}" for k, v in document.items()]
    lines += ["[provenance]", 'tool = "a test"', 'created = "2026-01-01T00:00:00Z"']
    if hashed:
        lines.append('content_sha256 = ""')
    for name, table in tables.items():
        lines += [f"[{name}]"] + [f"{k} = {toml(v)}" for k, v in table.items()]
    if hashed:
        kept = [line for line in lines if not line.startswith(("created = ", "content_sha256 = "))]
        digest = hashlib.sha256("".join(line + "\n" for line in kept).encode()).hexdigest()
        lines = [line.replace('content_sha256 = ""', f'content_sha256 = "{digest}"') for line in lines]
    return "\n".join(lines) + "\n"


def put(folder: Path, name: str, document: dict[str, Any], *, hashed: bool = True) -> Path:
    path = folder / name
    path.write_text(text(document, hashed=hashed))
    return path


def changed(document: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """The same with another value under a path; None takes the key away."""
    document = copy.deepcopy(document)
    *tables, key = path.split(".")
    at = document
    for table in tables:
        at = at.setdefault(table, {})
    if value is None:
        at.pop(key, None)
    else:
        at[key] = value
    return document


def apply(convention: str = "bepicolombo", offset: str | None = "b_or", extra: tuple[str, ...] = ()) -> dict[str, Any]:
    formula = {"bepicolombo": BEPICOLOMBO, "rosetta": ROSETTA}[convention]
    steps = [*(["subtract_offset"] if offset else []), "sigma", "omega", *extra]
    table = {"steps": steps, "omega": convention, "omega_formula": formula, "frame": f"sensor ({convention})"}
    return table | ({"offset": {"quantity": offset, **OFFSET}} if offset else {})


def axes(xi_deg: Any) -> np.ndarray:
    """Three unit vectors as rows with the angles xy, xz, yz between them: the first along x, the second in the plane of x and y."""
    xy, xz, yz = (math.radians(a) for a in xi_deg)
    y = (math.cos(yz) - math.cos(xy) * math.cos(xz)) / math.sin(xy)
    return np.array(
        [
            [1.0, 0.0, 0.0],
            [math.cos(xy), math.sin(xy), 0.0],
            [math.cos(xz), y, math.sqrt(1.0 - math.cos(xz) ** 2 - y**2)],
        ]
    )


def reading(field: Any, sigma: Any = SIGMA, xi_deg: Any = XI_DEG, offset: Any = OFFSET_ENT) -> np.ndarray:
    """What a sensor reads whose axes have these angles between them: the field along each axis over its sensitivity, and its offset."""
    return axes(xi_deg) @ np.asarray(field, dtype=float) / np.asarray(sigma) + np.asarray(offset)


def turn(degrees: Any) -> np.ndarray:
    """A rotation about x, then y, then z."""
    a, b, c = (math.radians(d) for d in degrees)
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    about_z = np.array([[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


RHO = turn((0.4, -0.7, 0.25))
#: Position 4 of the campaign of 2013, X_m = -Z_c, Y_m = Y_c, Z_m = X_c: rows of the inverse.
R_NOM = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


def cpf(sigma: Any = SIGMA, xi_deg: Any = XI_DEG, offset: Any = OFFSET_ENT) -> dict[str, Any]:
    """A linear calibration whose matrices are the inverse of what the sensor reads."""
    transfer = np.linalg.inv(axes(xi_deg)) * np.asarray(sigma)
    return {
        "format": "CPF",
        "version": 1,
        "apply": apply(extra=("rho", "r_nom")),
        "run": {"id": "26-01-01_00-00-00", "sensor": "FM 1", "mode": "science", "temperature_degc": 20.0},
        "matrix": {
            "omega_convention": "BepiColombo",
            "r_nom": R_NOM,
            "rho": RHO,
            "omega": np.linalg.inv(axes(xi_deg)),
            "sigma": np.diag(sigma),
            "phi": R_NOM @ RHO @ transfer,
            "phi_tilde": transfer,
        },
        "angle_deg": dict(zip(("xi_xy", "xi_xz", "xi_yz"), xi_deg)),
        "offset": {"b_or_ent": list(offset)},
        "std": {"sigma": [1e-5, 2e-5, 3e-5], "xi_deg": [1e-3, 2e-3, 3e-3], "b_or_ent": [0.01, 0.02, 0.03]},
    }


C2_PER_ENT = (1e-9, -2e-9, 0.0)
C3_PER_ENT2 = (3e-14, 0.0, -4e-14)


def linearised(document: dict[str, Any], reading_ent: Any = ((-1e5, 1e5),) * 3) -> dict[str, Any]:
    """The same for readings that are linearised first."""
    steps = ["linearise", *document["apply"]["steps"]]
    applied = {"c2_per_ent": C2_PER_ENT, "c3_per_ent2": C3_PER_ENT2, "reading_ent": reading_ent}
    return changed(document, "apply.steps", steps) | {"linearisation": {"file": "L.toml", "applied": applied}}


#: sigma(T), xi(T) and offset(T) of the files below, lowest order first.
LINES = {
    "sigma_x": (0.98, -1.8e-5),
    "sigma_y": (1.02, -1.6e-5, 2e-8),
    "sigma_z": (0.995, 2e-5),
    "xi_xy": (89.8, -4e-5),
    "xi_xz": (90.3, 5e-5),
    "xi_yz": (90.05, -1e-4),
}
B_OR = {"b_or_x": (12.5, 0.05), "b_or_y": (-8.25, -0.02, 1e-4), "b_or_z": (3.75,)}
B_OFF = {"b_off_x": (2.5, 0.02), "b_off_y": (-1.25, 0.01), "b_off_z": (0.75, -0.03)}


def at(lines: dict[str, Any], stem: str, t: float) -> list[float]:
    """Three polynomials at a temperature."""
    names = [n for n in lines if n.startswith(f"{stem}_")]
    return [sum(c * t**k for k, c in enumerate(lines[n])) for n in names]


def covariances(lines: dict[str, Any], scale: float) -> dict[str, Any]:
    """A covariance of the coefficients of each: standard deviations scale/10^k, correlation -0.5 between neighbours."""
    found = {}
    for name, coefficients in lines.items():
        n = len(coefficients)
        size = [scale / 10.0**k for k in range(n)]
        found[name] = [[size[i] * size[j] * (-0.5) ** abs(i - j) for j in range(n)] for i in range(n)]
    return found


def thermal(form: str, lines: dict[str, Any], version: int = 1) -> dict[str, Any]:
    return {
        "format": form,
        "version": version,
        **{k: list(v) for k, v in lines.items()},
        "used": ["A.CPF"],
        "channel": "T59",
        "valid_degc": [-40.0, 80.0],
        "sensor": "FM 1",
        "mode": "science",
    }


def tpf() -> dict[str, Any]:
    found = thermal("TPF", LINES | B_OR)
    return found | {"apply": apply(), "covariance": covariances(LINES, 1e-5) | covariances(B_OR, 0.1)}


def tof() -> dict[str, Any]:
    table = {"steps": ["subtract_offset"], "frame": "along the sensor axes", "offset": {"quantity": "b_off", **OFFSET}}
    return thermal("TOF", B_OFF) | {"apply": table, "covariance": covariances(B_OFF, 0.2)}


def opf() -> dict[str, Any]:
    table = {"steps": ["subtract_offset"], "frame": "along the sensor axes", "offset": {"quantity": "b_off", **OFFSET}}
    return {
        "format": "OPF",
        "version": 1,
        "offset_ent": [2.0, -3.0, 4.0],
        "offset_std_ent": [0.1, 0.2, 0.3],
        "residual_ent": [math.nan, 1.0, 2.0],
        "apply": table,
        "run": {"id": "26-01-01_00-00-00", "sensor": "FM 1", "mode": "science", "temperature_degc": 20.0},
    }


def tcf() -> dict[str, Any]:
    found = thermal("TCF", LINES | B_OFF, version=2)
    found |= {"sigma_remainder": [0.0] * 3, "xi_remainder_deg": [0.0] * 3}
    return found | {"apply": apply("rosetta", "b_off"), "covariance": covariances(LINES, 1e-5) | covariances(B_OFF, 0.2)}


def rpcmag() -> dict[str, Any]:
    return {
        "format": "RPCMAG",
        "version": 2,
        "sensor": "FM 1",
        "mode": "science",
        "omega_convention": "Rosetta",
        "offset_acts": "before the matrix",
        "offset_sign": "subtracted",
        "offset_unit": "enT",
        "model": "B = omega sigma (B_r - B_off)",
        "valid_degc": [-40.0, 80.0],
        "A_0": [12.0, -8.0, 3.0],
        "A_1": [0.05, -0.02, 0.0],
        "B_RES": [1.0, 2.0, -3.0],
        "SIGMA_00": [0.98, 1.02, 0.995],
        "SIGMA_01": [-1.8e-5, -1.6e-5, 2e-5],
        "XI_10": [90.2, 89.7, 89.95],
        "XI_11": [4e-5, -5e-5, 1e-4],
        "K_0": [1.0, 2e-3, -1e-3],
        "K_1": [0.0, 1.000002, 3e-3],
        "K_2": [0.0, 0.0, 1.000005],
        "T_0": -245.3,
        "T_1": 200.0,
        "T_2": 1.0,
        "T_3": 0.0,
        "T_OFF": 0.1,
        "apply": apply("rosetta", "b_off")
        | {"omega_formula": "omega = Q(xi) inverse(K), the rows of inverse(K) are K_0, K_1, K_2"},
        "std": {
            "A_0": [0.1, 0.2, 0.3],
            "A_1": [0.001, 0.002, 0.003],
            "B_RES": [0.04, 0.05, 0.06],
            "SIGMA_00": [1e-5, 2e-5, 3e-5],
            "SIGMA_01": [1e-7, 2e-7, 3e-7],
            "XI_10": [1e-3, 2e-3, 3e-3],
            "XI_11": [1e-5, 2e-5, 3e-5],
            "K_0": [0.0, 1e-5, 2e-5],
            "K_1": [0.0, 1e-7, 3e-5],
            "K_2": [0.0, 0.0, 2e-7],
        },
    }
