"""What many runs cost: a store is filled with simulated runs, and all of them are replayed by workers of Dask.

    python scale.py PROGRAM FOLDER RUNS

Prints docs/tables/scale.md. The store stays in FOLDER, and is filled further where there are too few.
"""

import os
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import inerter
from distributed import Client, LocalCluster

DURATION_S = 20
SAMPLE = 200
"""Runs that are replayed without store and cluster, and added to a store of their own, to tell what each costs."""
SHARDS = 5
"""Of these the program replays one, for its rate."""
MILLION = 1_000_000
DEVICES = 10_000
PRICES = {"GB and month": 0.023, "processor hour": 0.05, "1000 writes": 0.005, "1000 reads": 0.0004}
"""Round list prices of large clouds [US dollars]; put in yours."""
REQUESTS = {"added": (7, 20), "by the program": (1, 1), "by a worker": (1, 8), "looked at": (0, 1)}
"""Requests to S3 for a run: writes (PUT) and reads (GET, HEAD), as host-tools/python/tests/test_store.py counts them. Lists, one for
1000 names, and the two reads that open a store for many runs are left out."""


def fill(folder, store, seed):
    """Simulates a run and adds it; seconds of adding alone."""
    path = folder / f"{seed}.mcap"
    inerter.simulate("random", seed=seed, duration_s=DURATION_S, path=path, replace=True)
    started = time.perf_counter()
    inerter.Store(store).add(path)
    path.unlink()
    return time.perf_counter() - started


def alone(folder, turn, turns):
    """Replays its share of the sample by itself, from where it lies in the store; seconds a run."""
    store = inerter.Store(folder / "store")
    rows = store.runs()[:SAMPLE][turn::turns]
    started = time.perf_counter()
    for row in rows:
        inerter.replay(store.open(row))
    return (time.perf_counter() - started) / len(rows)


def asked(what):
    """Requests to S3 for a million runs, and their price [US dollars]."""
    counts = dict(zip(("writes", "reads"), REQUESTS[what], strict=True))
    words = ", ".join(f"{count * MILLION / 1e6:.0f} million {name}" for name, count in counts.items() if count)
    return words, sum(count * MILLION / 1e3 * PRICES[f"1000 {name}"] for name, count in counts.items())


def dollars(price):
    """A price in whole dollars; empty where there is none."""
    return "" if price is None else "under 1" if price < 1 else f"{price:.0f}"


def peak_mb():
    """The most memory that this process had; `getrusage` would count that of the process which started it as well."""
    return int(re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())[1]) * 1024 / 1e6


def spread(store, workers, batch, runs, kill=False):
    """Seconds for all runs, and the largest memory of a worker [MB]. With `kill` one of them ends when a third is done."""
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        victim = [next(iter(client.run(os.getpid).values()))] if kill else []

        def told(part):
            if part > 1 / 3 and victim:
                os.kill(victim.pop(), signal.SIGKILL)

        started = time.perf_counter()
        rows = inerter.batch.replay(store, client, batch=batch, progress=told)
        took = time.perf_counter() - started
        memory = max(client.run(peak_mb).values())
    assert len(rows) == runs and all(row["error"] is None for row in rows) and not victim
    return took, memory


