"""Recursive least squares of padasip and filterpy on the regressors of the bench.

Usage: bench_rivals.py REGRESSORS OUTPUT.json
REGRESSORS: little-endian u64 updates of the motion, u64 updates in all, then f64 a, v, sgn v, 1, F for each update.
Forgetting and initial variance are those of tests/src/bin/bench.rs.
"""

import json
import math
import struct
import sys
import time
import warnings

import numpy as np

FORGETTING = 0.999
VARIANCE = 1e5


def read(path):
    with open(path, "rb") as file:
        motion, count = struct.unpack("<QQ", file.read(16))
        rows = np.frombuffer(file.read(), dtype="<f8").reshape(count, 5)
    return motion, rows


class Padasip:
    name = "`padasip`, `FilterRLS`"

    def __init__(self):
        import padasip

        # Its eps is the inverse of the initial variance.
        self.filter = padasip.filters.FilterRLS(4, mu=FORGETTING, eps=1 / VARIANCE, w="zeros")

    def update(self, phi, force):
        self.filter.adapt(force, phi)

    def parameters(self):
        return self.filter.w


class Filterpy:
    name = "`filterpy`, `KalmanFilter` with fading memory"

    def __init__(self):
        from filterpy.kalman import KalmanFilter

        self.filter = KalmanFilter(dim_x=4, dim_z=1)
        self.filter.P = np.eye(4) * VARIANCE
        self.filter.Q = np.zeros((4, 4))
        self.filter.R = np.eye(1)
        # The covariance is multiplied by its square at each prediction.
        self.filter.alpha = 1 / math.sqrt(FORGETTING)

    def update(self, phi, force):
        self.filter.predict()
        self.filter.update(force, H=phi.reshape(1, 4))

    def parameters(self):
        return self.filter.x[:, 0]


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


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    warnings.simplefilter("ignore", RuntimeWarning)
    motion, rows = read(sys.argv[1])
    lines = []
    for kind in (Padasip, Filterpy):
        print(f"{kind.name}: {len(rows)} updates", flush=True)
        lines.append(line(kind(), motion, rows))
    with open(sys.argv[2], "w", encoding="utf-8") as file:
        json.dump(lines, file, indent=1)


if __name__ == "__main__":
    main()
