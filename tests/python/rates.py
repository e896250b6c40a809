"""How many samples a second are replayed: by the program, by the package, and by numpy with the same kernels and averages.

    python rates.py PROGRAM RUN.mcap SECOND.mcap

Prints docs/tables/rates.md, with **missed** where the package misses its goal.

numpy has one bank of the estimator (docs/THEORY.md, 1, 2, 4 and 5): kernels of four boxes with their corrections,
averages of the products of `[a, v, s, 1, F]`, and a solution five times a second.
"""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import reduce

import inerter
import numpy as np
import pyarrow as pa

PASSES = 5
GOAL = 0.9
"""Minimum rate of the package on one worker, as a fraction of the command line's."""
BOX_S, SPACING_S, SOLUTION_S = 0.016, 0.008, 0.2
"""Length of the box, time between two updates, and between two solutions [s]."""


def kernels(rate):
    """For acceleration, velocity, sign and force: the weights of samples around the same place."""
    length = round(BOX_S * rate)
    box = [np.full(length, 1.0 / length)]
    difference = np.zeros(length + 1)
    difference[0], difference[-1] = rate / length, -rate / length
    of = [
        [difference, difference, *2 * box],
        [difference, *3 * box, np.array([-1.0, 13.0, 13.0, -1.0]) / 24.0],
        [*4 * box, np.array([1.0, 22.0, 1.0]) / 24.0],
        [*4 * box, np.array([1.0, 10.0, 1.0]) / 12.0],
    ]
    weights = [reduce(np.convolve, parts)[::-1] for parts in of]
    span = max(map(len, weights))
    return span, [np.pad(own, (span - len(own)) // 2) for own in weights]


def signs(position, rate):
    """The average of the velocity's sign over each sample, by a straight line through its zero."""
    half = round(0.005 * rate)
    triangle = np.concatenate((np.arange(1, half + 1), np.arange(half - 1, 0, -1))) / half**2
    velocity = np.convolve(np.gradient(position), triangle, mode="same")
    sign = np.sign(velocity)
    before, after = velocity[:-1], velocity[1:]
    turns = np.flatnonzero(before * after < 0.0)
    part = before[turns] / (before[turns] - after[turns])
    sooner = part < 0.5
    at = turns + ~sooner
    sign[at] = np.sign(before[turns]) * np.where(sooner, 2.0 * part, 2.0 * part - 2.0)
    return sign


def solved(products):
    """The law's four parameters, of one set of products `[a, v, s, 1, F]` or of several."""
    return np.linalg.solve(products[..., :4, :4], products[..., :4, 4:])[..., 0]


def by_arrays(position, force, rate):
    """All at once."""
    span, weights = kernels(rate)
    spacing = round(SPACING_S * rate)
    channels = [position, position, signs(position, rate), force]
    views = [np.lib.stride_tricks.sliding_window_view(channel, span)[::spacing] for channel in channels]
    acceleration, velocity, sign, smooth = (view @ own for view, own in zip(views, weights))
    rows = np.stack([acceleration, velocity, sign, np.ones_like(sign), smooth], axis=1)
    products = np.cumsum(rows[:, :, None] * rows[:, None, :], axis=0)
    every = round(SOLUTION_S / SPACING_S)
    return solved(products[every * 5 - 1 :: every])[-1]


def by_loop(position, force, rate):
    """Update by update, as samples come."""
    span, weights = kernels(rate)
    spacing, every = round(SPACING_S * rate), round(SOLUTION_S / SPACING_S)
    channels = [position, position, signs(position, rate), force]
    average = np.zeros((5, 5))
    found = np.zeros(4)
    row = np.ones(5)
    for number, start in enumerate(range(0, len(force) - span + 1, spacing), 1):
        for place, channel, own in zip((0, 1, 2, 4), channels, weights):
            row[place] = own @ channel[start : start + span]
        average += (np.outer(row, row) - average) / number
        if number >= every * 5 and number % every == 0:
            found = solved(average)
    return found


def best(work):
    """Shortest time of several passes [s], and what came of it."""
    times = []
    for _ in range(PASSES):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return min(times), result


def both(work, runs):
    """The same on two workers, a run each."""
    with ThreadPoolExecutor(len(runs)) as workers:
        return list(workers.map(work, runs))


def main(program, *paths):
    run = inerter.open(paths[0])
    table = pa.table(run.samples)
    position = table["position_m"].to_numpy()
    force = table["force_n"].to_numpy()
    rate = run.settings["sample_rate_hz"]

    def told(path):
        return subprocess.run([program, "replay", path, "--json"], capture_output=True, check=True)

    def replayed(path):
        return inerter.replay(path).inertance_kg

    inertance = {"vectorised": by_arrays(position, force, rate)[0], "looped": by_loop(position, force, rate)[0]}
    ours = replayed(paths[0])
    for name, value in inertance.items():
        if not abs(value - ours.value) < 0.001 * ours.value:
            sys.exit(f"numpy, {name}: {value} kg is no {ours}: it is not the same filter")
    length = len(force)
    rates = [
        ("command line", "1", length / best(lambda: told(paths[0]))[0]),
        ("command line", "2", 2 * length / best(lambda: both(told, paths))[0]),
        ("package", "1", length / best(lambda: replayed(paths[0]))[0]),
        ("package", "2", 2 * length / best(lambda: both(replayed, paths))[0]),
        ("numpy, vectorised", "1", length / best(lambda: by_arrays(position, force, rate))[0]),
        ("numpy, looped", "1", length / best(lambda: by_loop(position, force, rate))[0]),
    ]
    unit = rates[0][2]
    print(f"""# Rates of a replay

Written by `cargo xtask rates --update`: samples per second, the best of {PASSES} passes on one
machine. Only the ratios carry over to other machines. The run has {length} samples at {rate:g} Hz.

- *command line*: `inerter replay --json` from start to end, each run in its own process.
- *package*: `inerter.replay` of the same file in one process. Two workers are two threads.
- *numpy*: a filter with the same kernels, averages and solutions, but only one bank, no gates and
  no intervals. It has the samples in memory. Its inertance is within 0.1 % of ours.

The command line and the package read the recording, replay it, and search for causes and for a
better motion.

| | workers | samples/s | relative to the command line | goal |
|---|---|--:|--:|---|""")
    for name, workers, samples in rates:
        reached = "reached" if samples >= GOAL * unit else "**missed**"
        goal = f"at least {100 * GOAL:.0f} %, {reached}" if (name, workers) == ("package", "1") else ""
        print(f"| {name} | {workers} | {samples:.3g} | {100 * samples / unit:.0f} % | {goal} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
