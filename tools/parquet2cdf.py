#!/usr/bin/env python3
"""ISTP-compliant CDF files of the Parquet files that `calfit flight` writes.

    python3 tools/parquet2cdf.py LEVEL.parquet... -o DIR

Needs cdflib, pyarrow and numpy. Values are passed on to the last bit; nulls become the fill value of their type. What a level
does not say of itself is stated with --say, what ISTP asks for beyond that with --attribute. Equal levels give equal bytes.
Exit status 0: all files were written; 1: some were not, each is named.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
from pathlib import Path

import cdflib
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from cdflib import cdfwrite

#: Epoch of the first vector that a mission may have, and of the last one.
EPOCH_RANGE = ([1990, 1, 1, 0, 0, 0, 0, 0, 0], [2100, 1, 1, 0, 0, 0, 0, 0, 0])
NO_TIME = np.iinfo(np.int64).min

#: CDF type, fill value, lowest and highest value that can be valid, format, by type in the level.
TYPES = {
    "double": ("CDF_DOUBLE", -1e31, None, None, "E24.16"),
    "float": ("CDF_FLOAT", np.float32(-1e31), None, None, "E14.6"),
    "uint8": ("CDF_UINT1", 255, 0, 254, "I3"),
    "uint32": ("CDF_UINT4", 2**32 - 1, 0, 2**32 - 2, "I10"),
    "int64": ("CDF_INT8", NO_TIME, NO_TIME + 1, 2**63 - 1, "I20"),
}

#: Variable, unit, label, description, lowest and highest valid value, by column, or by what three columns of a vector share.
KNOWN = {
    "b": ("B", "nT", "B", "Magnetic field, {frame}", -1e6, 1e6),
    "b_ob": ("B_OB", "enT", "B OB", "Outboard sensor in housekeeping, not calibrated", -16384, 16384),
    "b_ib": ("B_IB", "enT", "B IB", "Inboard sensor in housekeeping, not calibrated", -16384, 16384),
    "position": ("position", "km", "position", "Position of the spacecraft, {frame}", -1e12, 1e12),
    "ua": ("ua", "nT", "ua", "Standard uncertainty, independent from vector to vector", 0, 1e6),
    "uc": ("uc", "nT", "uc", "Standard uncertainty, common to all vectors of the file", 0, 1e6),
    "t_degc": ("T", "degC", "T", "Temperature of the sensor", -273.15, 1e3),
    "time_obt": ("time_obt", "s", "clock", "Spacecraft clock, SI seconds since 2003-01-01T00:00:00 UTC", -1e10, 1e10),
    "count": ("count", " ", "count", "Vectors of a mean", None, None),
    "quality": ("quality", " ", "quality", "Quality as in telemetry, bits", None, None),
    "flags": ("flags", " ", "flags", "Flags, bits, see TEXT", None, None),
    "ref_voltage": ("ref_voltage", "V", "U ref", "Reference voltage", -1e3, 1e3),
    "pos_voltage": ("pos_voltage", "V", "U +5 V", "Positive supply voltage", -1e3, 1e3),
    "neg_voltage": ("neg_voltage", "V", "U -5 V", "Negative supply voltage", -1e3, 1e3),
}
FLAGS = (
    "flags: bit 0 temperature outside the calibration, 1 no boom state, 2 outside the offset table, 3 no attitude, "
    "4 inside a leap second, 5 first vector after a gap, 6 heater, 7 wheels or lines taken off, 8 a count at its end, "
    "9 stretch too short to take wheels off, 10 outside the validity in time, 16 field outside the calibration, "
    "17 temperature not known"
)


class Refused(Exception):
    """Why a file was not written."""


def plain(text: str) -> str:
    """A name as a part of an ISTP file name: lower case, without the separators of its parts."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def known(name: str, frame: str) -> tuple[str, str, str, str, float | None, float | None]:
    if name in KNOWN:
        variable, unit, label, words, low, high = KNOWN[name]
        return variable, unit, label, words.format(frame=frame), low, high
    if name.startswith("t_"):
        offset = "with" if name.endswith("_calibrated") else "without"
        return name, "degC", name, f"Temperature of the thermistor, {offset} its offset taken off", -273.15, 1e3
    return name, " ", name, f"{name} as in the level", None, None


def groups(names: list[str]) -> list[tuple[str, list[str]]]:
    """Columns by variable: three columns of one vector become one."""
    found: list[tuple[str, list[str]]] = []
    stems: dict[str, list[str]] = {}
    for name in names:
        match = re.fullmatch(r"b[xyz](_\w+)?|(\w+)_[xyz](_km|_nt)?", name)
        stem = name if match is None else "b" + (match[1] or "") if match[2] is None else match[2]
        if stem not in stems:
            found.append((stem, stems.setdefault(stem, [])))
        stems[stem].append(name)
    for stem, columns in found:
        if len(columns) not in (1, 3):
            raise Refused(f"`{stem}` has the columns {', '.join(columns)}, and a vector has three")
    return found


