"""Stores of runs, in a folder and in S3, and the engines that read their tables without this package.

GOLDEN is a store that the first version has written: every later one reads it.
"""

from __future__ import annotations

import json
import os
import pickle
import shutil
import stat
import subprocess
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import boto3
import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pytest
from moto.server import ThreadedMotoServer

import inerter

PROGRAM = os.environ["INERTER"]
GOLDEN = Path(__file__).parent / "golden-store"


def told(*arguments: object) -> str:
    """What the command line prints."""
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stored")
    for seed in (1, 2):
        told("simulate", "-o", folder / f"{seed}.mcap", "--duration", 6, "--seed", seed)
    return folder


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """S3 on loopback."""
    server = ThreadedMotoServer(port=0)
    server.start()
    host, port = server.get_host_and_port()
    given = {
        "AWS_ACCESS_KEY_ID": "us",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "eu-central-1",
        "AWS_ENDPOINT": f"http://{host}:{port}",
        "AWS_ALLOW_HTTP": "true",
    }
    os.environ.update(given)
    client = boto3.client("s3", endpoint_url=given["AWS_ENDPOINT"], region_name="us-east-1")
    client.create_bucket(Bucket="lab")
    yield given["AWS_ENDPOINT"]
    for name in given:
        del os.environ[name]
    server.stop()


