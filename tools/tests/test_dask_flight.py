"""Tasks of days with a program that stands for calfit and notes its calls."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="the package distributed is not there")

TOOL = Path(__file__).parents[1] / "dask_flight.py"
#: Notes the call; its exit status is that of the day, with `once` at the first call only.
PROGRAM = """#!/bin/sh
echo "$@" >> "$0.calls"
day=$(echo "$@" | sed 's/.*--from \\([^ ]*\\).*/\\1/')
sensor=$(echo "$@" | sed 's/.*--sensor \\([^ ]*\\).*/\\1/')
calls=$(grep -c -- "--from $day .*--sensor $sensor" "$0.calls")
case "$day $sensor $calls" in
  "2015-06-29 OB "*) echo "error: no model" >&2; exit 1;;
  "2015-06-29 IB 1") exit 2;;
  "2015-06-30 OB 1" | "2015-06-30 OB 2") kill -9 $$;;
  "2015-06-30 IB "*) echo "error: no disk" >&2; exit 2;;
esac
"""


def test_days_are_tried_again_where_that_may_help(tmp_path):
    program = tmp_path / "calfit"
    program.write_text(PROGRAM)
    program.chmod(0o755)
    days = ("--from", "2015-06-29", "--to", "2015-07-01", "--sensors", "OB", "IB")
    run = [sys.executable, TOOL, "ABC", "flight.toml", "carry.parquet", "-o", tmp_path / "out", *days, "--program", program]
    done = subprocess.run(run, capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert done.stdout.splitlines() == [
        "IB 2015-06-30 was not made: IB 2015-06-30: exit status 2: error: no disk",
        "OB 2015-06-29 was not made: error: no model",
        "4 of 6 done",
    ]
    calls = Path(f"{program}.calls").read_text().splitlines()
    out = tmp_path / "out"
    form = f"flight ABC flight.toml --carry carry.parquet --threads 1 -q -o {out} --from {{0}} --to {{0}} --sensor {{1}}"
    expected = {
        ("2015-06-29", "OB"): 1,
        ("2015-06-29", "IB"): 2,
        ("2015-06-30", "OB"): 3,
        ("2015-06-30", "IB"): 3,
        ("2015-07-01", "OB"): 1,
        ("2015-07-01", "IB"): 1,
    }
    assert sorted(calls) == sorted(form.format(*task) for task, times in expected.items() for _ in range(times))
