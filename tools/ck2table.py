#!/usr/bin/env python3
"""Tables of attitude and position for `calfit flight`, from SPICE kernels.

    python3 tools/ck2table.py META.TM --sc-frame ROS_SPACECRAFT --frame ECLIPJ2000 --from 2014-08-06 --to 2014-08-07 \\
        -o attitude.parquet --target ROSETTA --observer SUN --position position.parquet

Needs spiceypy, pyarrow and numpy. One row per --step seconds; where the kernels have no attitude there is no row.
Quaternions are scalar-first, v_frame = q v_sc q*, so that `flight.toml` says

    attitude_order = "scalar-first"
    attitude_from_to = "sc to celestial"

Frames, step, kernels and their SHA-256 stand in the metadata of the tables. Positions are geometric, without light time and
aberration.
Exit status 0: done; 1: no row; 2: kernels that cannot be read, wrong names or times.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import spiceypy
from spiceypy.utils.exceptions import SpiceNOFRAMECONNECT, SpiceSPKINSUFFDATA, SpiceyError

SECOND_NS = 1_000_000_000
#: Times are exact to this; numbers of seconds in double precision have 0.06 us.
MICROSECOND_NS = 1_000


def tt2000_of(utc: str) -> int:
    """ns since 2000-01-01T12:00:00 TT of a time in UTC."""
    return round(spiceypy.unitim(spiceypy.utc2et(utc), "ET", "TT") * 1e6) * MICROSECOND_NS


def ephemeris_time(tt2000: int) -> float:
    return spiceypy.unitim(tt2000 / SECOND_NS, "TT", "ET")


def timestamp(et: float) -> np.datetime64:
    """UTC as timestamps count, which know no leap seconds: within one it is the last ns before."""
    text = spiceypy.et2utc(et, "ISOC", 6)
    return np.datetime64(text[:17] + "59.999999999" if text[17:19] == "60" else text, "ns")


def grid(options: argparse.Namespace, step_s: float) -> list[int]:
    step_ns = round(step_s * SECOND_NS)
    first, last = tt2000_of(options.first), tt2000_of(options.last)
    if step_ns <= 0 or step_ns % MICROSECOND_NS or first > last:
        raise SystemExit("error: a step is a positive number of whole us, and --from is not after --to")
    return list(range(first, last + 1, step_ns))


def kernels() -> list[dict[str, str]]:
    """The kernels in the order in which they were loaded; the later one counts."""
    paths = [Path(spiceypy.kdata(index, "ALL")[0]) for index in range(spiceypy.ktotal("ALL"))]
    return [{"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()} for path in paths]


def attitude(times: list[int], sc_frame: str, frame: str) -> tuple[list[int], np.ndarray]:
    """Times with an attitude, and quaternions from the spacecraft to the frame; signs go on evenly."""
    kept: list[int] = []
    rows: list[np.ndarray] = []
    for time in times:
        try:
            q = spiceypy.m2q(spiceypy.pxform(sc_frame, frame, ephemeris_time(time)))
        except SpiceNOFRAMECONNECT:
            continue
        q = q / np.linalg.norm(q)
        rows.append(-q if rows and q @ rows[-1] < 0 else q)
        kept.append(time)
    return kept, np.array(rows).reshape(-1, 4)


def position(times: list[int], target: str, frame: str, observer: str) -> tuple[list[int], np.ndarray]:
    kept: list[int] = []
    rows: list[np.ndarray] = []
    for time in times:
        try:
            rows.append(spiceypy.spkpos(target, ephemeris_time(time), frame, "NONE", observer)[0])
        except SpiceSPKINSUFFDATA:
            continue
        kept.append(time)
    return kept, np.array(rows).reshape(-1, 3)


def write(path: Path, times: list[int], columns: dict[str, np.ndarray], says: dict[str, str]) -> None:
    """Writes a table, whole or not at all."""
    utc = np.array([timestamp(ephemeris_time(time)) for time in times])
    table = pa.table(
        {
            "time_tt2000": pa.array(times, pa.int64()),
            "time_utc": pa.array(utc, pa.timestamp("ns", tz="UTC")),
            **{name: pa.array(np.ascontiguousarray(values)) for name, values in columns.items()},
        }
    ).replace_schema_metadata(says)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".calfit-", dir=path.parent) as folder:
        part = Path(folder) / path.name
        pq.write_table(table, part, compression="zstd")
        with open(part, "rb+") as written:
            os.fsync(written.fileno())
        os.replace(part, path)


def told(path: Path, wanted: int, kept: int) -> bool:
    print(
        f"{kept} rows, {wanted - kept} times without data -> {path}" if kept else f"no data in this time: {path} is not written"
    )
    return kept > 0


def main() -> int:
    parser = argparse.ArgumentParser(description="Attitude and positions from SPICE kernels, for calfit flight.")
    parser.add_argument(
        "kernels", nargs="+", metavar="META.TM", help="meta kernels or kernels, in the order in which they are loaded"
    )
    parser.add_argument("--sc-frame", required=True, help="frame of the spacecraft, as ROS_SPACECRAFT")
    parser.add_argument("--frame", required=True, help="frame of level C, as ECLIPJ2000")
    parser.add_argument("--from", dest="first", required=True, metavar="UTC")
    parser.add_argument("--to", dest="last", required=True, metavar="UTC", help="last time, inclusive")
    parser.add_argument("--step", type=float, default=10.0, metavar="S")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE.parquet")
    parser.add_argument("--position", type=Path, metavar="FILE.parquet")
    parser.add_argument("--position-step", type=float, default=60.0, metavar="S")
    parser.add_argument("--target", help="of positions, as ROSETTA")
    parser.add_argument("--observer", help="from which positions count, as SUN")
    options = parser.parse_args()
    if options.position and not (options.target and options.observer):
        parser.error("--position needs --target and --observer")
    try:
        spiceypy.furnsh(options.kernels)
        common = {
            "frame": options.frame,
            "kernels": json.dumps(kernels()),
            "made_by": f"tools/ck2table.py, spiceypy {spiceypy.__version__}, {spiceypy.tkvrsn('TOOLKIT')}",
        }
        times = grid(options, options.step)
        kept, q = attitude(times, options.sc_frame, options.frame)
        done = told(options.out, len(times), len(kept))
        if done:
            says = {"sc_frame": options.sc_frame, "attitude_order": "scalar-first", "attitude_from_to": "sc to celestial"}
            says |= {"formula": "v_frame = q v_sc conjugate(q), q = q0 + q1 i + q2 j + q3 k", "step_s": repr(options.step)}
            write(options.out, kept, {f"q{i}": q[:, i] for i in range(4)}, common | says)
        if options.position:
            times = grid(options, options.position_step)
            kept, km = position(times, options.target, options.frame, options.observer)
            there = told(options.position, len(times), len(kept))
            done &= there
            if there:
                says = {
                    "target": options.target,
                    "observer": options.observer,
                    "correction": "NONE",
                    "step_s": repr(options.position_step),
                }
                write(options.position, kept, {f"{axis}_km": km[:, i] for i, axis in enumerate("xyz")}, common | says)
    except (SpiceyError, OSError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    finally:
        spiceypy.kclear()
    return 0 if done else 1


if __name__ == "__main__":
    sys.exit(main())
