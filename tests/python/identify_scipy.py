"""The complete model as one would fit it in Python: scipy.optimize.least_squares around solve_ivp.

Reads a problem as `cargo xtask bench-identify` writes it (samples, start values) and writes NAME.scipy.json beside it.
The terminal's displacement is smoothed and splined; friction's sign is a steep tanh, as a solver without events needs it.
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
problem = json.load(open(path))
period = problem["period_s"]
force = np.array(problem["force_n"])
position = np.array(problem["position_m"])
mass = problem["structure_mass_kg"]
times = period * np.arange(len(force))
band = butter(4, 40.0, fs=1.0 / period, output="sos")
terminal = CubicSpline(times, sosfiltfilt(band, problem["terminal_m"]))
velocity, acceleration = terminal.derivative(1), terminal.derivative(2)
nodes = terminal(times), velocity(times), acceleration(times)
simulations = 0


def predicted(values):
    global simulations
    simulations += 1
    mt, cf, fc, ks, cs, offset, zero = values

    def rate(t, state):
        x, v = state
        contact = ks * (terminal(t) - x) + cs * (velocity(t) - v)
        return v, (contact - cf * v - fc * np.tanh(v / 2e-4)) / mt

    solved = solve_ivp(rate, (0.0, times[-1]), (position[0] - zero, 0.0), t_eval=times, rtol=1e-6, atol=1e-9)
    x, v = solved.y
    contact = ks * (nodes[0] - x) + cs * (nodes[1] - v)
    return contact + mass * nodes[2] + offset, x + zero


def residual(values):
    said, moved = predicted(values)
    skipped = int(0.5 / period)
    return np.concatenate([(force - said)[skipped:] / 1.0, (position - moved)[skipped:] / 0.7e-6])


start = np.array(problem["start"] + [0.0, float(np.mean(position - nodes[0]))])
scale = np.array([300.0, 50.0, 50.0, 2e6, 1000.0, 1.0, 1e-6])
begun = time.perf_counter()
found = least_squares(residual, start, x_scale=scale, diff_step=1e-4, method="trf", ftol=1e-6, xtol=1e-6)
took = time.perf_counter() - begun
print(f"scipy: {took:.1f} s, {simulations} simulations, {found.message}")
with open(path.rsplit(".", 1)[0] + ".scipy.json", "w") as out:
    json.dump({"scipy_s": took, "values": list(found.x[:5]), "evaluations": simulations}, out)
