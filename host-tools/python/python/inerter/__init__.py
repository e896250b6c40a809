"""Runs of an instrumented inerter: open them, and get the numbers of the command line, to the bit.

    import inerter

    run = inerter.open("run.mcap")
    print(inerter.replay(run))

`run.samples` and `run.estimates` are Arrow tables, which pandas, Polars, pyarrow and DuckDB accept directly. A notebook shows
results as tables with a figure. A file, a setting or a motion that cannot be used raises `InerterError` with the code and the help of the
command line; invalid arguments raise ValueError or TypeError. Anything repaired in a run is a warning.
"""

from __future__ import annotations

import array
import json
import os
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Union

from . import _inerter, batch
from ._inerter import InerterError, Run, Sums, Table, __version__
from ._device import Device
from ._runs import told as _told
from ._store import Store
from ._results import Comparison, Diagnosis, Difference, Estimate, Figure, Identification, Merged, Parameter, Plan, Replay, Result, Summed

__all__ = [
    "Comparison",
    "Device",
    "Diagnosis",
    "Difference",
    "Estimate",
    "Figure",
    "Identification",
    "InerterError",
    "Merged",
    "Parameter",
    "Plan",
    "Replay",
    "Result",
    "Run",
    "Store",
    "Sums",
    "Table",
    "__version__",
    "batch",
    "compare",
    "connect",
    "diagnose",
    "identify",
    "merge",
    "open",
    "plan",
    "plot",
    "replay",
    "report",
    "simulate",
]

Progress = Callable[[float], object]
"""Called with the part that is done, from 0 to 1."""

Source = Union[Run, str, "os.PathLike[str]", Mapping[str, Any]]
"""A run, the file of one, or its columns by name."""

_FORCE = {"force_n": False, "torque_n_m": True}
_TERMINAL = {False: "terminal_m", True: "terminal_rad"}
_MEANT = {"t": "t_s", "time": "t_s", "encoder": "encoder_count", "force": "force_n", "torque": "torque_n_m"}
_UNITS = {"t_s": "s", "encoder_count": "counts", "force_n": "N", "torque_n_m": "N m", "terminal_m": "m", "terminal_rad": "rad"}
_OTHER_UNIT = re.compile(
    r"(t|time|encoder|force|torque|terminal)_"
    r"(n?s|[mu]s|min|h|[mk]?n|[mk]?n_?[mc]?m|kgf|lbf|[nuµμcm]?m|in|inch|m?rad|deg|m?v|counts?|codes?)",
    re.IGNORECASE,
)
"""A column of ours in another unit, or with another name."""


def open(
    path: str | os.PathLike[str],
    *,
    settings: Mapping[str, float] | None = None,
    metres_per_count: float | None = None,
    progress: Progress | None = None,
) -> Run:
    """Opens a recording (.mcap) or a CSV file.

    `settings` override those of the run, by their names on the command line (`inerter replay --help` lists them with their units). A CSV
    needs `metres_per_count`: the displacement for one encoder count [m], which is the lead over the counts of a revolution; for a rotary
    machine [rad]. `progress` is called with the part of a recording that is read, from 0 to 1.

    Corrections, missing data and an expired calibration are reported as warnings; `run.notes` has the same texts.

    Raises InerterError if the file or a setting cannot be used, and KeyboardInterrupt on Ctrl-C.
    """
    return _told(_inerter.open(os.fspath(path), _given(settings, metres_per_count), progress), 2)


def replay(
    run: Source,
    settings: Mapping[str, float] | None = None,
    *,
    limits: str | os.PathLike[str] | None = None,
    metres_per_count: float | None = None,
    progress: Progress | None = None,
) -> Replay:
    """Takes a run through the estimator, as the device would have done it: `inerter replay`.

    `run` is one from `open`, a file, or columns by name: `t_s` [s], `encoder_count`, `force_n` [N] and, if it was measured,
    `terminal_m` [m], each a one-dimensional array of the same length; for a rotary machine `torque_n_m` [N m] and `terminal_rad` [rad].
    A data frame or an Arrow table works too. `settings` and `metres_per_count` override those of the run, also of one that is open.

    `limits` is a file as for `inerter replay --limits`; its verdicts are in `["limits"]`.

    Raises InerterError if the run cannot be used, and KeyboardInterrupt on Ctrl-C.
    """
    whole = _run(run, settings, metres_per_count)
    line, sums = _inerter.replay(whole, _path(limits), progress)
    return Replay(json.loads(line), sums, whole)


