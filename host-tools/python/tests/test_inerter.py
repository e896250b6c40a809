"""The package against the command line: the same numbers, to the bit, and the same errors.

INERTER is the program; cargo xtask wheel sets it. RECORDINGS may name a folder with recordings of real machines.
"""

from __future__ import annotations

import inspect
import json
import math
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import time
import traceback
import types
import warnings
from collections.abc import Iterator
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import inerter

PROGRAM = os.environ["INERTER"]
METRES_PER_COUNT = 2.44140625e-6
PAGE = Path(__file__).parents[3] / "docs/PYTHON.md"
# Writes the clipboard, forges a line, changes the writing direction, sets a colour with a single character, and hides a
# character by itself and one behind a letter; and the same as it may be shown.
HOSTILE = "\x1b]52;c;aGk=\x07\nforged\u202e\x9b31m\u200bx\U000e0041"
SHOWN = r"\u001b]52;c;aGk=\u0007\nforged\u202e\u009b31m\u200bx\udb40\udc41"


def told(*arguments: object) -> str:
    """What the command line prints."""
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=True)
    return done.stdout


def line(*arguments: object) -> dict:
    """The last object that it prints."""
    return json.loads(told(*arguments, "--json").splitlines()[-1])


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    told("simulate", "-o", folder / "run.mcap", "--duration", 15, "--excite", "random", "--seed", 3)
    told("simulate", "-o", folder / "run.csv", "--duration", 15, "--excite", "random", "--seed", 3)
    told("simulate", "-o", folder / "late.mcap", "--duration", 15, "--excite", "random", "--delay-s", 0.002)
    told("simulate", "-o", folder / "long.mcap", "--duration", 600, "--excite", "random")
    return folder


@pytest.fixture(scope="session")
def run(folder: Path) -> inerter.Run:
    return inerter.open(folder / "run.mcap")


def test_a_recording_replays_to_the_same_bits(folder: Path, run: inerter.Run) -> None:
    assert dict(inerter.replay(run)) == line("replay", folder / "run.mcap")
    assert dict(inerter.replay(folder / "run.mcap")) == line("replay", folder / "run.mcap")


def test_settings_go_over_those_of_the_run(folder: Path, run: inerter.Run) -> None:
    given = {"structure_mass_kg": 2.0}
    wanted = line("replay", folder / "run.mcap", "--set", "structure_mass_kg=2.0")
    assert wanted != line("replay", folder / "run.mcap")
    assert dict(inerter.replay(folder / "run.mcap", given)) == wanted
    # Of one that is open just so, and over those that it was opened with, which stay what they are.
    other = inerter.open(folder / "run.mcap", settings={"structure_mass_kg": 1.0, "memory_s": 10.0})
    simulated = inerter.simulate("random", duration_s=15, seed=3)
    assert dict(inerter.replay(run, given)) == dict(inerter.replay(simulated, settings=given)) == wanted
    both = line("replay", folder / "run.mcap", "--set", "structure_mass_kg=2.0", "--set", "memory_s=10")
    assert dict(inerter.replay(other, given)) == both and other.settings["structure_mass_kg"] == 1.0
    told("plot", folder / "run.mcap", "--figure", "parameters", "--set", "structure_mass_kg=2.0", "-o", folder / "heavy.svg")
    drawn = inerter.plot(run, "parameters", settings=given).svg
    assert drawn == (folder / "heavy.svg").read_text() and drawn != inerter.plot(run, "parameters").svg


def test_settings_of_a_csv_that_is_open_make_other_samples_of_it(folder: Path) -> None:
    wanted = line("replay", folder / "run.csv", "--metres-per-count", METRES_PER_COUNT, "--set", "newtons_per_code=0.01")
    opened = inerter.open(folder / "run.csv", metres_per_count=1e-6)
    given = inerter.replay(opened, {"newtons_per_code": 0.01}, metres_per_count=METRES_PER_COUNT)
    assert dict(given) == wanted != line("replay", folder / "run.csv", "--metres-per-count", METRES_PER_COUNT)
    assert opened.settings["metres_per_count"] == 1e-6


def test_a_csv_and_its_columns_replay_to_the_same_bits(folder: Path) -> None:
    wanted = line("replay", folder / "run.csv", "--metres-per-count", METRES_PER_COUNT)
    assert dict(inerter.replay(folder / "run.csv", metres_per_count=METRES_PER_COUNT)) == wanted
    frame = pd.read_csv(folder / "run.csv", comment="#")
    columns = {name: frame[name].to_numpy() for name in frame.columns}
    lists = {name: values.tolist() for name, values in columns.items()}
    for given in (frame, columns, lists, pl.from_pandas(frame)):
        assert dict(inerter.replay(given, metres_per_count=METRES_PER_COUNT)) == wanted


def test_causes_and_models_are_those_of_the_command_line(folder: Path) -> None:
    found = inerter.diagnose(folder / "late.mcap", settings={"skew_s": 0.0})
    assert dict(found) == line("diagnose", folder / "late.mcap", "--set", "skew_s=0")
    assert dict(inerter.diagnose(inerter.open(folder / "late.mcap"), settings={"skew_s": 0.0})) == dict(found)
    said = told("diagnose", folder / "late.mcap", "--set", "skew_s=0").splitlines()
    assert found.causes[0]["name"] == "skew" and found.remarks == said[: len(found.remarks)] and len(found.remarks) == 2
    identified = inerter.identify([folder / "run.mcap"], profiles=False)
    assert dict(identified) == line("identify", folder / "run.mcap", "--no-profiles")


