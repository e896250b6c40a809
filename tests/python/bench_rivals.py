"""Recursive least squares of padasip and filterpy on the regressors of the bench.

Usage: bench_rivals.py REGRESSORS OUTPUT.json
REGRESSORS: little-endian u64 updates of the motion, u64 updates in all, then f64 a, v, sgn v, 1, F for each update; u64 cases, and for
each f64 forgetting, u64 updates between two values written down or 0, u64 updates, then five f64 for each update.
Forgetting and initial variance of the first run are those of tests/bench/src/machine.rs.
"""

import json
import math
import multiprocessing
import struct
import sys
import time
import warnings

import numpy as np

FORGETTING = 0.999
VARIANCE = 1e5


class Reader:
    """The file, part by part."""

    def __init__(self, path):
        with open(path, "rb") as file:
            self.bytes = file.read()
        self.place = 0

    def take(self, form):
        values = struct.unpack_from(form, self.bytes, self.place)
        self.place += struct.calcsize(form)
        return values

    def rows(self):
        (count,) = self.take("<Q")
        rows = np.frombuffer(self.bytes, dtype="<f8", count=5 * count, offset=self.place).reshape(count, 5)
        self.place += 40 * count
        return rows


class Padasip:
    name = "`padasip`, `FilterRLS`"

    def __init__(self, forgetting):
        import padasip

        # Its eps is the inverse of the initial variance.
        self.filter = padasip.filters.FilterRLS(4, mu=forgetting, eps=1 / VARIANCE, w="zeros")

    def update(self, phi, force):
        self.filter.adapt(force, phi)

    def parameters(self):
        return self.filter.w

    def variances(self):
        return np.diag(self.filter.R)


class Filterpy:
    name = "`filterpy`, `KalmanFilter` with fading memory"

    def __init__(self, forgetting):
        from filterpy.kalman import KalmanFilter

        self.filter = KalmanFilter(dim_x=4, dim_z=1)
        self.filter.P = np.eye(4) * VARIANCE
        self.filter.Q = np.zeros((4, 4))
        self.filter.R = np.eye(1)
        # The covariance is multiplied by its square at each prediction.
        self.filter.alpha = 1 / math.sqrt(forgetting)

    def update(self, phi, force):
        self.filter.predict()
        self.filter.update(force, H=phi.reshape(1, 4))

    def parameters(self):
        return self.filter.x[:, 0]

    def variances(self):
        return np.diag(self.filter.P)


def numbers(values):
    return [float(value) if math.isfinite(value) else None for value in values]


def line(method, motion, rows):
    phis, forces = rows[:, :4], rows[:, 4]
    remark = ""
    start = time.perf_counter()
    for phi, force in zip(phis[:motion], forces[:motion]):
        method.update(phi, force)
    nanoseconds = (time.perf_counter() - start) / motion * 1e9
    after_motion = numbers(method.parameters())
    try:
        for phi, force in zip(phis[motion:], forces[motion:]):
            method.update(phi, force)
        after_rest = numbers(method.parameters())
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        after_rest = [None] * 4
        remark = f"stopped at rest: {error}"
    return {
        "name": method.name,
        "arithmetic": "f64, Python",
        "ns_per_update": nanoseconds,
        "motion": after_motion,
        "rest": after_rest,
        "remark": remark,
    }


def outcome(kind, forgetting, track, rows):
    method, values = kind(forgetting), []
    for n, row in enumerate(rows):
        method.update(row[:4], row[4])
        if track and n % track == 0:
            values.append(method.parameters()[0])
    return {
        "parameters": numbers(method.parameters()),
        "variances": numbers(method.variances()),
        "track": numbers(values),
    }


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    warnings.simplefilter("ignore", RuntimeWarning)
    reader = Reader(sys.argv[1])
    (motion,) = reader.take("<Q")
    rows = reader.rows()
    (count,) = reader.take("<Q")
    cases = [(*reader.take("<dQ"), reader.rows()) for _ in range(count)]
    lines = []
    for kind in (Padasip, Filterpy):
        print(f"{kind.name}: {len(rows)} updates", flush=True)
        lines.append(line(kind(FORGETTING), motion, rows))
    # Times have been taken: from here on, all processors may work.
    print(f"both: {sum(len(case[2]) for case in cases)} updates in {count} cases", flush=True)
    with multiprocessing.Pool() as pool:
        for kind, one in zip((Padasip, Filterpy), lines):
            one["cases"] = pool.starmap(outcome, [(kind, *case) for case in cases], chunksize=1)
    with open(sys.argv[2], "w", encoding="utf-8") as file:
        json.dump(lines, file, indent=1)


if __name__ == "__main__":
    main()