def compare(
    runs: Iterable[Source] | Mapping[str, Source],
    *,
    rigs: str | None = None,
    path: str | os.PathLike[str] | None = None,
    replace: bool = False,
    limits: str | os.PathLike[str] | None = None,
    settings: Mapping[str, float] | None = None,
    metres_per_count: float | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Compares runs with the first one: `inerter compare`. A mapping gives them names.

    `rigs` is "one" if they share a rig and its calibration, so that the errors of force gain, lead and clock do not count, or
    "several"; without it the runs decide. `path` is a page to write, `limits` a file as for `inerter replay --limits`.

    Raises InerterError if there is only one run, they are of different kinds of machine, or the page cannot be written, and ValueError
    for another value of `rigs`.
    """
    if rigs not in (None, "one", "several"):
        raise ValueError(f"rigs must be 'one' or 'several', not {rigs!r}")
    named: Iterable[tuple[str | None, Source]] = runs.items() if isinstance(runs, Mapping) else ((None, run) for run in runs)
    whole = []
    for name, run in named:
        whole.append((name, _run(run, settings, metres_per_count)))
    is_one_rig = None if rigs is None else rigs == "one"
    line, words, loops = _inerter.compare(whole, is_one_rig, _path(path), replace, _path(limits), progress)
    return Comparison(json.loads(line), words, loops)


def diagnose(
    run: Source,
    *,
    counts_per_turn: float | None = None,
    counts_per_line: float | None = None,
    settings: Mapping[str, float] | None = None,
    metres_per_count: float | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Identifies what breaks the law of the estimator in a run: `inerter diagnose`.

    `counts_per_turn` are the encoder's counts in a turn of the screw, if known; `counts_per_line` those in a period of its lines
    (default 4). The rest as for `replay`.

    Raises InerterError if the run is too short or its motion is not informative.
    """
    whole = _run(run, settings, metres_per_count)
    line, words = _inerter.diagnose(whole, counts_per_turn, counts_per_line, progress)
    return Diagnosis(json.loads(line), words, whole)


def identify(
    runs: Source | Iterable[Source],
    *,
    staged: bool = False,
    segment_s: float | None = None,
    free: str | Iterable[str] = (),
    profiles: bool = True,
    settings: Mapping[str, float] | None = None,
    metres_per_count: float | None = None,
    progress: Progress | None = None,
) -> Identification:
    """Identifies the complete model of one device from one or more runs: `inerter identify`.

    `staged` takes friction from the slowest run and the rest from the next; `segment_s` fits segments of this length [s] separately;
    `free` fits the structure mass ("mr") or the skew ("tau") to the data; `profiles=False` skips the slowest part.

    The complete model needs the measured motion of the terminal (`terminal_m`): a stated motion (`--excite`) works on the command line
    only.

    Raises InerterError if nothing can be identified, and ValueError for another value of `free`.
    """
    free = {free} if isinstance(free, str) else set(free)
    unknown = free - {"mr", "tau"}
    if unknown:
        raise ValueError(f"free takes 'mr' and 'tau', not {', '.join(sorted(map(repr, unknown)))}")
    one = isinstance(runs, (Run, str, os.PathLike)) or _names(runs) is not None
    several: Iterable[Any] = [runs] if one else runs  # type: ignore[assignment]
    whole = []
    for run in several:
        whole.append(_run(run, settings, metres_per_count))
    line = _inerter.identify(whole, staged, segment_s, "mr" in free, "tau" in free, profiles, progress)
    return Identification(json.loads(line), whole[0] if whole else None)


def merge(runs: Iterable[Sums | Summed], *, offset_n: float | None = None) -> Merged:
    """Fits the law to several runs of one device together: `inerter fit`.

    `runs` are results of `replay` or `merge`, or their `sums`. The sums are exact: a thousand runs merged in any order and grouping, on any
    number of workers, give the same to the bit, and a run that is given twice counts once. So workers replay, and pass on `.sums`, which
    can be pickled and added up (`a + b`, without a fit). `offset_n` is the force offset, if known [N].

    Raises InerterError if there is no run, their settings differ, or their motion is not informative.
    """
    sums = []
    for run in runs:
        if not isinstance(run, (Sums, Summed)):
            raise TypeError(f"results of replay or their sums are needed, not {type(run).__name__}")
        sums.append(run if isinstance(run, Sums) else run.sums)
    line, remarks, both = _inerter.merge(sums, None if offset_n is None else float(offset_n))
    return Merged(json.loads(line), remarks, both)


def plot(
    run: Source,
    figure: str,
    *,
    png: str | os.PathLike[str] | None = None,
    replace: bool = False,
    settings: Mapping[str, float] | None = None,
    metres_per_count: float | None = None,
    progress: Progress | None = None,
) -> Figure:
    """Draws one figure of a run: `inerter plot`.

    `figure` is "force", "residual", "loop", "parameters", "backlash" or "bode". Its `svg` is for print and pages, and a notebook draws it;
    `png` is a file to write as well.

    Raises InerterError if the run cannot give the figure or the file cannot be written, and ValueError for an unknown figure.
    """
    whole = _run(run, settings, metres_per_count)
    path = None if png is None else os.fspath(png)
    return Figure(figure, *_inerter.plot(whole, figure, path, replace, progress))


def report(
    run: Source,
    path: str | os.PathLike[str],
    *,
    replace: bool = False,
    limits: str | os.PathLike[str] | None = None,
    settings: Mapping[str, float] | None = None,
    metres_per_count: float | None = None,
    progress: Progress | None = None,
) -> list[str]:
    """Writes a report page of a run, one HTML file that loads nothing else: `inerter report`. Returns the names of its figures.

    With `limits`, a file as for `inerter replay --limits`, the page gives the verdicts.

    Raises InerterError if the file exists and `replace` is not given, or if it cannot be written; then nothing is written.
    """
    return _inerter.report(_run(run, settings, metres_per_count), os.fspath(path), replace, _path(limits), progress)


def plan(
    run: Source | None = None,
    *,
    want: str | Iterable[str] = (),
    motion: str | None = None,
    seed: int = 1,
    preset: str | None = None,
    force_noise_n: float | None = None,
    stroke_m: float | None = None,
    speed_m_per_s: float | None = None,
    force_n: float | None = None,
    duration_s: float | None = None,
    lowest_hz: float | None = None,
    highest_hz: float | None = None,
    fade_s: float | None = None,
    settings: Mapping[str, float] | None = None,
    metres_per_count: float | None = None,
    progress: Progress | None = None,
    **parameters: float,
) -> Plan:
    """Designs the most informative motion for a device, and predicts its intervals: `inerter plan`.

    The expected device is that of an earlier `run`, or a `preset` ("paper", ..), or `inertance_kg`, `viscous_n_s_per_m` and
    `coulomb_n`; `parameters` override it, and without a run `force_noise_n` is needed, the noise of the force [N]. What the rig can do:
    `stroke_m` to either side [m], `speed_m_per_s`, `force_n`, `duration_s`, `lowest_hz`, `highest_hz`, `fade_s` [s].
    `want="fc to 0.3 N, mt to 0.1 %"` makes it as short as that allows; `motion` predicts one of yours instead, as in `simulate`.

    Raises InerterError if nothing can be planned. `missed` lists wanted intervals that are out of reach.
    """
    given_settings = _given(settings, metres_per_count)
    earlier = None if run is None else _run(run, settings, metres_per_count)
    limits = {
        "stroke_m": stroke_m,
        "speed_m_per_s": speed_m_per_s,
        "force_n": force_n,
        "duration_s": duration_s,
        "lowest_hz": lowest_hz,
        "highest_hz": highest_hz,
        "fade_s": fade_s,
    }
    line, remarks, missed, points, figure = _inerter.plan(
        earlier,
        preset,
        _given(parameters),
        None if force_noise_n is None else float(force_noise_n),
        given_settings,
        want if isinstance(want, str) else ", ".join(want),
        None if motion is None else (motion, _seed(seed)),
        {name: float(value) for name, value in limits.items() if value is not None},
        progress,
    )
    return Plan(json.loads(line), remarks, missed, points, figure)


def connect(
    *,
    port: str | None = None,
    address: str | None = None,
    serial: str | None = None,
    baud: int | None = None,
    wait_s: float = 10.0,
) -> Device:
    """Connects to a device: the only one that is plugged in, or the one at a serial `port`, at a TCP `address` ("127.0.0.1:7878", such as a
    simulated one) or with a `serial` number.

        with inerter.connect() as device:
            for estimate in device:
                print(estimate)

    If the device goes away, the connection waits `wait_s` [s] for it. `baud` is for real UARTs.

    Raises InerterError if it cannot be reached.
    """
    if sum(given is not None for given in (port, address, serial)) > 1:
        raise ValueError("give one of port, address and serial")
    return Device(_inerter.connect(port, address, serial, baud, float(wait_s)))


def simulate(
    motion: str | os.PathLike[str] | Mapping[str, Any] = "random",
    *,
    path: str | os.PathLike[str] | None = None,
    replace: bool = False,
    preset: str = "paper",
    seed: int = 1,
    duration_s: float | None = None,
    load_n: float = 0.0,
    change: tuple[float, Mapping[str, float]] | None = None,
    settings: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    **parameters: float,
) -> Run:
    """Simulates an inerter in a rig: `inerter simulate`. Its truth is in `run.truth`.

    `motion` is a name as for `--excite` ("random", "mid@20s", "sine:3.2Hz:4.16mm", ..), the path of a CSV with the columns `t_s` and
    `terminal_m` (a path object, or a string that ends in .csv), or these two columns, such as `plan(..).motion`: equally spaced times [s]
    and displacements [m], which end where they begin. The run lasts `duration_s` [s], else as long as its motion, else 20 s.

    `preset` is the device to start from; `parameters` override it and its instruments by their names, such as `inertance_kg=150`
    or `force_noise_n=5` (`inerter simulate --help` lists them with their units). `change=(10.0, {"inertance_kg": 150.0})` changes the
    device after 10 s. `load_n` is a force on the load cell in addition to the motion [N]. `settings` override those of a perfect
    calibration.

    With `path` the run is written as a recording (.mcap) or a CSV (.csv, its settings beside it) and opened from there; `replace` lets it
    replace another file. Without `path` it is in memory.

    Raises InerterError if device, motion or settings are invalid, or the file cannot be written.
    """
    name, file, points = _motion(motion)
    later = None if change is None else (float(change[0]), _given(change[1]))
    run = _inerter.simulate(
        name,
        file,
        points,
        preset,
        _given(parameters),
        _seed(seed),
        None if duration_s is None else float(duration_s),
        float(load_n),
        later,
        _given(settings),
        None if path is None else os.fspath(path),
        replace,
        progress,
    )
    return _told(run, 2)


def _seed(seed: int) -> int:
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed must be a whole number from 0 to 2**64 - 1, not {seed}")
    return seed


def _motion(motion: Any) -> tuple[str | None, str | None, tuple[float, bytes] | None]:
    """A motion by its name, its file, or its points with their distance in time [s]."""
    if isinstance(motion, str) and not motion.endswith(".csv"):
        return motion, None, None
    if isinstance(motion, (str, os.PathLike)):
        return None, os.fspath(motion), None
    names = _names(motion)
    if names is None:
        raise TypeError(f"a motion by name, a file or columns by name are needed, not {type(motion).__name__}")
    for name in ("t_s", "terminal_m"):
        if name not in names:
            raise ValueError(f"the column {name} of the motion is missing")
    times = array.array("d", _bytes("t_s", motion["t_s"], "d"))
    terminal = _bytes("terminal_m", motion["terminal_m"], "d")
    if len(times) * 8 != len(terminal):
        raise ValueError(f"t_s has {len(times)} values and terminal_m {len(terminal) // 8}: both must have the same number of values")
    if len(times) < 2:
        raise ValueError("a motion needs at least two points")
    period_s = (times[-1] - times[0]) / (len(times) - 1)
    uneven = max(abs(later - earlier - period_s) for earlier, later in zip(times, times[1:]))
    if not uneven <= 1e-3 * period_s:
        raise ValueError("t_s of the motion must be equally spaced")
    return None, None, (period_s, terminal)


def _given(settings: Mapping[str, float] | None, metres_per_count: float | None = None) -> dict[str, float]:
    if settings is not None and not isinstance(settings, Mapping):
        raise TypeError(f"settings must be a mapping of names to numbers, not {type(settings).__name__}")
    given = {name: float(value) for name, value in (settings or {}).items()}
    if metres_per_count is not None:
        given["metres_per_count"] = float(metres_per_count)
    return given


def _path(path: str | os.PathLike[str] | None) -> str | None:
    return None if path is None else os.fspath(path)


def _names(columns: Any) -> list[str] | None:
    """Names of the columns of a mapping, a data frame or an Arrow table; None of anything else."""
    if isinstance(columns, Mapping):
        return [str(name) for name in columns]
    names = getattr(columns, "column_names", None)
    names = getattr(columns, "columns", None) if names is None else names
    return None if names is None or not hasattr(columns, "__getitem__") else [str(name) for name in names]


def _run(run: Any, settings: Mapping[str, float] | None, metres_per_count: float | None) -> Run:
    given = _given(settings, metres_per_count)
    if isinstance(run, Run):
        return _told(_inerter.with_settings(run, given), 3, run.notes) if given else run
    if isinstance(run, (str, os.PathLike)):
        opened = _inerter.open(os.fspath(run), given, None)
    elif (names := _names(run)) is not None:
        opened = _from_columns(run, names, given)
    else:
        raise TypeError(f"a run, a file or columns by name are needed, not {type(run).__name__}")
    return _told(opened, 3)


def _refuse_other_units(names: list[str]) -> None:
    """Refuses what would be left out without a word, or missed: `terminal_mm` in place of `terminal_m`."""
    rotary = "torque_n_m" in names
    for name in names:
        found = None if name in _UNITS else _OTHER_UNIT.fullmatch(name)
        if found is None:
            continue
        of = found[1].lower()
        meant = _MEANT.get(of, _TERMINAL[rotary])
        is_there = any(force in names for force in _FORCE) if of in ("force", "torque") else meant in names
        if not is_there:
            raise ValueError(f"the column {name} has another unit or name: convert it to {meant} [{_UNITS[meant]}], or leave it out")


def _from_columns(columns: Any, names: list[str], given: dict[str, float]) -> Run:
    _refuse_other_units(names)
    forces = [name for name in _FORCE if name in names]
    if len(forces) != 1:
        raise ValueError(f"one of the columns force_n and torque_n_m is needed; there are: {_inerter.printable(', '.join(names))}")
    rotary = _FORCE[forces[0]]
    for name in ("t_s", "encoder_count"):
        if name not in names:
            raise ValueError(f"the column {name} is missing; there are: {_inerter.printable(', '.join(names))}")
    terminal = _TERMINAL[rotary]
    other = _TERMINAL[not rotary]
    if other in names:
        raise ValueError(f"the column {other} does not go with {forces[0]}: {terminal} does")
    return _inerter.from_columns(
        "columns",
        rotary,
        _bytes("t_s", columns["t_s"], "d"),
        _bytes("encoder_count", columns["encoder_count"], "q"),
        _bytes(forces[0], columns[forces[0]], "d"),
        _bytes(terminal, columns[terminal], "d") if terminal in names else b"",
        given,
    )


def _bytes(name: str, values: Any, kind: str) -> bytes:
    """The numbers of a column as 64-bit floats ("d") or whole numbers ("q")."""
    if hasattr(values, "to_numpy"):
        values = values.to_numpy()
    if getattr(values, "ndim", 1) != 1:
        raise ValueError(f"{name} has {values.ndim} dimensions: one is needed")
    of = getattr(getattr(values, "dtype", None), "kind", "f")
    if of not in "iuf" or hasattr(values, "mask"):
        raise ValueError(f"{name} holds values that are missing or not numbers: leave out those rows")
    if kind == "q" and of not in "iu":
        try:
            whole = [int(value) for value in values]
        except (ValueError, OverflowError, TypeError) as error:
            raise ValueError(f"{name} holds a value that is not a whole number: {error}") from None
        if any(value != number for value, number in zip(whole, values)):
            raise ValueError(f"{name} holds a value that is not a whole number")
        values = whole
    elif hasattr(values, "astype"):
        return bytes(values.astype("<f8" if kind == "d" else "<i8").tobytes())
    try:
        return array.array(kind, values).tobytes()
    except (TypeError, OverflowError) as error:
        raise ValueError(f"{name} holds a value that is not a number: {error}") from None
