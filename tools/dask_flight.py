#!/usr/bin/env python3
"""Levels of many days with many workers: one task per day and sensor, for Dask distributed.

    calfit flight carry flight.toml -o carry.parquet
    python3 tools/dask_flight.py ABC flight.toml carry.parquet -o levels --from 2014-08-01 --to 2014-08-31 --sensors OB IB

Levels D and J are made of two sensors: `common` among the sensors makes them. Needs distributed. With --scheduler ADDRESS the tasks go to a cluster that runs already, on Slurm through dask-jobqueue or
on Kubernetes. Exit status 0: all days were made; 1: the days that are named were not.
"""

import argparse
import subprocess
from datetime import date, timedelta

from dask.distributed import Client, LocalCluster, as_completed


def make(command: list[str], day: str, sensor: str) -> str | None:
    """Makes a day; returns why not. Whatever a second attempt may mend is raised, so that the task is tried again."""
    run = subprocess.run([*command, "--from", day, "--to", day, "--sensor", sensor], capture_output=True, text=True)
    if run.returncode not in (0, 1):
        raise RuntimeError(f"{sensor} {day}: exit status {run.returncode}: {run.stderr.strip()}")
    return run.stderr.strip() if run.returncode else None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("levels")
    parser.add_argument("config")
    parser.add_argument("carry")
    parser.add_argument("-o", "--out", required=True)
    parser.add_argument("--from", dest="first", type=date.fromisoformat, required=True)
    parser.add_argument("--to", dest="last", type=date.fromisoformat, required=True)
    parser.add_argument("--sensors", nargs="+", required=True)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scheduler", help="address of a scheduler that runs already")
    parser.add_argument("--program", default="calfit")
    o = parser.parse_args()

    command = [o.program, "flight", o.levels, o.config, "--carry", o.carry, "--threads", "1", "-q", "-o", o.out]
    days = [str(o.first + timedelta(n)) for n in range((o.last - o.first).days + 1)]
    cluster = o.scheduler or LocalCluster(n_workers=o.workers, threads_per_worker=1, dashboard_address=None, silence_logs=50)
    failed = []
    with Client(cluster) as client:
        tasks = {
            client.submit(make, command, day, sensor, retries=2, pure=False): f"{sensor} {day}"
            for day in days
            for sensor in o.sensors
        }
        for task in as_completed(tasks):
            why = str(task.exception()) if task.status == "error" else task.result()
            if why:
                failed.append(f"{tasks[task]} was not made: {why}")
    print(*sorted(failed), f"{len(tasks) - len(failed)} of {len(tasks)} done", sep="\n")
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