def main(program, folder, runs):
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    store = inerter.Store(folder / "store")
    there = len(store) if (folder / "store").exists() else 0
    count = runs - there
    assert count >= 0, f"{there} runs are there, and {runs} are to be measured: begin with another folder"
    with TemporaryDirectory(dir=folder) as scratch, ProcessPoolExecutor(2) as pool:
        list(pool.map(fill, [folder] * count, [folder / "store"] * count, range(there, there + count), chunksize=8))
        scratch = Path(scratch)
        adding = list(pool.map(fill, [scratch] * SAMPLE, [scratch / "store"] * SAMPLE, range(SAMPLE), chunksize=8))
        adding_s = sum(adding) / SAMPLE
    # No pass is the first to read a recording from the disk.
    for path in (folder / "store").rglob("*.mcap"):
        path.read_bytes()
    with ProcessPoolExecutor(2) as pool:
        alone_s = pool.submit(alone, folder, 0, 1).result()
        both_s = sum(pool.map(alone, [folder] * 2, range(2), [2] * 2)) / 4
    stamp = str(int(time.time()))
    one, memory_of_one = spread(store, 1, f"one-{stamp}", runs)
    two, memory_of_two = spread(store, 2, f"two-{stamp}", runs)
    spread(store, 2, f"killed-{stamp}", runs, kill=True)
    started = time.perf_counter()
    batch = f"program-{stamp}"
    told = [program, "replay", "--store", str(folder / "store"), "--batch", batch, "--shard", f"1/{SHARDS}"]
    subprocess.run(told, check=True, capture_output=True)
    by_program = (time.perf_counter() - started) / len(store.results(batch))
    started = time.perf_counter()
    store.runs("law = broken")
    listing = time.perf_counter() - started
    files = [path for path in (folder / "store").rglob("*") if path.is_file() and "results" not in path.parts]
    recordings = sum(path.stat().st_size for path in files if path.suffix == ".mcap")
    tables = sum(path.stat().st_size for path in files) - recordings
    figures = [
        ("runs", f"{runs}", ""),
        ("time of a replay without store and cluster", f"{1e3 * alone_s:.1f}", "ms"),
        ("one worker: time per run", f"{1e3 * one / runs:.1f}", "ms"),
        ("of which store and cluster (goal: under 20)", f"{1e3 * (one / runs - alone_s):.1f}", "ms"),
        ("two workers: time per run", f"{1e3 * two / runs:.1f}", "ms"),
        ("rate of two workers over that of one (goal: at least 1.8)", f"{one / two:.2f}", "times"),
        ("rate of two processes over that of one, without store and cluster", f"{alone_s / both_s:.2f}", "times"),
        ("`inerter replay --store`: time per run", f"{1e3 * by_program:.1f}", "ms"),
        ("adding: time per run", f"{1e3 * adding_s:.1f}", "ms"),
        ("`store.runs` with a condition: time per run", f"{1e3 * listing / runs:.2f}", "ms"),
        ("largest memory of a worker (goal: under 200)", f"{max(memory_of_one, memory_of_two):.0f}", "MB"),
        ("recording: size per run", f"{recordings / runs / 1e3:.1f}", "KB"),
        ("tables and sums: size per run", f"{tables / runs / 1e3:.1f}", "KB"),
        ("rows although one of two workers was killed at a third of the runs", f"{runs}", "all without an error"),
    ]
    print("# What many runs cost\n")
    print(
        "Written by `cargo xtask scale --update`: simulated runs of 20 s at 1 kHz, in a store in a folder,\n"
        "are replayed by the workers of a Dask cluster. Workers, scheduler and client share one machine of\n"
        "two processors. Only the ratios carry over to other machines; the times are this machine's. *adding*\n"
        "is measured on 200 runs that two processes at once add to an empty store. Memory is the largest that\n"
        "the process of a worker ever used.\n"
    )
    print("| figure | value | unit |\n|---|--:|---|")
    for name, value, unit in figures:
        print(f"| {name} | {value} | {unit} |")
    gigabytes = MILLION * (recordings + tables) / runs / 1e9
    objects = MILLION * len(files) / runs
    replays_h = MILLION * by_program / 3600
    adding_h = MILLION * adding_s / 3600
    calculated = [
        ("storage", f"{gigabytes:.0f} GB in {objects / 1e6:.0f} million objects", gigabytes * PRICES["GB and month"], "a month"),
        ("adding all runs", f"{adding_h:.0f} processor hours", adding_h * PRICES["processor hour"], ""),
        ("adding all runs to S3: requests", *asked("added"), ""),
        ("replaying all runs", f"{replays_h:.0f} processor hours", replays_h * PRICES["processor hour"], ""),
        ("replaying all runs in S3: requests of `inerter replay --store`", *asked("by the program"), ""),
        ("replaying all runs in S3: requests of `inerter.batch.replay`", *asked("by a worker"), ""),
        ("reading the row of every run in a folder", f"{MILLION * listing / runs / 60:.0f} minutes by one process", None, ""),
        ("reading the row of every run in S3: requests", *asked("looked at"), ""),
    ]
    print(f"\n## A million runs of {DURATION_S} s of {DEVICES // 1000} thousand devices, calculated\n")
    print(
        f"Calculated in proportion from the figures above, for {MILLION // DEVICES} runs of each device; a million runs were\n"
        "not stored. Prices are round list prices of large clouds in US dollars, constants in the script:\n"
        + ", ".join(f"{price} per {name}" for name, price in PRICES.items())
        + ".\n"
    )
    print("| what | how much | US dollars | |\n|---|---|--:|---|")
    for what, amount, price, unit in calculated:
        print(f"| {what} | {amount} | {dollars(price)} | {unit} |")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