def test_runs_merge_to_the_same_bits_whatever_the_order(folder: Path, tmp_path: Path) -> None:
    names = [tmp_path / f"{seed}.mcap" for seed in range(1, 7)]
    for seed, name in enumerate(names, 1):
        told("simulate", "-o", name, "--duration", 8, "--excite", "mid" if seed % 2 else "random", "--seed", seed)
    wanted = line("fit", *names, "--set", "full_scale_velocity_m_per_s=2")
    runs = [inerter.replay(name, settings={"full_scale_velocity_m_per_s": 2}) for name in names]
    merged = inerter.merge(runs)
    assert dict(merged) == wanted and wanted["files"] == sorted(map(str, names))
    assert merged.inertance_kg.value == wanted["symmetric"]["inertance_kg"]["value"]
    assert merged.remarks == ["Sums of 6 runs, fitted together."]
    parts = [inerter.merge(runs[4:]).sums, inerter.merge([runs[3].sums, runs[4]]), inerter.merge(runs[:4])]
    sent = [pickle.loads(pickle.dumps(part.sums if isinstance(part, inerter.Merged) else part)) for part in parts]
    again = inerter.merge(sent)
    assert sent[0] + sent[1] + sent[2] == again.sums
    assert dict(again) == wanted and again.sums == merged.sums and again.sums.to_bytes() == merged.sums.to_bytes()
    assert len(merged.sums) == 6 and inerter.Sums.from_bytes(merged.sums.to_bytes()).names == wanted["files"]
    one = inerter.merge([runs[0]], offset_n=0.5)
    assert dict(one) == line("fit", names[0], "--set", "full_scale_velocity_m_per_s=2", "--offset-n", 0.5)
    for wrong, code in (
        (lambda: inerter.merge([]), "inerter::merge::empty"),
        (lambda: inerter.merge([runs[0], inerter.replay(names[1], settings={"skew_s": 1e-4})]), "inerter::merge::settings"),
        (lambda: inerter.Sums.from_bytes(b"inerter sums 0\n"), "inerter::merge::bytes"),
    ):
        with pytest.raises(inerter.InerterError) as raised:
            wrong()
        assert raised.value.code == code and raised.value.help
    with pytest.raises(TypeError, match="not str"):
        inerter.merge(["run.mcap"])  # type: ignore[list-item]


def test_recordings_of_real_machines_replay_to_the_same_bits() -> None:
    recordings = os.environ.get("RECORDINGS")
    if not recordings:
        pytest.skip("no recordings of real machines")
    paths = sorted(Path(recordings).rglob("*.csv"))
    assert paths
    for path in paths:
        # Any length of a count will do: it is the same for both.
        wanted = line("replay", path, "--metres-per-count", 1e-6)
        assert dict(inerter.replay(path, metres_per_count=1e-6)) == wanted, path


def test_a_simulated_run_is_that_of_the_command_line(folder: Path, tmp_path: Path) -> None:
    held = inerter.simulate("random", duration_s=15, seed=3)
    assert dict(inerter.replay(held)) == line("replay", folder / "run.mcap")
    assert held.truth == inerter.open(folder / "run.mcap").truth and held.truth["inertance_kg"] == "299.4906"
    given = {"inertance_kg": 150.0, "oversampling": 4.0}
    flags = ["--inertance-kg", 150, "--oversampling", 4, "--load", 3, "--set", "memory_s=10", "--excite", "mid@12s"]
    changed = ["--change-at", 6, "--change", "coulomb_n=50", "--preset", "worn"]
    options = {"preset": "worn", "load_n": 3.0, "change": (6.0, {"coulomb_n": 50}), "settings": {"memory_s": 10}}
    for name in ("run.mcap", "run.csv"):
        told("simulate", "-o", tmp_path / f"told-{name}", *flags, *changed)
        written = inerter.simulate("mid@12s", path=tmp_path / name, **options, **given)
        assert (tmp_path / name).read_bytes() == (tmp_path / f"told-{name}").read_bytes()
        assert written.duration_s > 11.9 and written.settings["memory_s"] == 10.0
        with pytest.raises(inerter.InerterError) as raised:
            inerter.simulate("mid@12s", path=tmp_path / name)
        assert raised.value.code == "inerter::output::exists"


def test_a_motion_may_be_points(tmp_path: Path) -> None:
    time_s = np.arange(4001) / 1000.0
    points = {"t_s": time_s, "terminal_m": 0.005 * np.sin(2 * np.pi * 2.0 * time_s) * np.sin(np.pi * time_s / 4.0) ** 2}
    points["terminal_m"][-1] = 0.0
    held = inerter.simulate(points)
    assert abs(held.duration_s - 4.0) < 0.01
    pd.DataFrame(points).to_csv(tmp_path / "motion.csv", index=False, float_format="%.17g")
    read = inerter.simulate(str(tmp_path / "motion.csv"))
    assert pa.table(held.samples).to_pandas().equals(pa.table(read.samples).to_pandas())
    for given in (pd.DataFrame(points), pl.DataFrame(points), pa.table(points)):
        assert pa.table(inerter.simulate(given).samples).equals(pa.table(held.samples))
    for wrong, words in (
        ({"t_s": time_s**2}, "equally spaced"),
        ({"t_s": time_s[:-1]}, "4000 values"),
        ({"terminal_m": np.zeros((4001, 2))}, "2 dimensions"),
    ):
        with pytest.raises(ValueError, match=words):
            inerter.simulate({**points, **wrong})
    with pytest.raises(ValueError, match="terminal_m of the motion is missing"):
        inerter.simulate({"t_s": time_s})