@pytest.fixture(params=["folder", "s3"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "folder":
        return str(tmp_path / "store")
    request.getfixturevalue("server")
    return f"s3://lab/{tmp_path.name}/store"


def test_runs_go_in_are_found_and_come_back(folder: Path, url: str, tmp_path: Path) -> None:
    store = inerter.Store(url)
    with pytest.raises(inerter.InerterError, match="there is no store") as caught:
        store.runs()
    assert caught.value.code == "inerter::store::none"
    parts: list[float] = []
    names = [store.add(folder / f"{seed}.mcap", progress=parts.append) for seed in (1, 2)]
    assert parts[-1] == 1.0 and len(store) == 2
    assert store.add(folder / "1.mcap") == names[0] and len(store) == 2
    run = store.open(names[0][:10])
    replayed = inerter.replay(run)
    assert dict(replayed) == dict(inerter.replay(folder / "1.mcap"))
    row = store.run(names[0])
    assert row["inertance_kg"] == np.float64(np.float32(replayed["whole_run"]["inertance_kg"]["value"]))
    assert row["inertance_u95_kg"] == np.float64(np.float32(replayed["uncertainty"]["inertance_kg"]["u95"]))
    assert row["settings"] == run.settings and row["device"] == "SIM-1"
    assert {row["run"] for row in store.runs("samples = 6000", device="SIM-2")} == {names[1]}
    assert store.runs("law = broken") == [] and store.runs(start="1970-01-02") == []
    with pytest.raises(inerter.InerterError, match="no run has such a column") as caught:
        store.runs("inertance < 3")
    assert "did you mean inertance_kg?" in str(caught.value.help)
    store.get(names[1], tmp_path / "back.mcap")
    assert (tmp_path / "back.mcap").read_bytes() == (folder / "2.mcap").read_bytes()
    assert store.verify() == []
    again = pickle.loads(pickle.dumps(store))
    again.remove(names[0][:12])
    assert [row["run"] for row in store.runs()] == [names[1]]
    with pytest.raises(inerter.InerterError, match="has no run"):
        store.remove(names[0])
    with pytest.raises(ValueError, match="is empty"):
        store.remove("")


def test_a_folder_and_s3_hold_the_same_files(folder: Path, server: str, tmp_path: Path) -> None:
    local, remote = inerter.Store(tmp_path / "store"), inerter.Store("s3://lab/same")
    for store in (local, remote):
        store.add(folder / "1.mcap")
    client = boto3.client("s3", endpoint_url=server, region_name="us-east-1")
    objects = client.list_objects_v2(Bucket="lab", Prefix="same/")["Contents"]
    found = {
        entry["Key"].removeprefix("same/"): client.get_object(Bucket="lab", Key=entry["Key"])["Body"].read()
        for entry in objects
    }
    files = [path for path in (tmp_path / "store").rglob("*") if path.is_file()]
    assert found == {path.relative_to(tmp_path / "store").as_posix(): path.read_bytes() for path in files}
    # A byte that turned over there is found as well.
    key = next(entry["Key"] for entry in objects if entry["Key"].startswith("same/recordings"))
    bytes = bytearray(found[key.removeprefix("same/")])
    bytes[1000] ^= 1
    client.put_object(Bucket="lab", Key=key, Body=bytes)
    assert [(damage["file"], damage["problem"]) for damage in remote.verify()] == [(key.removeprefix("same/"), "changed")]
    with pytest.raises(inerter.InerterError, match="is not what was added"):
        remote.open(remote.runs()[0]["run"])


def test_a_recording_of_many_parts_goes_to_s3_whole(server: str, tmp_path: Path) -> None:
    told("simulate", "-o", tmp_path / "long.mcap", "--duration", 500)
    # S3 takes parts of 8 MiB.
    assert (tmp_path / "long.mcap").stat().st_size > (8 << 20)
    store = inerter.Store("s3://lab/long")
    name = store.add(tmp_path / "long.mcap")
    store.get(name, tmp_path / "back.mcap")
    assert (tmp_path / "back.mcap").read_bytes() == (tmp_path / "long.mcap").read_bytes()


class Busy(BaseHTTPRequestHandler):
    """A server that has no time for anybody."""

    def answer(self) -> None:
        self.send_response(503)
        self.send_header("Content-Length", "0")
        self.end_headers()

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = answer

    def log_message(self, *words: object) -> None:
        pass


def test_a_server_that_is_busy_or_not_there_is_told(server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    busy = HTTPServer(("127.0.0.1", 0), Busy)
    Thread(target=busy.serve_forever, daemon=True).start()
    for endpoint in (f"http://127.0.0.1:{busy.server_port}", "http://127.0.0.1:9"):
        monkeypatch.setenv("AWS_ENDPOINT", endpoint)
        with pytest.raises(inerter.InerterError, match="cannot be read") as caught:
            inerter.Store("s3://lab/store").runs()
        assert caught.value.code == "inerter::store::access" and "kept" in str(caught.value.help)
    busy.shutdown()


def test_a_bucket_that_is_not_there_or_not_ours_is_told(server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(inerter.InerterError) as caught:
        inerter.Store("s3://nobodys/store").add(GOLDEN / "nothing.mcap")
    assert str(caught.value.code).startswith("inerter::store")
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.setenv("AWS_ENDPOINT", "no address")
    with pytest.raises(inerter.InerterError):
        inerter.Store("s3://lab/store").runs()


def test_duckdb_pandas_and_polars_read_the_golden_store(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tables as docs/STORE.md has them, without this package."""
    expected = json.loads((GOLDEN / "expected.json").read_text())
    store = GOLDEN / "store"
    tables = {name: f"read_parquet('{store}/{name}/**/*.parquet', hive_partitioning = true)" for name in expected["rows"]}
    for name, rows in expected["rows"].items():
        assert duckdb.sql(f"select count(*) from {tables[name]}").fetchall() == [(rows,)], name
        assert len(pd.read_parquet(store / name)) == rows
        assert pl.scan_parquet(store / name, hive_partitioning=True).collect().height == rows
        columns = list(pd.read_parquet(store / name).columns)
        # A later version may add columns, and never takes one away.
        assert set(expected["columns"][name]) <= set(columns), name
    values = duckdb.sql(f"select device, inertance_kg from {tables['runs']} order by device").fetchall()
    assert [list(row) for row in values] == expected["inertance_kg"]
    joined = f"select count(*) from {tables['estimates']} join {tables['runs']} using (run) where law is not null"
    assert duckdb.sql(joined).fetchall() == [(expected["rows"]["estimates"],)]
    # The queries of the document, as they stand there.
    document = (Path(__file__).parents[3] / "docs/STORE.md").read_text()
    queries = [part.split("```")[0] for part in document.split("```sql\n")[1:]]
    assert len(queries) >= 5
    monkeypatch.chdir(store.parent)
    for query in queries:
        assert duckdb.sql(query.replace("STORE", "store")).fetchall(), query


def test_this_version_reads_the_golden_store() -> None:
    expected = json.loads((GOLDEN / "expected.json").read_text())
    store = inerter.Store(GOLDEN / "store")
    assert store.verify() == []
    assert [[row["device"], row["inertance_kg"]] for row in sorted(store.runs(), key=lambda row: row["device"])] == expected["inertance_kg"]
    for row in store.runs():
        assert store.open(row["run"]).duration_s == row["duration_s"]


def test_files_in_a_folder_are_sealed(folder: Path, tmp_path: Path) -> None:
    store = inerter.Store(tmp_path / "store")
    store.add(folder / "1.mcap")
    files = [path for path in (tmp_path / "store").rglob("*") if path.is_file()]
    assert all(not path.stat().st_mode & stat.S_IWUSR for path in files)
    shutil.rmtree(tmp_path / "store")
