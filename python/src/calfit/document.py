"""A parameter file as a tree of values: text, hash, format and version."""

from __future__ import annotations

import hashlib
import json
import math
import os
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .errors import Refused

CHECK = "check the file, or take it from its source again"


@dataclass(frozen=True)
class Document:
    """One file. Keys are named by their path: `matrix.sigma`."""

    file: str
    format: str
    version: int
    data: dict[str, Any]
    notes: list[str] = field(default_factory=list)

    def refuse(self, key: str, rule: str, remedy: str = CHECK) -> Refused:
        return Refused(self.file, key, rule, remedy)

    def get(self, path: str) -> Any:
        """The value under a path, or None."""
        value: Any = self.data
        for part in path.split("."):
            if not isinstance(value, dict) or part not in value:
                return None
            value = value[part]
        return value

    def table(self, path: str) -> dict[str, Any]:
        """A table; empty where there is none."""
        value = self.get(path)
        if value is None:
            return {}
        if not isinstance(value, dict):
            raise self.refuse(path, "is no table")
        return value

    def text(self, path: str) -> str | None:
        value = self.get(path)
        if value is not None and not isinstance(value, str):
            raise self.refuse(path, "is no text")
        return value

    def texts(self, path: str) -> list[str]:
        value = self.get(path)
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self.refuse(path, "must be a list of texts")
        return value

    def numbers(self, path: str, shape: tuple[int, ...] | None = None, *, finite: bool = True) -> np.ndarray | None:
        """Numbers under a path, or None; `shape` is what they must have, with -1 for any length above zero."""
        value = self.get(path)
        if value is None:
            return None
        found = as_numbers(value)
        if found is None:
            raise self.refuse(path, "must be numbers")
        if shape is not None:
            fits = found.ndim == len(shape) and all(n == w or (w == -1 and n > 0) for n, w in zip(found.shape, shape))
            if not fits:
                if -1 in shape:
                    raise self.refuse(path, "must be a list of numbers, at least one")
                raise self.refuse(path, f"has the shape {list(found.shape)}, not {list(shape)}")
        if finite and not np.isfinite(found).all():
            raise self.refuse(path, "holds a value that is not determined (nan)")
        return found

    def needed(self, path: str, shape: tuple[int, ...] | None = None) -> np.ndarray:
        found = self.numbers(path, shape)
        if found is None:
            raise self.refuse(path, "is missing")
        return found


def as_numbers(value: Any) -> np.ndarray | None:
    """Numbers and lists of them; null, as which JSON writes a number that is none, is nan. None for anything else."""

    def number(v: Any) -> Any:
        if isinstance(v, list):
            return [number(item) for item in v]
        if v is None:
            return math.nan
        if isinstance(v, bool) or not isinstance(v, (int, float)):
            raise TypeError
        return float(v)

    if value is None or value == []:
        return None
    try:
        return np.array(number(value), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None


def content_hash(text: str) -> str:
    """The hash of a file without its lines `created` and `content_sha256`."""
    lines = text.split("\n")
    if lines and lines[-1] == "":
        lines.pop()
    digest = hashlib.sha256()
    for line in lines:
        line = line.removesuffix("\r")
        if not line.startswith(("created = ", "content_sha256 = ")):
            digest.update(line.encode() + b"\n")
    return digest.hexdigest()


def load(path: str | os.PathLike[str]) -> Document:
    """Reads the text of a parameter file, TOML or its JSON twin, and compares its hash where it has one."""
    path = Path(path)
    file = str(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise Refused(file, "", f"cannot be read: {error.strerror}", "name a parameter file") from error
    except UnicodeDecodeError as error:
        raise Refused(file, "", "is not UTF-8 text", "take it from the archive again") from error
    notes: list[str] = []
    if text.lstrip().startswith("{"):
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise Refused(file, "", f"is not JSON: {error}", "take it from the archive again") from error
    else:
        try:
            data = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise Refused(file, "", f"is not TOML: {error}", "take it from the archive again") from error
        stated = next((line[len("content_sha256 = ") :] for line in text.split("\n") if line.startswith("content_sha256 = ")), None)
        if stated is None:
            notes.append(f"{file} carries no hash of its content, so that a change would not show")
        elif stated.strip().strip('"') != content_hash(text):
            raise Refused(
                file,
                "provenance.content_sha256",
                "does not match: the file was changed after it was written",
                "take the original, or fit again",
            )
    form, version = data.get("format"), data.get("version")
    if not isinstance(form, str):
        raise Refused(file, "format", "is missing", "name a parameter file of calfit")
    if isinstance(version, bool) or not isinstance(version, int):
        raise Refused(file, "version", "is missing", "name a parameter file of calfit")
    return Document(file, form, version, data, notes)
