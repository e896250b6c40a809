"""A third plant, which has set no number: inverse dynamics of a motion that is known in closed form, and `inerter replay` on its samples.

Usage: plant.py FOLDER PROGRAM
PROGRAM: `inerter`. Writes FOLDER/plant.json: a list of {"kind", "runs", "wrong", "told", "assumed", "silent", "device", "broken", "words"}, the
first of them without a defect. What a run comes to is read from the last line of `inerter replay --json`, as anybody would.

The position is a sum of sines, so velocity and acceleration are exact, and the force is
F = mt a + cf v + fc sgn(v) + F0 at the moment of the sample: there is no integration, no contact, no structure. Presliding friction
is Dahl's, in steps of a hundredth of its distance. Kinds, sizes and draws are this file's own.

Wrong: a value of mt, cf or fc that is given and lies further from the truth than its interval (`uncertainty.<parameter>.u95`; for the device
`whole_run.<parameter>.u95`). Told: the law is called broken, or a warning or `moved_by` names the defect. Assumed: only `assumes` names it.
"""

import concurrent.futures
import json
import pathlib
import subprocess
import sys

import numpy as np

RATE_HZ = 1000.0
DURATION_S = 20.0
SEED = 80001
RUNS, CLEAN = 6, 150
MOTIONS = ("tone", "tones")
PARAMETERS = ("inertance_kg", "viscous_n_s_per_m", "coulomb_n")
# An encoder's error once a turn is one that repeats with the position, and a cell that is not linear grows with the load.
KINDS = {
    "force inverted": ("wrong_sign",),
    "no mass": ("wrong_sign",),
    "friction that grows with the load": ("load_dependent",),
    "force once a turn": ("position_periodic", "encoder_error"),
    "friction greater at low speed": ("stribeck",),
    "presliding friction": ("presliding",),
    "offset that drifts": ("drift",),
    "friction that falls as it warms": ("drift",),
    "delayed force": ("skew",),
    "eccentric encoder": ("encoder_error", "position_periodic"),
    "viscous friction that differs by direction": ("direction",),
    "friction by the square of the velocity": ("quadratic_friction",),
    "spring in parallel": ("spring",),
    "load cell that saturates softly": ("force_nonlinear",),
    "clipped force": ("clipped_force",),
    "counts that slip": ("count_slip",),
    "force that freezes halfway through the run": ("dead_force",),
}


def motion(draw, name):
    """Position, velocity and acceleration at any time."""
    if name == "tone":
        hertz, speed = draw.uniform(2.0, 6.0, 1), [draw.uniform(0.05, 0.12)]
    else:
        hertz = np.sort(draw.uniform(0.5, draw.uniform(8.0, 15.0), draw.integers(5, 11)))
        speed = draw.uniform(0.5, 1.5, len(hertz))
        speed *= draw.uniform(0.015, 0.04) / np.sqrt(np.sum(speed**2) / 2)
    w, phase, speed = 2 * np.pi * hertz, draw.uniform(0, 2 * np.pi, len(hertz)), np.array(speed)

    def of(t):
        angle = np.multiply.outer(t, w) + phase
        return np.sin(angle) @ (speed / w), np.cos(angle) @ speed, -np.sin(angle) @ (speed * w)

    return of


def dahl(x, distance):
    """Friction over its greatest along a path: d(f)/dx = (1 - f sgn(dx)) / distance, in closed form over each step of the path."""
    f = np.zeros(len(x))
    for n in range(1, len(x)):
        step = x[n] - x[n - 1]
        sign = np.sign(step)
        f[n] = sign - (sign - f[n - 1]) * np.exp(-abs(step) / distance)
    return f


