"""IDIM-IV, SRIVC and an unscented Kalman filter on the same samples as `inerter replay`, written after their papers.

Usage: validation.py FOLDER
FOLDER: data.json, a list of {"name", "file", "count_m", "noise_n"}; each file is a CSV with the columns t_s, position_m, force_n.
Writes FOLDER/rivals.json: a list of {"name", "method", "values", "u95"}, with mt [kg], cf [N s/m], fc [N] of
F = mt a + cf v + fc sgn(v) + F0, and the half widths of the 95 % intervals that each method states itself.

Each is given what its paper gives it and nothing of our estimator: the band of the filters is the only choice, 40 Hz, five
times the highest frequency that the motions have most of their velocity at, one for all data.

IDIM-IV: Janot, Vandanjon and Gautier, "A generic instrumental variable approach for industrial robot identification", IEEE Trans.
    Control Systems Technology 22 (2014). Regressors from the position by a Butterworth filter forth and back and central differences, then a
    parallel decimation; instruments from the simulated direct model, which a controller holds on the measured path as the robot's own does.
SRIVC: Young and Jakeman (1980); Young, "Recursive Estimation and Time-Series Analysis", ch. 8 (2011). The transfer function from the force
    less dry friction and offset to the velocity, 1 / (mt s + cf), with the prefilter 1 / (s + cf / mt) and the instrument of the auxiliary
    model, both refined until they stand. With the model's pole near the origin that prefilter integrates every sign that was placed a part of
    a sample wrong, and the method diverges on all of these data. So the prefilter stays at 20 rad/s, the auxiliary
    model forgets within half a second, and the instrument alone is refined.
UKF: Julier and Uhlmann (2004); van der Merwe's scaled points. State x, v, ln mt, cf, fc, F0; the count's rounding as measurement noise, the force's
    noise as process noise.
"""

import json
import pathlib
import sys
import time

import numpy as np
from scipy import signal

CUTOFF_HZ = 40.0
PREFILTER = 20.0
LEAST_POLE = 2.0
LEFT_OUT_S = 1.0


def velocity_of(position, period):
    """Position, velocity and acceleration after a zero-phase filter."""
    b, a = signal.butter(4, CUTOFF_HZ, fs=1 / period)
    smooth = signal.filtfilt(b, a, position)
    velocity = np.gradient(smooth, period)
    return smooth, velocity, np.gradient(velocity, period)


def regressors(a, v):
    return np.column_stack([a, v, np.sign(v), np.ones_like(v)])


def decimated(columns, period):
    """The parallel filter of the method: all columns alike, and no more samples than it leaves independent."""
    factor = max(1, int(0.8 / (2 * CUTOFF_HZ * period)))
    b, a = signal.butter(4, CUTOFF_HZ, fs=1 / period)
    return signal.filtfilt(b, a, columns, axis=0)[::factor]


def follow(values, position, velocity, acceleration, period):
    """The direct model with these parameters, held on a path by a stiff controller with the inertia known ahead."""
    m, c, f, _ = values
    w = 2 * np.pi * 20.0
    x, v = position[0], velocity[0]
    found = np.empty((len(position), 2))
    steps = 4
    h = period / steps
    for n, (x_wanted, v_wanted, a_wanted) in enumerate(zip(position, velocity, acceleration)):
        for step in range(steps):
            ahead = step * h
            wanted = a_wanted + w * w * (x_wanted + v_wanted * ahead - x) + 1.6 * w * (v_wanted + a_wanted * ahead - v)
            # The controller knows viscous friction, and dry friction by the sign of the path.
            force = m * wanted + c * v_wanted + f * np.tanh(v_wanted / 1e-3)
            a = (force - c * v - f * np.tanh(v / 1e-3)) / m
            if step == 0:
                found[n] = a, v
            v += h * a
            x += h * v
    return found


