#!/usr/bin/env python3
"""Campaigns of the CHAMP run of `runs/champ-1998` with one effect added to the readings of one axis.

    python3 tools/champ_with_effects.py runs/champ-1998 -o champ
    for run in champ/*; do calfit diagnose $run --out results/$(basename $run); done

One folder for each effect and axis, `step-x` to `transverse-z`, and one, `none`, for the run as it is. Sizes are what is added
at 60 000 nT: of a step from the middle setting on 0.4 nT, of the third power of the field along the axis 0.6 nT, of the
square of the field along the next axis (x after z) 0.4 nT; of a remanence 0.3 nT for 60 000 nT along the axis in the setting
before. An engineering unit of these readings is a nT to two parts in a hundred.
Exit status 0: done; 2: a campaign without such a run.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

FULL_NT = 60_000.0
HEADER = "t_start,t_end,bx,by,bz,position,x,y,z"
FIELD, READING = 2, 6


def step(fields: list[list[float]], row: int, _: int) -> float:
    return 0.4 if row >= len(fields) // 2 else 0.0


def cubic(fields: list[list[float]], row: int, axis: int) -> float:
    return 0.6 * (fields[row][axis] / FULL_NT) ** 3


def remanence(fields: list[list[float]], row: int, axis: int) -> float:
    return 0.3 * fields[row - 1][axis] / FULL_NT if row > 0 else 0.0


def transverse(fields: list[list[float]], row: int, axis: int) -> float:
    return 0.4 * (fields[row][(axis + 1) % 3] / FULL_NT) ** 2


EFFECTS = (step, cubic, remanence, transverse)


def with_effect(text: str, effect, axis: int) -> str:
    lines = text.splitlines()
    begin = lines.index(HEADER) + 1
    end = next(i for i in range(begin, len(lines)) if lines[i].startswith("@"))
    rows = [line.split(",") for line in lines[begin:end]]
    fields = [[float(value) for value in row[FIELD : FIELD + 3]] for row in rows]
    for k, row in enumerate(rows):
        row[READING + axis] = f"{float(row[READING + axis]) + effect(fields, k, axis):.6f}"
    return "\n".join([*lines[:begin], *map(",".join, rows), *lines[end:], ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    options = parser.parse_args()
    runs = sorted(options.campaign.glob("*/*.CCR"))
    if len(runs) != 1 or HEADER not in runs[0].read_text():
        print(f"error: {options.campaign}: a campaign of one run of block means is needed", file=sys.stderr)
        sys.exit(2)
    text = runs[0].read_text()
    shutil.copytree(options.campaign, options.out / "none")
    for effect in EFFECTS:
        for axis, name in enumerate("xyz"):
            folder = options.out / f"{effect.__name__}-{name}"
            shutil.copytree(options.campaign, folder)
            (folder / runs[0].relative_to(options.campaign)).write_text(with_effect(text, effect, axis))


if __name__ == "__main__":
    main()
