"""The complete model as one would fit it in Python: scipy.optimize.least_squares around solve_ivp.

    python identify_scipy.py PROBLEM.json [MOST_SECONDS]

Reads a problem as `cargo xtask bench-identify` writes it (samples, start values, what is known beforehand) and writes
PROBLEM.scipy.json beside it. Fits mt cf fc ks cs eps mr tau F0 and the encoder's zero.
The terminal's displacement is smoothed and splined; friction's sign is a steep tanh, as a solver without events needs it;
no step is longer than a sample, so that no impact is stepped over. After MOST_SECONDS, 1800 without it, the fit is stopped.
"""

import json
import sys
import time

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import butter, sosfiltfilt

path = sys.argv[1]
most_s = float(sys.argv[2]) if len(sys.argv) > 2 else 1800.0
problem = json.load(open(path))
period = problem["period_s"]
force = np.array(problem["force_n"])
position = np.array(problem["position_m"])
times = period * np.arange(len(force))
band = butter(4, 40.0, fs=1.0 / period, output="sos")
terminal = CubicSpline(times, sosfiltfilt(band, problem["terminal_m"]))
velocity, acceleration = terminal.derivative(1), terminal.derivative(2)
nodes = terminal(times), velocity(times), acceleration(times)
names = ["inertance_kg", "viscous_n_s_per_m", "coulomb_n", "stiffness_n_per_m", "contact_damping_n_s_per_m",
         "backlash_m", "structure_mass_kg", "skew_s", "offset_n"]
known = problem["known"]
begun = time.perf_counter()
simulations = 0
best = np.inf, None


class Stopped(Exception):
    pass


def contact(apart, closing, ks, cs, eps):
    """Spring and damper beyond the backlash, nothing within."""
    stretch = apart - np.clip(apart, -eps / 2, eps / 2)
    return np.where(stretch != 0.0, ks * stretch + cs * closing, 0.0)


def predicted(values):
    mt, cf, fc, ks, cs, eps, mr, tau, offset, zero = values

    def rate(t, state):
        x, v = state
        push = contact(terminal(t) - x, velocity(t) - v, ks, cs, eps)
        return v, (push - cf * v - fc * np.tanh(v / 2e-4)) / mt

    begin = (position[0] - zero, 0.0)
    solved = solve_ivp(rate, (0.0, times[-1]), begin, t_eval=times, max_step=period, rtol=1e-6, atol=1e-9)
    x, v = solved.y
    cell = contact(nodes[0] - x, nodes[1] - v, ks, cs, eps) + mr * nodes[2]
    return np.interp(times - tau, times, cell) + offset, x + zero


def residual(values):
    global simulations, best
    if time.perf_counter() - begun > most_s:
        raise Stopped
    simulations += 1
    said, moved = predicted(values)
    skipped = int(0.5 / period)
    measured = [(force - said)[skipped:] / problem["force_noise_n"], (position - moved)[skipped:] / problem["position_noise_m"]]
    beforehand = [(values[names.index(name)] - value) / deviation for name, (value, deviation) in known.items()]
    rows = np.concatenate(measured + [beforehand])
    cost = 0.5 * np.sum(rows**2)
    if cost < best[0]:
        best = cost, values.copy()
        print(f"{time.perf_counter() - begun:8.1f} s, {simulations:4} simulations: cost {cost:.4e}", flush=True)
    return rows


start = np.array([problem["start"][name] for name in names] + [float(np.mean(position - nodes[0]))])
scale = np.array([300.0, 50.0, 50.0, 2e6, 1000.0, 1e-5, 1.0, 1e-6, 1.0, 1e-6])
# Positive by nature, all but skew, offset and zero.
least = np.array([0.0] * 7 + [-np.inf] * 3)


def unscaled(u):
    """The start is at 1, so that a relative step of the differences is one in units of the scale."""
    return start + scale * (u - 1.0)


try:
    bounds = (1.0 + (least - start) / scale - 1e-9, np.inf)
    found = least_squares(
        lambda u: residual(unscaled(u)), np.ones(len(start)), diff_step=1e-3, bounds=bounds, ftol=1e-6, xtol=1e-6
    )
    values, stopped, message = unscaled(found.x), False, found.message
except Stopped:
    values, stopped, message = best[1], True, f"stopped after {most_s:.0f} s"
took = time.perf_counter() - begun
print(f"scipy: {took:.1f} s, {simulations} simulations, {message}")
with open(path.rsplit(".", 1)[0] + ".scipy.json", "w") as out:
    found = dict(zip(names, values.tolist()))
    json.dump({"scipy_s": took, "stopped": stopped, "values": found, "simulations": simulations}, out)