def values(column: pa.ChunkedArray) -> tuple[np.ndarray, tuple]:
    """The numbers of a column with the fill value for nulls, and what its type is in CDF."""
    about = TYPES.get(str(column.type))
    if about is None:
        raise Refused(f"values of the type {column.type} are not known")
    filled = column.fill_null(pa.scalar(about[1], type=column.type)) if column.null_count else column
    return filled.to_numpy(), about


WORDS = (pa.types.is_dictionary, pa.types.is_string, pa.types.is_large_string)


def texts(column: pa.ChunkedArray) -> list[str]:
    dictionary = column.cast(pa.string()).to_pylist()
    return ["" if word is None else word for word in dictionary]


def needed(says: dict[str, str], key: str) -> str:
    if not says.get(key):
        raise Refused(f"the file does not say its `{key}`: state it with --say {key}=...")
    return says[key]


def converted(source: Path, folder: Path, stated: dict[str, str], attributes: dict[str, str], data_version: int) -> Path:
    """Writes the CDF file of a level, whole or not at all."""
    parquet = pq.ParquetFile(source)
    stored = parquet.metadata.metadata or {}
    says = {key.decode(): value.decode() for key, value in stored.items() if key != b"ARROW:schema"}
    if not says.get("written_by", "").startswith("calfit "):
        raise Refused("is no level that calfit wrote")
    table = parquet.read()
    if table.num_rows == 0:
        raise Refused("has no vectors")
    says |= stated
    epoch = table["time_tt2000"].to_numpy()
    says.setdefault("day", str(table["time_utc"].to_numpy()[0].astype("datetime64[D]")))
    says.setdefault("sensor", "")
    level, mission, instrument = (needed(says, key) for key in ("level", "mission", "instrument"))
    # What defines a frame stands behind its name, and in TEXT.
    frame = says.get("frame", "sensor axes").split(":")[0]
    descriptor = "-".join(filter(None, (plain(instrument), plain(says["sensor"]))))
    logical_source = f"{plain(mission)}_l{plain(level)}_{descriptor}"
    file_id = f"{logical_source}_{says['day'].replace('-', '')}_v{data_version:02d}"
    inputs = [f"{i['path']} sha256 {i['sha256']}" for i in json.loads(says.get("inputs", "[]"))]
    text = [f"{key}: {says[key]}" for key in sorted(says) if key not in ("inputs", "notes", "written_by")]
    global_attributes = {
        "Project": mission,
        "Source_name": f"{plain(mission)}>{mission}",
        "Discipline": "Space Physics>Interplanetary Studies",
        "Data_type": f"l{plain(level)}>Level {level}",
        "Descriptor": f"{descriptor}>{instrument} {says['sensor']}".strip(),
        "Data_version": f"{data_version:02d}",
        "Logical_file_id": file_id,
        "Logical_source": logical_source,
        "Logical_source_description": f"{mission}, {instrument} {says['sensor']}, level {level}, {frame}".replace(" ,", ","),
        "File_naming_convention": "source_datatype_descriptor_yyyyMMdd",
        "Instrument_type": "Magnetic Fields (space)",
        "Mission_group": mission,
        "PI_name": "not stated",
        "PI_affiliation": "not stated",
        "TEXT": [*text, *([FLAGS] if "flags" in table.column_names else []), *json.loads(says.get("notes", "[]"))],
        "Generated_by": f"{says['written_by']}, tools/parquet2cdf.py, cdflib {cdflib.__version__}",
        "Parents": inputs or "not stated",
    }
    unknown = set(attributes) - set(global_attributes)
    if unknown:
        raise Refused(f"{', '.join(sorted(unknown))} is none of {', '.join(global_attributes)}")
    global_attributes |= attributes

    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".calfit-", dir=folder) as temporary:
        part = Path(temporary) / "part.cdf"
        # Blocks of compressed values carry the time of writing, so that the whole is left uncompressed.
        file = cdfwrite.CDF(part, cdf_spec={"Encoding": cdfwrite.CDF.IBMPC_ENCODING, "Checksum": True})
        entries = {k: dict(enumerate(v if isinstance(v, list) else [v])) for k, v in global_attributes.items()}
        file.write_globalattrs(entries)
        put_epoch(file, epoch)
        for stem, columns in groups([n for n in table.column_names if n not in ("time_tt2000", "time_utc")]):
            put(file, stem, [table[name] for name in columns], frame)
        file.close()
        with open(part, "rb+") as written:
            os.fsync(written.fileno())
        os.replace(part, folder / f"{file_id}.cdf")
    return folder / f"{file_id}.cdf"


