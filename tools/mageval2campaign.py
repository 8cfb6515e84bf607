#!/usr/bin/env python3
"""A campaign of one run from `automated_calibration/full_data.csv` of the public repository MIT-STARLab/AV-MagEval-Data.

    python3 tools/mageval2campaign.py full_data.csv -o mageval
    calfit diagnose mageval --out results

Needs numpy. The lines of the table are a time in s since 1970, the readings of a reference and of a tested magnetometer in uT
and a temperature in K. The reference is taken as the field. A plateau ends where a component of it leaves 120 nT around its
first reading, or where more than 10 s pass; those of fewer than three readings are left out. With --each every reading is a
plateau. Several readings share a second: they are spread over it.

Says what is left (root mean square of all components, nT) of 18 stretches that are held out in turn, by a fit of twelve
parameters (offset and matrix), and by one of these and of their slopes with the temperature.
Exit status 0: done; 2: a table that cannot be read.
"""

from __future__ import annotations

import argparse
import csv
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

COLUMNS = 8
AGREE_UT = 0.12
GAP_S = 10.0
LEAST_READINGS = 3
STRETCHES = 18
NT_PER_UT = 1000.0
KELVIN = 273.15


def table(path: Path) -> np.ndarray:
    """Time in s since the first reading, field and reading in nT, temperature in degC."""
    with path.open(newline="", encoding="ascii") as lines:
        for number, line in enumerate(csv.reader(lines), start=1):
            try:
                ok = len([float(value) for value in line]) == COLUMNS
            except ValueError:
                ok = False
            if not ok:
                raise ValueError(f"{path}, line {number}: {','.join(line)!r}: a line has {COLUMNS} numbers")
    rows = np.loadtxt(path, delimiter=",", ndmin=2)
    rows[:, 1:7] *= NT_PER_UT
    rows[:, 7] -= KELVIN
    # Readings of one second stand at equal distances in it.
    for second in np.unique(rows[:, 0]):
        own = np.flatnonzero(rows[:, 0] == second)
        rows[own, 0] += np.arange(len(own)) / len(own)
    return rows


def plateaus(rows: np.ndarray, each: bool) -> list[np.ndarray]:
    if each:
        return [rows[i : i + 1] for i in range(len(rows))]
    begins = [0]
    for i in range(1, len(rows)):
        leaves = np.abs(rows[i, 1:4] - rows[begins[-1], 1:4]).max() > AGREE_UT * NT_PER_UT
        if leaves or rows[i, 0] - rows[i - 1, 0] > GAP_S:
            begins.append(i)
    groups = [rows[a:b] for a, b in zip(begins, [*begins[1:], len(rows)], strict=True)]
    return [group for group in groups if len(group) >= LEAST_READINGS]


def run_text(start: datetime, rows: np.ndarray, groups: list[np.ndarray]) -> str:
    lines = [
        "CCR 1",
        f'run = "{start:%y-%m-%d_%H-%M-%S}"',
        f'start = "{start:%Y-%m-%dT%H:%M:%SZ}"',
        'kind = "linearity"',
        'configuration = "X.MAG"',
        'sensor = "DUT"',
        'mode = "m"',
        "sample_rate = 1.0",
        'unit = "enT"',
        'field_source = "FLDS"',
        "coil_correction = true",
        'earthfield_compensation = ["DYNAMIC", "DYNAMIC", "DYNAMIC"]',
        "@BLOCKS",
        "t_start,t_end,bx,by,bz,position,x,y,z",
    ]
    t_s = rows[:, 0] - int(rows[0, 0])
    end = np.append(t_s[1:], t_s[-1] + 1.0)
    at = {time: k for k, time in enumerate(rows[:, 0])}
    for group in groups:
        mean = group.mean(axis=0)
        first, last = at[group[0, 0]], at[group[-1, 0]]
        stop = min(end[last], t_s[last] + 1.0)
        field, reading = (",".join(f"{value:.3f}" for value in mean[k : k + 3]) for k in (1, 4))
        lines.append(f"{t_s[first]:.4f},{stop:.4f},{field},1,{reading}")
    lines += ["@TEMPERATURES", "t,DUT"]
    lines += [f"{time:.4f},{temperature:.4f}" for time, temperature in zip(t_s, rows[:, 7], strict=True)]
    return "\n".join([*lines, "@END", ""])


def held_out_nt(groups: list[np.ndarray], with_temperature: bool) -> float:
    means = np.array([group.mean(axis=0) for group in groups])
    base = np.column_stack([np.ones(len(means)), means[:, 1:4] / NT_PER_UT])
    warm = (means[:, 7] - means[:, 7].mean())[:, None]
    design = np.hstack([base, base * warm]) if with_temperature else base
    left = np.empty((len(means), 3))
    for k in range(STRETCHES):
        out = slice(k * len(means) // STRETCHES, (k + 1) * len(means) // STRETCHES)
        seen = np.ones(len(means), bool)
        seen[out] = False
        fit = np.linalg.lstsq(design[seen], means[seen, 4:7], rcond=None)[0]
        left[out] = means[out, 4:7] - design[out] @ fit
    return float(np.sqrt((left**2).sum(axis=1).mean()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--each", action="store_true", help="every reading is a plateau")
    options = parser.parse_args()
    try:
        rows = table(options.table)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    groups = plateaus(rows, options.each)
    start = datetime.fromtimestamp(int(rows[0, 0]), UTC)
    folder = options.out / f"{start:%y-%m-%d}"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{start:%H-%M-%S}.CCR").write_text(run_text(start, rows, groups))
    (options.out / "campaign.toml").write_text("")
    left = " and ".join(f"{held_out_nt(groups, warm):.0f}" for warm in (False, True))
    print(f"{len(groups)} plateaus; fits of 12 and 24 parameters leave {left} nT of stretches that are held out")


if __name__ == "__main__":
    main()