def test_a_plan_is_that_of_the_command_line(folder: Path) -> None:
    rig = {"force_noise_n": 1.0, "stroke_m": 0.01, "speed_m_per_s": 0.1, "duration_s": 6.0}
    flags = [part for name, value in rig.items() if name != "duration_s" for part in ("--" + name.replace("_", "-"), value)]
    device = ["plan", "--preset", "paper", "--inertance-kg", 250, *flags, "--duration", 6]
    planned = inerter.plan(preset="paper", inertance_kg=250.0, **rig)
    assert dict(planned) == line(*device) and planned.missed is None
    assert planned.inertance_kg.value == 250.0 and planned.inertance_kg.u95 > planned.inertance_kg.same_rig_u95 > 0
    points = pa.table(planned.motion).to_pandas()
    assert list(points.columns) == ["t_s", "terminal_m"] and planned.motion["t_s"] == list(points["t_s"])
    assert 0.0 < points["terminal_m"].abs().max() <= 0.01
    assert abs(inerter.simulate(planned.motion).duration_s - 6.0) < 0.1
    wanted = inerter.plan(preset="paper", want=["mt to 0.01 kg"], **rig)
    assert wanted.missed is not None and wanted.missed in repr(wanted)
    given = inerter.plan(preset="paper", motion="mid@10s", **rig)
    assert dict(given) == line("plan", "--preset", "paper", *flags, "--duration", 6, "--excite", "mid@10s")
    assert dict(inerter.plan(folder / "run.mcap", stroke_m=0.01, duration_s=6)) == line(
        "plan", folder / "run.mcap", "--stroke-m", 0.01, "--duration", 6
    )
    for wrong, code in (
        ({"preset": None}, "inerter::plan::unstated"),
        ({"stroke_m": -1.0}, "inerter::plan::limit"),
        ({"want": "mass to 3 kg"}, "inerter::want"),
        ({"motion": "wobble"}, "inerter::plan::motion"),
        ({"preset": "broken"}, "inerter::plan::device"),
    ):
        with pytest.raises(inerter.InerterError) as raised:
            inerter.plan(**{"preset": "paper", **rig, **wrong})
        assert raised.value.code.startswith(code), wrong


def test_what_cannot_be_simulated_is_told(tmp_path: Path) -> None:
    for wrong, code in (
        ({"motion": "wobble"}, "setup"),
        ({"preset": "broken"}, "setup"),
        ({"mass": 3.0}, "setup"),
        ({"inertance_kg": -1.0}, "setup"),
        ({"change": (1.0, {"mass": 3.0})}, "setup"),
        ({"sample_rate_hz": 2000.0, "settings": {"sample_rate_hz": 1000.0}}, "rate"),
        ({"path": tmp_path / "run.wav"}, "format"),
    ):
        with pytest.raises(inerter.InerterError) as raised:
            inerter.simulate(**wrong)
        assert raised.value.code == f"inerter::simulate::{code}", wrong
    for wrong, error in (({"seed": -1}, ValueError), ({"motion": 7}, TypeError), ({"duration_s": "long"}, ValueError)):
        with pytest.raises(error):
            inerter.simulate(**wrong)
    assert not list(tmp_path.iterdir())


def test_samples_are_those_of_the_export(folder: Path, run: inerter.Run) -> None:
    columns = ",".join(run.samples.column_names)
    told("export", folder / "run.mcap", "--parquet", folder / "run.parquet", "--columns", columns, "--force")
    exported = pd.read_parquet(folder / "run.parquet")
    pandas = pa.table(run.samples).to_pandas()
    assert len(run.samples) == len(pandas) == 15_000
    pd.testing.assert_frame_equal(pandas[exported.columns], exported, check_exact=True, check_dtype=False)
    arrow = pa.table(run.samples)
    assert arrow.schema.field("force_n").metadata == {b"unit": b"N"} and run.samples.units["force_n"] == "N"
    assert pl.DataFrame(run.samples).shape == pandas.shape
    samples = run.samples
    assert duckdb.sql("select max(force_n) from samples").fetchall() == [(pandas["force_n"].max(),)]
    assert samples["encoder_count"] == list(pandas["encoder_count"])
    with pytest.raises(KeyError, match="force"):
        samples["force"]
    # What a run holds replays as it does, but for the scale of the force, which arrays have in newtons.
    assert inerter.replay(arrow, metres_per_count=METRES_PER_COUNT).inertance_kg.status == "ok"


def test_estimates_are_those_that_the_device_published(folder: Path, run: inerter.Run) -> None:
    estimates = pa.table(run.estimates).to_pandas()
    assert run.estimates is run.estimates
    lines = [json.loads(text) for text in told("replay", folder / "run.mcap", "--json").splitlines()]
    published = [told["inertance_kg"]["value"] for told in lines if told["kind"] == "estimate" and "final" not in told]
    ours = [None if math.isnan(value) else value for value in estimates["inertance_kg"]]
    wanted = [None if value is None else float(np.float32(value)) for value in published]
    assert ours[: len(wanted)] == wanted and len(ours) >= len(wanted) > 50