def idim_iv(x, force, period):
    smooth, v, a = velocity_of(x, period)
    phi = regressors(a, v)
    left = int(LEFT_OUT_S / period)
    inner = slice(left, len(x) - left)
    y = decimated(force[:, None], period)
    w = decimated(phi, period)
    factor = len(x) // len(w)
    rows = slice(inner.start // factor, inner.stop // factor)
    values = np.linalg.lstsq(w[rows], y[rows, 0], rcond=None)[0]
    for _ in range(10):
        followed = follow(values, smooth, v, a, period)
        z = decimated(regressors(followed[:, 0], followed[:, 1]), period)
        before = values
        values = np.linalg.solve(z[rows].T @ w[rows], z[rows].T @ y[rows, 0])
        if np.all(np.abs(values - before) <= 1e-4 * np.abs(values) + 1e-9):
            break
    residual = y[rows, 0] - w[rows] @ values
    square = residual @ residual / (len(residual) - 4)
    covariance = square * np.linalg.inv(z[rows].T @ z[rows])
    return values[:3], 1.96 * np.sqrt(np.diag(covariance))[:3]


def srivc(x, force, period):
    sign = np.sign(velocity_of(x, period)[1])
    velocity = np.gradient(x, period)
    left = int(LEFT_OUT_S / period)
    inner = slice(left, len(x) - left)

    def low(u, p):
        b, a, _ = signal.cont2discrete(([1.0], [1.0, p]), period, method="foh")
        return signal.lfilter(b.ravel(), a, u)

    driving = [low(u, PREFILTER) for u in (force, sign, np.ones_like(x))]
    columns = np.column_stack([low(velocity, PREFILTER)] + driving)
    target = velocity - PREFILTER * columns[:, 0]
    # From least squares with state-variable filters.
    instruments, values = columns, None
    for _ in range(50):
        # v' = -(c/m) v + F/m - (f/m) s - o/m.
        theta = np.linalg.solve(instruments[inner].T @ columns[inner], instruments[inner].T @ target[inner])
        before, values = values, np.array([1.0, -theta[0], -theta[2], -theta[3]]) / theta[1]
        if before is not None and np.all(np.abs(values - before) <= 1e-5 * np.abs(values) + 1e-9):
            break
        m, c, f, o = values
        model = low((force - f * sign - o) / m, max(c / m, LEAST_POLE))
        instruments = np.column_stack([low(model, PREFILTER)] + driving)
    residual = target[inner] - columns[inner] @ theta
    square = residual @ residual / (len(residual) - 4)
    covariance = square * np.linalg.inv(instruments[inner].T @ instruments[inner])
    # From theta to the parameters, to first order.
    jacobian = np.array([[0, -m * m, 0, 0], [-m, -m * c, 0, 0], [0, -m * f, -m, 0], [0, -m * o, 0, -m]])
    return values[:3], 1.96 * np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))[:3]


def ukf(x, force, period, count_m, noise_n):
    _, v, a = velocity_of(x, period)
    start = regressors(a, v)[: int(2 / period)]
    rough = np.linalg.lstsq(start, force[: len(start)], rcond=None)[0]
    mass = abs(rough[0]) if np.isfinite(rough[0]) and rough[0] != 0 else 100.0
    state = np.array([x[0], v[0], np.log(mass), 0.0, 0.0, 0.0])
    scale = np.sqrt(np.mean(force**2))
    spread = np.diag([count_m, 1e-2, 1.0, scale / 0.05, scale, scale]) ** 2
    process = np.diag([0.0, (max(noise_n, 1e-3) / mass * period) ** 2, 0, 0, 0, 0])
    measured = count_m**2 / 12
    count, alpha, beta, kappa = 6, 0.1, 2.0, 0.0
    lam = alpha**2 * (count + kappa) - count
    weights = np.full(2 * count + 1, 0.5 / (count + lam))
    weights[0] = lam / (count + lam)
    covariance_weights = weights.copy()
    covariance_weights[0] += 1 - alpha**2 + beta
    for n in range(1, len(x)):
        root = np.linalg.cholesky((count + lam) * (spread + 1e-18 * np.diag(np.diag(spread) + 1e-12)))
        points = np.vstack([state, state + root.T, state - root.T])
        # Two halves of a step, each with its own dry friction.
        push = 0.5 * (force[n - 1] + force[n])
        for _ in range(2):
            m = np.exp(points[:, 2])
            dry = points[:, 4] * np.tanh(points[:, 1] / 1e-4)
            rate = (push - points[:, 3] * points[:, 1] - dry - points[:, 5]) / m
            points[:, 0] += 0.5 * period * (points[:, 1] + 0.25 * period * rate)
            points[:, 1] += 0.5 * period * rate
        state = weights @ points
        off = points - state
        spread = (covariance_weights[:, None] * off).T @ off + process
        gain = spread[:, 0] / (spread[0, 0] + measured)
        state = state + gain * (x[n] - state[0])
        spread = spread - np.outer(gain, gain) * (spread[0, 0] + measured)
        spread = 0.5 * (spread + spread.T)
    m = np.exp(state[2])
    u = 1.96 * np.sqrt(np.diag(spread)[2:5]) * np.array([m, 1.0, 1.0])
    return np.array([m, state[3], state[4]]), u


def main():
    folder = pathlib.Path(sys.argv[1])
    found = []
    for data in json.loads((folder / "data.json").read_text()):
        t, x, force = np.loadtxt(folder / data["file"], delimiter=",", skiprows=1, unpack=True)
        period = (t[-1] - t[0]) / (len(t) - 1)
        methods = [
            ("IDIM-IV", lambda: idim_iv(x, force, period)),
            ("SRIVC", lambda: srivc(x, force, period)),
            ("UKF", lambda: ukf(x, force, period, data["count_m"], data["noise_n"])),
        ]
        for method, run in methods:
            start = time.perf_counter()
            try:
                values, u95 = run()
            except np.linalg.LinAlgError as error:
                values, u95 = np.full(3, np.nan), np.full(3, np.nan)
                print(f"{data['name']}, {method}: {error}", file=sys.stderr)
            seconds = time.perf_counter() - start
            number = lambda all: [float(value) if np.isfinite(value) else None for value in all]
            found.append({"name": data["name"], "method": method, "values": number(values), "u95": number(u95)})
            print(data["name"], method, number(values), number(u95), f"{seconds:.1f} s", flush=True)
    (folder / "rivals.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main()