def make(kind, name, seed):
    """A run: counts, forces, what it takes to replay it, and the range that holds each truth."""
    draw = np.random.default_rng([seed, MOTIONS.index(name)])
    of = motion(draw, name)
    t = np.arange(int(RATE_HZ * DURATION_S)) / RATE_HZ
    x, v, a = of(t)
    v_rms, a_rms = np.sqrt(np.mean(v**2)), np.sqrt(np.mean(a**2))
    mt = 10 ** draw.uniform(1.3, 2.7)
    scale = mt * a_rms
    fc, cf = draw.uniform(0.02, 0.2) * scale, draw.uniform(0.02, 0.1) * scale / v_rms
    offset, noise = draw.uniform(-0.1, 0.1) * scale, 10 ** draw.uniform(-3.5, -2.3) * scale
    count = draw.choice([0.5e-6, 1e-6, 2.44e-6, 5e-6])
    unit, lead = draw.uniform(), draw.uniform(0.004, 0.02)
    size = draw.uniform(0.5, 2.0)
    sign, stroke = np.sign(v), np.ptp(x) / 2
    truth = {"inertance_kg": [mt, mt], "viscous_n_s_per_m": [cf, cf], "coulomb_n": [fc, fc]}
    rubs = fc * sign
    if kind == "no mass":
        mt, truth["inertance_kg"] = 0.0, [0.0, 0.0]
    if kind == "friction greater at low speed":
        rubs = fc * sign * (1 + 0.3 * size * np.exp(-np.abs(v) / (0.1 * v_rms)))
    if kind == "presliding friction":
        fine = 20
        path = of(np.arange(len(t) * fine) / (RATE_HZ * fine))[0]
        rubs = fc * dahl(path, 0.01 * size * stroke)[::fine]
    if kind == "friction that falls as it warms":
        rubs = fc * sign * (1 + 0.3 * size * np.exp(-t / 8.0))
        truth["coulomb_n"] = [fc, fc * (1 + 0.3 * size)]
    force = mt * a + cf * v + rubs + offset
    beside = {
        "friction that grows with the load": 0.03 * size * np.abs(force) * sign,
        "force once a turn": 0.03 * size * scale * np.sin(2 * np.pi * x / lead),
        "offset that drifts": 0.05 * size * scale * t / DURATION_S,
        "viscous friction that differs by direction": 0.3 * size * cf * np.abs(v),
        "friction by the square of the velocity": 0.05 * size * scale / v_rms**2 * v * np.abs(v),
        "spring in parallel": 0.05 * size * scale / stroke * x,
    }
    force = force + beside.get(kind, 0.0)
    if kind == "delayed force":
        force = np.interp(t - 1e-3 * size, t, force)
    if kind == "load cell that saturates softly":
        force = force - 0.05 * size * force**3 / np.max(np.abs(force)) ** 2
    force = force + noise * draw.standard_normal(len(t))
    if kind == "clipped force":
        force = np.clip(force, -0.8 * np.max(np.abs(force)), 0.8 * np.max(np.abs(force)))
    if kind == "force that freezes halfway through the run":
        force[len(t) // 2 :] = force[len(t) // 2]
    if kind == "force inverted":
        force = -force
    if kind == "eccentric encoder":
        x = x + 0.01 * size * stroke * np.sin(2 * np.pi * x / lead)
    counts = np.floor(x / count + unit).astype(int)
    if kind == "counts that slip":
        counts = counts + 200 * np.searchsorted(np.arange(3.3, DURATION_S, 2.7), t)
    return counts, force, (count, noise / 20), truth


def replayed(program, folder, kind, name, seed):
    """What the last line of a replay says of one run."""
    counts, force, (count, code), truth = make(kind, name, seed)
    file = folder / f"{abs(hash((kind, name, seed)))}.csv"
    t = np.arange(len(counts)) / RATE_HZ
    np.savetxt(file, np.column_stack([t, counts, force]), "%.6f,%d,%.9g", header="t_s,encoder_count,force_n", comments="")
    perfect = ("force_gain_u95", "lead_u95", "timebase_u95", "skew_u95_s", "structure_mass_kg", "structure_mass_u95_kg")
    given = [f"{setting}=0" for setting in perfect] + [f"newtons_per_code={code:.9g}"]
    # A contact that nothing parts is known to be closed; without a stiffness nothing is known of it.
    given += ["stiffness_n_per_m=1e9"] if seed % 2 else []
    command = [program, "replay", file, "--json", "--metres-per-count", f"{count:.9g}"]
    said = subprocess.run(command + [word for one in given for word in ("--set", one)], capture_output=True, text=True)
    file.unlink()
    if said.returncode != 0:
        raise RuntimeError(f"{kind}, {name}, {seed}: {said.stderr}")
    return judged(json.loads(said.stdout.splitlines()[-1]), KINDS.get(kind, ()), truth)


def judged(last, names, truth):
    """The worst that a run says: of replay and of the device alone, whether the law is broken, and whether anything is said at all."""
    broken = last["law"]["status"] == "broken"
    codes = {warning["code"] for warning in last["warnings"]}

    def worst(u95_of, with_samples):
        found = "right"
        for parameter in PARAMETERS:
            given, said = last["whole_run"][parameter], last["uncertainty"][parameter]
            if given["value"] is None:
                continue
            low, high = truth[parameter]
            if max(low - given["value"], given["value"] - high) <= u95_of(given, said):
                continue
            told = broken or codes & set(names) or (with_samples and said.get("moved_by") in names)
            assumed = with_samples and set(said["assumes"]) & set(names)
            word = "told" if told else "assumed" if assumed else "silent"
            found = max(found, word, key=("right", "told", "assumed", "silent").index)
        return found

    device = worst(lambda given, _: given["u95"], False)
    return worst(lambda _, said: said["u95"], True), device, broken, bool(codes)


def main(folder, program):
    jobs = [(None, name, SEED + n) for n in range(CLEAN) for name in MOTIONS]
    jobs += [(kind, name, SEED + n) for kind in KINDS for n in range(RUNS) for name in MOTIONS]
    with concurrent.futures.ThreadPoolExecutor() as pool:
        said = list(pool.map(lambda job: replayed(program, folder, *job), jobs))
    rows = []
    for kind in (None, *KINDS):
        runs = [found for job, found in zip(jobs, said) if job[0] == kind]
        words = [word for word, *_ in runs]
        rows.append({
            "kind": kind or "clean",
            "runs": len(runs),
            "wrong": sum(word != "right" for word in words),
            **{word: words.count(word) for word in ("told", "assumed", "silent")},
            "device": sum(device == "silent" for _, device, *_ in runs),
            "broken": sum(broken for *_, broken, _ in runs),
            "words": sum(words for *_, words in runs),
        })
    (folder / "plant.json").write_text(json.dumps(rows))


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), sys.argv[2])