@pytest.mark.parametrize("which", ["samples", "estimates"])
def test_every_library_reads_the_same_values(run: inerter.Run, which: str) -> None:
    held = getattr(run, which)
    columns = {name: held[name] for name in held.column_names}
    assert len(held) == len(columns["t_s"]) > 50
    arrow = pa.table(held)
    assert arrow.to_pydict() == columns
    assert pl.DataFrame(held).to_dict(as_series=False) == columns
    assert duckdb.sql("from held").fetchall() == list(zip(*columns.values()))
    # Since pandas 3, which needs Python 3.11.
    if hasattr(pd.DataFrame, "from_arrow"):
        pd.testing.assert_frame_equal(pd.DataFrame.from_arrow(held), arrow.to_pandas(), check_exact=True)


def test_estimates_are_handed_over_without_a_copy(run: inerter.Run) -> None:
    one, other = pa.table(run.estimates), pa.table(run.estimates)
    values = [table["inertance_kg"].chunk(0).buffers()[1].address for table in (one, other)]
    assert values[0] == values[1]


def test_a_run_too_short_for_an_estimate_has_an_empty_table(folder: Path) -> None:
    told("simulate", "-o", folder / "short.csv", "--duration", 0.02)
    short = inerter.open(folder / "short.csv", metres_per_count=METRES_PER_COUNT)
    assert len(short.estimates) == len(pa.table(short.estimates)) == 0 and len(short.samples) == 20


def test_what_was_put_right_in_a_file_is_a_warning(folder: Path) -> None:
    lines = (folder / "run.csv").read_text().splitlines()
    (folder / "gap.csv").write_text("\n".join(lines[:5000] + lines[5500:]) + "\n")
    with pytest.warns(UserWarning, match="500 samples missing"):
        inerter.replay(folder / "gap.csv", metres_per_count=METRES_PER_COUNT)
    with pytest.warns(UserWarning, match="500 samples missing") as given:
        run = inerter.open(folder / "gap.csv", metres_per_count=METRES_PER_COUNT)
    assert len(given) == len(run.notes) and given[0].filename == __file__
    with pytest.warns(UserWarning, match="500 samples missing") as given:
        inerter.compare([folder / "gap.csv", folder / "run.csv"], metres_per_count=METRES_PER_COUNT)
    assert given[0].filename == __file__
    # Told once, also where settings make it another run.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        inerter.replay(run)
        inerter.replay(run, {"memory_s": 10.0})


