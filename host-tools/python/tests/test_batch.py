"""The runs of a store on Dask: the numbers of the command line, a worker that dies, a run that fails, a cluster without the package."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from distributed import Client, LocalCluster

import inerter

PROGRAM = os.environ["INERTER"]
RUNS = 8


def told(*arguments: object) -> str:
    """What the command line prints."""
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("batches")
    store = inerter.Store(folder / "store")
    for seed in range(RUNS):
        told("simulate", "-o", folder / f"{seed}.mcap", "--duration", 5, "--seed", seed)
        store.add(folder / f"{seed}.mcap")
    return folder


def by_run(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {row["run"]: row for row in rows}


def test_two_workers_one_here_and_the_command_line_say_the_same(stored: Path) -> None:
    store = inerter.Store(stored / "store")
    parts: list[float] = []
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        spread = by_run(inerter.batch.replay(store, client, batch="two", progress=parts.append))
        named = by_run(inerter.batch.diagnose(store, client, where=["device = SIM-1"]))
        modelled = by_run(inerter.batch.identify(store, client, batch="models", where="device = SIM-2"))
        assert by_run(inerter.batch.replay(store, client, batch="two")) == spread
    assert len(spread) == RUNS and parts[-1] == 1.0 and len(named) == len(modelled) == 1
    here = by_run(inerter.batch.replay(store, batch="here"))
    told("replay", "--store", stored / "store", "--batch", "program")
    program = by_run(store.results("program"))
    assert spread == here == program
    for name, row in spread.items():
        assert row["result"]["final"] and row["error"] is None and row["given"] == {}
        assert row["result"] == dict(inerter.replay(store.open(name)))
    for rows, call in ((named, inerter.diagnose), (modelled, inerter.identify)):
        for name, row in rows.items():
            assert row["error"] is None and row["result"] == dict(call(store.open(name)))
    changed = inerter.batch.replay(store, batch="heavy", settings={"structure_mass_kg": 3.0}, device="SIM-2")
    assert changed[0]["given"] == {"structure_mass_kg": 3.0}
    assert changed[0]["result"] == dict(inerter.replay(stored / "2.mcap", settings={"structure_mass_kg": 3.0}))


def test_identify_goes_back_into_the_store(stored: Path) -> None:
    store = inerter.Store(stored / "store")
    rows = inerter.batch.identify(store, device="SIM-3")
    assert [row["kind"] for row in rows] == ["identify"]
    assert rows[0]["error"] is None and rows[0]["result"] == dict(inerter.identify(store.open(rows[0]["run"]))), rows
    assert inerter.batch.identify(store, where=iter(["device = SIM-3"])) == rows


def die_once(mark: str) -> None:
    """Ends the worker that is asked first, as a machine that fails would."""
    try:
        os.close(os.open(mark, os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no signals here")
def test_a_worker_that_dies_loses_nothing(stored: Path, tmp_path: Path) -> None:
    store = inerter.Store(stored / "store")
    mark = tmp_path / "died"
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        before = set(client.run(os.getpid).values())
        # Among the runs, on a worker that then does not come to its others.
        death = client.submit(die_once, str(mark), pure=False)
        rows = inerter.batch.replay(store, client, batch="died")
        death.result()
        assert set(client.run(os.getpid).values()) != before
    assert mark.exists() and len(rows) == RUNS and all(row["error"] is None for row in rows)
    assert {row["run"] for row in rows} == {row["run"] for row in store.runs()}


def test_a_run_that_fails_is_a_row_with_its_error(stored: Path, tmp_path: Path) -> None:
    store = inerter.Store(tmp_path / "store")
    names = [store.add(stored / f"{seed}.mcap") for seed in (0, 1)]
    recording = next((tmp_path / "store/recordings").rglob(f"{names[0]}.mcap"))
    recording.chmod(0o600)
    recording.write_bytes(b"no recording any more")
    rows = by_run(inerter.batch.replay(store))
    assert rows[names[1]]["error"] is None and rows[names[1]]["result"]["final"]
    assert rows[names[0]]["result"] is None and rows[names[0]]["code"].startswith("inerter::")
    # It is not tried again, unless that is asked for.
    recording.write_bytes((stored / "0.mcap").read_bytes())
    assert by_run(inerter.batch.replay(store))[names[0]]["result"] is None
    assert by_run(inerter.batch.replay(store, again=True))[names[0]]["result"]["final"]
    # Settings that no run can have are the caller's, before any work.
    with pytest.raises(inerter.InerterError) as caught:
        inerter.batch.replay(store, batch="wrong", settings={"memory": 1.0})
    assert caught.value.code == "inerter::settings::unknown" and store.results("wrong") == []
    done = store.results("replay")
    with pytest.raises(inerter.InerterError, match="no setting `memory`"):
        inerter.batch.replay(store, settings={"memory": 1.0}, again=True)
    assert store.results("replay") == done
    # A batch is of one kind, with the same settings.
    for call, settings in ((inerter.batch.replay, {"memory_s": 5.0}), (inerter.batch.diagnose, None)):
        with pytest.raises(inerter.InerterError, match="was made by") as caught:
            call(store, batch="replay", settings=settings)
        assert caught.value.code == "inerter::store::other_batch"
    with pytest.raises(inerter.InerterError, match="cannot be the name of a batch"):
        inerter.batch.replay(store, batch="../x")
    with pytest.raises(inerter.InerterError, match="there is no store"):
        inerter.batch.replay(inerter.Store(tmp_path / "nothing"))


def test_a_run_that_is_removed_meanwhile_is_left_out(
    stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = inerter.Store(tmp_path / "store")
    names = [store.add(stored / f"{seed}.mcap") for seed in (0, 1)]
    replay = inerter.replay

    def removing(run: inerter.Run) -> inerter.Replay:
        result = replay(run)
        if names[0] in run.name:
            store.remove(names[0])
        return result

    monkeypatch.setattr(inerter, "replay", removing)
    assert [row["run"] for row in inerter.batch.replay(store)] == names[1:]
    assert [row["run"] for row in store.runs()] == names[1:]


HIDDEN = """
import sys
for name in [name for name in sys.modules if name.split(".")[0] == "inerter"]:
    del sys.modules[name]
sys.modules["inerter"] = None
"""


def test_a_cluster_without_the_package_is_told(stored: Path) -> None:
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        client.run(exec, HIDDEN, {})
        with pytest.raises(RuntimeError, match="has no package inerter.*pip install"):
            inerter.batch.replay(inerter.Store(stored / "store"), client, batch="none")
    assert inerter.Store(stored / "store").results("none") == []