def put_epoch(file: cdfwrite.CDF, epoch: np.ndarray) -> None:
    first, last = (int(cdflib.cdfepoch.compute_tt2000(t)) for t in EPOCH_RANGE)
    kind = "CDF_TIME_TT2000"
    spec = {
        "Variable": "Epoch",
        "Data_Type": cdfwrite.CDF.CDF_TIME_TT2000,
        "Num_Elements": 1,
        "Rec_Vary": True,
        "Dim_Sizes": [],
        "Compress": 0,
    }
    attributes = {
        "CATDESC": "Time, continuous over leap seconds",
        "FIELDNAM": "Epoch",
        "VAR_TYPE": "support_data",
        "UNITS": "ns",
        "LABLAXIS": "Epoch",
        "FORMAT": "I20",
        "FILLVAL": [NO_TIME, kind],
        "VALIDMIN": [first, kind],
        "VALIDMAX": [last, kind],
        "SCALETYP": "linear",
        "TIME_BASE": "J2000",
        "TIME_SCALE": "Terrestrial Time",
        "REFERENCE_POSITION": "Rotating Earth Geoid",
    }
    file.write_var(spec, attributes, epoch)


def put(file: cdfwrite.CDF, stem: str, columns: list[pa.ChunkedArray], frame: str) -> None:
    """Writes a variable of one or three columns, for three with their labels."""
    variable, unit, label, words, low, high = known(stem, frame)
    spec = {"Variable": variable, "Num_Elements": 1, "Rec_Vary": True, "Dim_Sizes": [], "Compress": 0}
    attributes = {"CATDESC": words[:80], "FIELDNAM": label, "DEPEND_0": "Epoch", "DISPLAY_TYPE": "time_series", "UNITS": unit}
    if any(is_words(columns[0].type) for is_words in WORDS):
        cells = texts(columns[0])
        width = max(1, *map(len, cells))
        spec |= {"Data_Type": cdfwrite.CDF.CDF_CHAR, "Num_Elements": width}
        attributes |= {"CATDESC": "Mode of the instrument", "VAR_TYPE": "metadata", "FORMAT": f"A{width}", "FILLVAL": " "}
        file.write_var(spec, attributes, [cell.ljust(width) for cell in cells])
        return
    numbers, about = zip(*(values(column) for column in columns), strict=True)
    kind, fill, least, most, layout = about[0]
    low, high = (least, most) if least is not None else (-1e30 if low is None else low, 1e30 if high is None else high)
    typed = {"FILLVAL": [fill, kind], "VALIDMIN": [low, kind], "VALIDMAX": [high, kind]}
    attributes |= typed | {
        "FORMAT": layout,
        "SCALETYP": "linear",
        "VAR_TYPE": "data" if stem in ("b", "b_ob", "b_ib") else "support_data",
    }
    spec["Data_Type"] = getattr(cdfwrite.CDF, kind)
    if len(columns) == 1:
        file.write_var(spec, attributes | {"LABLAXIS": label}, numbers[0])
        return
    labels = [f"{label} {axis}" for axis in "xyz"]
    width = max(map(len, labels))
    name = f"{variable}_labels"
    about_labels = {"CATDESC": f"Labels of {variable}", "FIELDNAM": name, "VAR_TYPE": "metadata", "FORMAT": f"A{width}"}
    label_spec = {
        "Variable": name,
        "Data_Type": cdfwrite.CDF.CDF_CHAR,
        "Num_Elements": width,
        "Rec_Vary": False,
        "Dim_Sizes": [3],
        "Compress": 0,
    }
    file.write_var(label_spec, about_labels, [text.ljust(width) for text in labels])
    spec["Dim_Sizes"] = [3]
    if stem in ("b", "position"):
        attributes["COORDINATE_SYSTEM"] = frame
    file.write_var(spec, attributes | {"LABL_PTR_1": name}, np.ascontiguousarray(np.stack(numbers, axis=1)))


def pair(text: str) -> tuple[str, str]:
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise argparse.ArgumentTypeError(f"{text} is not NAME=VALUE")
    return key, value


def main() -> int:
    parser = argparse.ArgumentParser(description="ISTP-compliant CDF files of levels that calfit flight wrote.")
    parser.add_argument("levels", nargs="+", type=Path, metavar="LEVEL.parquet")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--say", type=pair, action="append", default=[], metavar="KEY=VALUE", help="what a level does not say of itself"
    )
    parser.add_argument(
        "--attribute", type=pair, action="append", default=[], metavar="NAME=VALUE", help="a global attribute, e.g. PI_name"
    )
    parser.add_argument("--data-version", type=int, default=1, metavar="N")
    options = parser.parse_args()
    status = 0
    for source in options.levels:
        try:
            made = converted(source, options.out, dict(options.say), dict(options.attribute), options.data_version)
            print(f"{source} -> {made}")
        except (Refused, OSError, KeyError, ValueError, pa.ArrowException) as error:
            print(f"error: {source}: {error}", file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