def test_a_folder_may_change_meanwhile(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    run = inerter.open("run.mcap")
    monkeypatch.chdir(tmp_path)
    assert dict(inerter.replay(run)) == line("replay", folder / "run.mcap")


def test_options_are_those_of_the_command_line(folder: Path, run: inerter.Run) -> None:
    freed = inerter.identify(run, free=iter(["mr"]), profiles=False)
    assert dict(freed) == line("identify", folder / "run.mcap", "--no-profiles", "--free", "mr") | {"files": freed["files"]}
    for wrong in ({"free": "mass"}, {"segment_s": 1e-20}):
        with pytest.raises(ValueError):
            inerter.identify(run, **wrong)
    with pytest.raises(ValueError, match="counts_per_turn"):
        inerter.diagnose(run, counts_per_turn=1.0)
    with pytest.raises(inerter.InerterError, match="no setting `mass`"):
        inerter.replay(run, {"mass": 10.0})
    with pytest.raises(TypeError, match="settings must be a mapping of names to numbers, not str"):
        inerter.replay(run, "limits.toml")  # type: ignore[arg-type]


def test_a_result_shows_itself(run: inerter.Run) -> None:
    replay = inerter.replay(run)
    inertance = replay.inertance_kg
    assert inertance.unit == "kg" and abs(inertance.value - 299.5) < inertance.u95 and inertance.status == "ok"
    assert inertance.same_rig_u95 < inertance.u95
    assert replay.backlash_m.unit == "m" and replay.viscous_n_s_per_m.unit == "N s/m"
    assert str(replay.backlash_m).endswith("e-6 m") and "±" in str(inertance) and repr(run).startswith("inerter.Run of 15.0 s")
    assert "inertance_kg" in repr(replay) and "The law holds." in repr(replay)
    assert "<table>" in replay._repr_html_() and "inertance_kg" in replay._repr_html_()
    assert replay.figure.name == "parameters" and replay.figure.svg in replay._repr_html_()
    # Nothing is drawn of a motion that shows nothing.
    still = inerter.replay(inerter.simulate("hold@3s"))
    assert still.inertance_kg.value is None and "not identifiable" in still._repr_html_()
    with pytest.raises(AttributeError, match="there is no parameter 'mass'"):
        replay.mass


def test_a_figure_is_that_of_the_command_line(folder: Path, run: inerter.Run, tmp_path: Path) -> None:
    for suffix in ("svg", "png"):
        told("plot", folder / "run.mcap", "--figure", "loop", "-o", tmp_path / f"told.{suffix}")
    figure = inerter.plot(run, "loop", png=tmp_path / "loop.png")
    assert figure.svg == figure._repr_svg_() == (tmp_path / "told.svg").read_text() and figure.caption
    assert (tmp_path / "loop.png").read_bytes() == (tmp_path / "told.png").read_bytes()
    with pytest.raises(inerter.InerterError) as raised:
        inerter.plot(run, "loop", png=tmp_path / "loop.png")
    assert raised.value.code == "inerter::output::exists"
    with pytest.raises(ValueError, match="no figure 'circle'; there are: force, residual"):
        inerter.plot(run, "circle")


def test_comparisons_and_plans_show_a_figure(folder: Path) -> None:
    for result, name in (
        (inerter.compare([folder / "run.mcap", folder / "late.mcap"]), "loops"),
        (inerter.plan(preset="paper", motion="mid@10s", duration_s=6.0, force_noise_n=1.0, stroke_m=0.01), "motion"),
    ):
        assert result.figure.name == name and "</svg>" in result.figure.svg and result.figure.caption
        assert result.figure.svg in result._repr_html_()


def test_a_page_is_written_once(folder: Path, run: inerter.Run) -> None:
    page = folder / "page.html"
    assert len(inerter.report(run, page)) >= 5
    told("report", folder / "run.mcap", "-o", folder / "told.html")
    assert page.read_bytes() == (folder / "told.html").read_bytes()
    with pytest.raises(inerter.InerterError, match="page.html") as raised:
        inerter.report(run, page)
    assert raised.value.code == "inerter::output::exists"
    inerter.report(run, page, replace=True)


def test_verdicts_stand_on_a_page_and_in_a_result(folder: Path, run: inerter.Run, tmp_path: Path) -> None:
    limits = tmp_path / "limits.toml"
    limits.write_text("[coulomb_n]\nmax = 45\n[inertance_kg]\nmin = 299.6\n[offset_n]\nmax = 1\n")
    command = [PROGRAM, "report", folder / "run.mcap", "--limits", limits, "-o", tmp_path / "told.html"]
    assert subprocess.run(command, capture_output=True).returncode == 10
    inerter.report(run, tmp_path / "page.html", limits=limits)
    page = (tmp_path / "page.html").read_text()
    assert page == (tmp_path / "told.html").read_text()
    assert 'Limits: <span class="none">fail</span>' in page and "undecided</span>: the interval extends beyond a limit" in page
    result = inerter.replay(run, limits=limits)
    words = "Limits: fail: coulomb_n fail; inertance_kg undecided (the interval extends beyond a limit); offset_n pass."
    assert words in repr(result).splitlines() and words in result._repr_html_()
    compared = inerter.compare({"new": run, "late": folder / "late.mcap"}, limits=limits)
    assert words.replace("Limits:", "Limits of new:") in repr(compared).splitlines()
    assert "Limits of new: fail" in compared._repr_html_() and "Limits of late: " in compared._repr_html_()


def test_runs_are_compared_as_by_the_command_line(folder: Path, tmp_path: Path) -> None:
    files = [folder / "run.mcap", folder / "late.mcap", folder / "run.csv"]
    limits = tmp_path / "limits.toml"
    limits.write_text("[inertance_kg]\nmin = 299.6\n")
    settings = folder / "run.settings.toml"
    undecided = subprocess.run(
        [PROGRAM, "compare", *files[:2], "--rigs", "one", "--limits", limits, "--json", "-o", tmp_path / "told.html"],
        capture_output=True,
        text=True,
    )
    assert undecided.returncode == 10, undecided.stderr
    result = inerter.compare(files[:2], rigs="one", limits=limits, path=tmp_path / "page.html")
    assert dict(result) == json.loads(undecided.stdout)
    assert (tmp_path / "page.html").read_bytes() == (tmp_path / "told.html").read_bytes()
    by_name = {one.name: one for one in result.differences}
    assert by_name["inertance_kg"].run == str(files[1]) and by_name["inertance_kg"].unit == "kg"
    assert f"{files[1]}: " in repr(result) and "not_shown" in repr(result)
    assert "on one rig" in repr(result) and "<table>" in result._repr_html_()
    # The same drive, so nothing differs; a CSV has no board.
    opened = inerter.open(files[2], settings=_settings(settings))
    same = inerter.compare({"recorded <1>": files[0], "as CSV": opened})
    assert same["files"] == ["recorded <1>", "as CSV"] and [one["rig"] for one in same["rigs"]] == ["same", "assumed"]
    assert [one.verdict for one in same.differences] == ["not_shown"] * len(same.differences)
    assert "recorded &lt;1&gt;" in same._repr_html_()
    assert inerter.replay(files[0], limits=limits)["limits"] == json.loads(undecided.stdout)["limits"][0]
    with pytest.raises(inerter.InerterError, match="a comparison needs at least two runs"):
        inerter.compare(files[:1])
    with pytest.raises(inerter.InerterError, match="exists already"):
        inerter.compare(files[:2], path=tmp_path / "page.html")
    with pytest.raises(ValueError, match="'one' or 'several', not 'two'"):
        inerter.compare(files[:2], rigs="two")
    with pytest.raises(inerter.InerterError, match="no parameter is called") as refused:
        limits.write_text("[coulomb]\nmax = 1\n")
        inerter.report(files[0], tmp_path / "other.html", limits=limits)
    assert refused.value.code == "inerter::limits::form" and not (tmp_path / "other.html").exists()


def _settings(path: Path) -> dict[str, float]:
    lines = [text.split(" = ") for text in path.read_text().splitlines() if " = " in text and not text.startswith("#")]
    return {name: float(value) for name, value in lines}


def test_errors_have_the_code_and_the_help_of_the_command_line(folder: Path) -> None:
    nowhere = folder / "nowhere.mcap"
    with pytest.raises(inerter.InerterError) as raised:
        inerter.open(nowhere)
    printed = subprocess.run([PROGRAM, "replay", str(nowhere)], capture_output=True, text=True).stderr
    assert type(raised.value).__module__ == "inerter"
    assert raised.value.code in printed and raised.value.help in " ".join(printed.split())
    for settings, code in (({"mass": 1.0}, "unknown"), ({"memory_s": -1.0}, "value")):
        with pytest.raises(inerter.InerterError) as raised:
            inerter.open(folder / "run.mcap", settings=settings)
        assert raised.value.code == f"inerter::settings::{code}"
    with pytest.raises(inerter.InerterError) as raised:
        inerter.open(folder / "run.csv")
    assert raised.value.code == "inerter::csv::metres_per_count"


def seen(text: str) -> str:
    """The text, if nothing in it is hidden or forged."""
    assert [line for line in text.split("\n") if not line.isprintable() or line.startswith("forged")] == []
    return text


def test_text_from_files_and_devices_is_shown_printable(folder: Path, run: inerter.Run, tmp_path: Path) -> None:
    # A file, by its name.
    lines = (folder / "run.csv").read_text().splitlines()
    path = tmp_path / f"{HOSTILE}.csv"
    path.write_text("\n".join(lines[:5000] + lines[5500:]) + "\n")
    with pytest.warns(UserWarning, match="500 samples missing") as given:
        opened = inerter.open(path, metres_per_count=METRES_PER_COUNT)
    assert [SHOWN in seen(str(warning.message)) for warning in given] == [True] * len(opened.notes)
    assert opened.name == str(path) and HOSTILE in opened.notes[0] and SHOWN in seen(repr(opened))
    for call in (lambda: inerter.open(tmp_path / f"no {HOSTILE}.mcap"), lambda: inerter.replay(run, {HOSTILE: 1.0})):
        with pytest.raises(inerter.InerterError) as raised:
            call()
        assert SHOWN in seen(str(raised.value)) and SHOWN in seen("".join(traceback.format_exception(raised.value)))
    with pytest.raises(ValueError) as refused:
        inerter.replay({HOSTILE: [1.0]})
    assert SHOWN in seen(str(refused.value))
    # Results.
    limits = tmp_path / "limits.toml"
    limits.write_text("[inertance_kg]\nmin = 1\n")
    compared = inerter.compare({HOSTILE: run, f"2 {HOSTILE}": folder / "late.mcap"}, limits=limits)
    assert compared["files"] == [HOSTILE, f"2 {HOSTILE}"] and compared.differences[0].run == f"2 {HOSTILE}"
    figure = inerter.Figure("residual", "<svg></svg>", f"of {HOSTILE}")
    diagnosis = inerter.Diagnosis({"corrected": {}}, [f"remark on {HOSTILE}"], None)
    diagnosis._figure = figure
    page = seen(diagnosis._repr_html_())
    assert f"of {SHOWN}" in page and f"remark on {SHOWN}" in page and f"remark on {SHOWN}" in seen(repr(diagnosis))
    assert f"of {SHOWN}" in seen(repr(figure)) and figure.caption == f"of {HOSTILE}"
    for text in (repr(compared), compared._repr_html_().replace(compared.figure.svg, "")):
        assert f"with {SHOWN}" in seen(text) and f"2 {SHOWN}" in text and f"Limits of {SHOWN}: " in text
    # A device and a store.
    device = inerter.Device(types.SimpleNamespace(name=HOSTILE, identity={"board": HOSTILE, "serial": HOSTILE}))
    assert repr(device) == f"inerter.Device {SHOWN} {SHOWN} at {SHOWN}" and device.identity["board"] == HOSTILE
    store = inerter.Store("runs")
    store._store = types.SimpleNamespace(url=HOSTILE, rows=lambda *_: ([], [("", HOSTILE, "changed")]))
    with pytest.warns(UserWarning, match="is changed") as given:
        store.runs()
    assert str(given[0].message).startswith(f"{SHOWN} in the store {SHOWN} ") and seen(repr(store))


def test_a_repr_hides_nothing_that_python_takes_for_a_letter() -> None:
    # A Hangul filler and a selector beyond 16 bits are drawn as nothing, but Python's repr leaves them as they are.
    hidden, shown = "a\u3164\U000e0100\u202e\nb", r"a\u3164\udb40\udd00\u202e\nb"
    difference = inerter.Difference("inertance_kg", hidden, 1.0, 0.5, "kg", 0.01, "differs", hidden)
    assert difference.run == hidden and repr(difference) == (
        f"Difference(name='inertance_kg', run='{shown}', value=1.0, u95=0.5, unit='kg', p=0.01, verdict='differs', reason='{shown}')"
    )
    parameter = inerter.Parameter(hidden, None, None, "kg", "held", assumes=(hidden,))
    assert parameter.name == hidden and repr(parameter) == (
        f"Parameter(name='{shown}', value=None, u95=None, unit='kg', status='held', same_rig_u95=None, assumes=('{shown}',))"
    )
    with pytest.raises(AttributeError) as raised:
        getattr(inerter.Diagnosis({"corrected": {}}, [], None), hidden)
    assert shown in str(raised.value) and hidden not in str(raised.value)


def test_columns_that_cannot_be_used_are_named() -> None:
    time_s = np.arange(5000) / 1000.0
    good = {"t_s": time_s, "encoder_count": np.arange(5000), "force_n": np.sin(time_s)}
    given = {"metres_per_count": METRES_PER_COUNT}

    def code(**changed: object) -> str:
        with pytest.raises(inerter.InerterError) as raised:
            inerter.replay({**good, **changed}, **given)
        return raised.value.code

    assert code(force_n=np.sin(time_s)[:-1]) == "inerter::columns::length"
    assert code(force_n=np.where(time_s > 1, np.nan, 0.0)) == "inerter::columns::number"
    assert code(force_n=pd.array([1.0, None] * 2500, dtype="Float64")) == "inerter::columns::number"
    assert code(t_s=time_s[::-1].copy()) == "inerter::columns::time"
    assert code(t_s=[], encoder_count=[], force_n=[]) == "inerter::columns::empty"
    for wrong, words in (
        ({"force_n": np.zeros((5000, 2))}, "2 dimensions"),
        ({"encoder_count": good["encoder_count"] + 0.5}, "not a whole number"),
    ):
        with pytest.raises(ValueError, match=words):
            inerter.replay({**good, **wrong}, **given)
    for wrong, words in (
        ({"encoder_count": np.where(time_s > 1, np.nan, 0.0)}, "encoder_count"),
        ({"force_n": ["1"] * 5000}, "force_n"),
        ({"terminal_rad": time_s}, "terminal_rad does not go with force_n"),
    ):
        with pytest.raises(ValueError, match=words):
            inerter.replay({**good, **wrong}, **given)
    with pytest.raises(ValueError, match="force_n and torque_n_m"):
        inerter.replay({"t_s": time_s, "encoder_count": good["encoder_count"], "force": good["force_n"]}, **given)
    with pytest.raises(TypeError, match="not int"):
        inerter.replay(7)  # type: ignore[arg-type]


def test_columns_in_another_unit_are_refused() -> None:
    time_s = np.arange(5000) / 1000.0
    good = {"t_s": time_s, "encoder_count": np.arange(5000), "force_n": np.sin(time_s)}
    given = {"metres_per_count": METRES_PER_COUNT}
    for left_out, name, words in (
        (None, "terminal_mm", r"terminal_mm has another unit or name: convert it to terminal_m \[m\]"),
        (None, "terminal_µm", r"terminal_µm has another unit or name: convert it to terminal_m \[m\]"),
        ("t_s", "t_ms", r"t_ms has another unit or name: convert it to t_s \[s\]"),
        ("t_s", "time_s", r"time_s has another unit or name: convert it to t_s \[s\]"),
        ("force_n", "force_kN", r"force_kN has another unit or name: convert it to force_n \[N\]"),
        ("force_n", "torque_Nm", r"torque_Nm has another unit or name: convert it to torque_n_m \[N m\]"),
        ("encoder_count", "encoder_deg", r"encoder_deg has another unit or name: convert it to encoder_count \[counts\]"),
    ):
        columns = {column: values for column, values in good.items() if column != left_out}
        with pytest.raises(ValueError, match=words):
            inerter.replay({**columns, name: time_s}, **given)
    with pytest.raises(ValueError, match=r"convert it to terminal_rad \[rad\]"):
        inerter.replay({"t_s": time_s, "encoder_count": good["encoder_count"], "torque_n_m": time_s, "terminal_deg": time_s}, **given)
    # Other columns are left alone, also those in another unit beside ours.
    more = {**good, "force_kn": time_s, "torque_nm": time_s, "terminal_speed": time_s, "temperature_k": time_s}
    assert dict(inerter.replay(more, **given)) == dict(inerter.replay(good, **given))
    with pytest.raises(inerter.InerterError) as raised:
        inerter.replay({**good, "t_s": 1e3 * time_s}, **given)
    assert raised.value.code == "inerter::csv::rate" and "t_s is in seconds" in raised.value.help


@pytest.fixture
def address() -> Iterator[str]:
    """Of a simulated device."""
    command = [PROGRAM, "simulate", "--tcp", "127.0.0.1:0", "--excite", "random@4s", "--wait", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        yield json.loads(child.stdout.readline())["address"]
        child.terminate()


def test_a_device_tells_its_estimates_until_its_motion_ends(address: str) -> None:
    with inerter.connect(address=address) as device:
        assert device.name == address and device.identity["board"] == "virtual" and device.settings["sample_rate_hz"] == 1000.0
        estimates = list(device)
    assert 10 < len(estimates) <= 45 and estimates[-1]["kind"] == "estimate"
    times = [estimate["t_s"] for estimate in estimates]
    assert times == sorted(times) and 3.5 < times[-1] <= 4.0
    assert estimates[-1].inertance_kg.unit == "kg" and "inertance_kg" in repr(estimates[-1])
    with pytest.raises(ValueError, match="closed"):
        next(device)


def test_a_device_is_recorded(address: str, tmp_path: Path) -> None:
    with inerter.connect(address=address) as device:
        recorded = device.record(tmp_path / "run.mcap", duration_s=2.0)
        assert 1.8 < recorded.duration_s < 2.4 and len(recorded.samples) > 1800
        assert dict(inerter.replay(recorded)) == line("replay", tmp_path / "run.mcap")
        with pytest.raises(inerter.InerterError) as raised:
            device.record(tmp_path / "run.mcap", duration_s=1.0)
        assert raised.value.code == "inerter::output::exists"
        # What comes after is told as before.
        assert next(device)["t_s"] > 1.5


def test_a_recording_carries_the_calibration(address: str, tmp_path: Path) -> None:
    rig, none, recording = tmp_path / "rig.toml", tmp_path / "none.toml", tmp_path / "run.mcap"
    rig.write_text('[calibration]\ndate = 2001-01-31\ncertificate = "K-2031"\nexpires = 2002-01-31\n')
    none.write_text("memory_s = 30\n")
    with inerter.connect(address=address) as device:
        with pytest.raises(inerter.InerterError, match="there is no such table") as raised:
            device.record(recording, duration_s=2.0, calibration=none)
        assert raised.value.code == "inerter::settings::calibration" and not recording.exists()
        with pytest.warns(UserWarning, match="was valid until 2002-01-31"):
            run = device.record(recording, duration_s=2.0, calibration=rig)
    assert run.calibration == {"date": "2001-01-31", "certificate": "K-2031", "expires": "2002-01-31"}
    assert run.calibration == line("info", recording)["calibration"]
    store = inerter.Store(tmp_path / "store")
    name = store.add(recording)
    with pytest.warns(UserWarning, match="was valid until 2002-01-31"):
        store.open(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        inerter.replay(run)
    assert inerter.simulate(duration_s=1).calibration == {}


def test_a_device_that_cannot_be_reached_is_told() -> None:
    with pytest.raises(inerter.InerterError) as raised:
        inerter.connect(address="127.0.0.1:1")
    assert raised.value.code == "inerter::device::connect" and raised.value.help
    with pytest.raises(ValueError, match="one of"):
        inerter.connect(address="127.0.0.1:1", port="/dev/null")


def test_progress_is_told_and_its_exceptions_end_the_work(folder: Path) -> None:
    parts: list[float] = []
    inerter.replay(folder / "long.mcap", progress=parts.append)
    assert len(parts) > 1 and parts == sorted(parts) and parts[-1] == 1.0

    def refuse(part: float) -> None:
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        inerter.replay(folder / "long.mcap", progress=refuse)


def test_other_threads_go_on_meanwhile(folder: Path) -> None:
    whole = inerter.open(folder / "long.mcap")
    done = threading.Event()
    worker = threading.Thread(target=lambda: (inerter.replay(whole), done.set()))
    worker.start()
    turns = 0
    while worker.is_alive():
        turns += 1
        time.sleep(0.001)
    assert done.is_set() and turns > 2


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted on Linux")
@pytest.mark.parametrize("call", ["replay(run", "diagnose(run", "identify(run", "report(run, page", "compare([run, run]", "plot(run, 'loop'", "plan(run", "simulate(duration_s=9e4"])
def test_ctrl_c_ends_the_work(folder: Path, tmp_path: Path, call: str) -> None:
    # Work that is not ended would have told of its end, and goes on in a thread of its own.
    code = f"""
import inerter, pathlib, time
def tell(part):
    print("begun" if part < 1.0 else "ended", flush=True)
def named(task):
    try:
        return (task / "comm").read_text().strip()
    except OSError:
        return "ended"
def working():
    return any(named(task) == "inerter" for task in pathlib.Path("/proc/self/task").iterdir())
run, page = inerter.open({str(folder / "long.mcap")!r}), {str(tmp_path / "page.html")!r}
try:
    inerter.{call}, progress=tell)
except KeyboardInterrupt:
    for _ in range(300):
        if not working():
            print("stopped", flush=True)
            break
        time.sleep(0.1)
"""
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout is not None and child.stdout.readline() == "begun\n"
    child.send_signal(signal.SIGINT)
    rest, error = child.communicate(timeout=60)
    assert "stopped" in rest and "ended" not in rest and error == "" and list(tmp_path.iterdir()) == []


def described() -> Iterator[tuple[str, object]]:
    """Everything public with its name: functions, classes and their members."""
    for module in (inerter, inerter.batch):
        for name in module.__all__:
            found = getattr(module, name)
            if inspect.isroutine(found) or inspect.isclass(found):
                yield f"{module.__name__}.{name}", found
            members = vars(found).items() if inspect.isclass(found) else ()
            for member, of in members:
                is_one = inspect.isroutine(of) or isinstance(of, (classmethod, property, types.GetSetDescriptorType))
                if is_one and not member.startswith("_"):
                    yield f"{module.__name__}.{name}.{member}", of


def test_everything_public_is_described() -> None:
    documents = {name: inspect.getdoc(of) or "" for name, of in described()}
    assert {"inerter.open", "inerter.Run.samples", "inerter.batch.identify", "inerter.Store.verify"} <= set(documents)
    assert [name for name, text in documents.items() if not text] == []
    # All of these work on files, a store or a device, and say what they raise.
    work = re.compile(r"inerter\.(batch\.|Store\.)?[a-z]+")
    silent = [name for name, text in documents.items() if work.fullmatch(name) and not re.search("Raises|The rest as for", text)]
    assert silent == ["inerter.Store.url"]
    units = inspect.getdoc(inerter.Run.samples)
    run = inerter.simulate(duration_s=1, settings={"terminal_sensor": 1.0})
    assert [name for name in run.samples.column_names if f"`{name}`" not in units] == []


def test_four_lines_lead_from_the_wheel_to_a_figure(tmp_path: Path) -> None:
    page = PAGE.read_text().split("## The package")[1]
    lines = page.split("```sh\n")[1].split("```")[0].splitlines()
    assert len(lines) == 4 and lines[0] == "pip install target/wheels/inerter-*.whl"
    code = re.fullmatch("python -c '(.*)'", "\n".join(lines[1:]), re.DOTALL)
    assert code is not None
    subprocess.run([sys.executable, "-c", code[1]], cwd=tmp_path, check=True)
    assert [path.read_bytes()[:4] for path in tmp_path.iterdir()] == [b"\x89PNG"]
