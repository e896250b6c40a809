"""Stores of runs, in a folder and in S3, and the engines that read their tables without this package.

GOLDEN is a store that the first version has written: every later one reads it.
"""

from __future__ import annotations

import gc
import http.client
import json
import os
import pickle
import runpy
import stat
import subprocess
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import boto3
import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
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


def test_a_row_stands_for_its_run(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    inerter.simulate(duration_s=2, path=recording)
    store = inerter.Store(tmp_path / "store")
    name = store.add(recording)
    (row,) = store.runs()
    assert store.run(row) == store.run(name) == store.run(name[:9]) == row
    store.get(row, tmp_path / "got.mcap")
    assert (tmp_path / "got.mcap").read_bytes() == recording.read_bytes()
    assert dict(inerter.replay(store.open(row))) == dict(inerter.replay(store.open(name)))
    for stray in (dict(row, date="1970-01-02"), dict(row, device=".."), dict(row, run="0" * 64)):
        with pytest.raises(inerter.InerterError) as refused:
            store.open(stray)
        assert refused.value.code == "inerter::store::no_run"


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
    with pytest.raises(inerter.InerterError, match="has no run"):
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
    with pytest.raises(inerter.InerterError, match="differs from what was added"):
        remote.get(remote.runs()[0]["run"], tmp_path / "back.mcap")


def test_a_recording_of_many_parts_goes_to_s3_whole(server: str, tmp_path: Path) -> None:
    told("simulate", "-o", tmp_path / "long.mcap", "--duration", 500)
    # S3 takes parts of 8 MiB.
    assert (tmp_path / "long.mcap").stat().st_size > (8 << 20)
    store = inerter.Store("s3://lab/long")
    name = store.add(tmp_path / "long.mcap")
    store.get(name, tmp_path / "back.mcap")
    assert (tmp_path / "back.mcap").read_bytes() == (tmp_path / "long.mcap").read_bytes()


class Busy(BaseHTTPRequestHandler):
    """A server that passes on what comes, and has no time for what `is_refused` names."""

    behind = ""
    is_refused: Callable[[str, str], bool]
    status = 503

    def answer(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if type(self).is_refused(self.command, self.path):
            self.send_response(type(self).status)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        asked = http.client.HTTPConnection(self.behind)
        asked.request(self.command, self.path, body, {name: value for name, value in self.headers.items()})
        reply = asked.getresponse()
        words = reply.read()
        self.send_response(reply.status)
        for name, value in reply.getheaders():
            if name.lower() not in ("transfer-encoding", "content-length", "connection"):
                self.send_header(name, value)
        self.send_header("Content-Length", reply.getheader("Content-Length", "0") if self.command == "HEAD" else str(len(words)))
        self.end_headers()
        self.wfile.write(words)

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = answer

    def log_message(self, *words: object) -> None:
        pass


@pytest.fixture
def busy(server: str) -> Iterator[type[Busy]]:
    """S3 behind a server that may be busy; its address is not the usual one."""
    Busy.behind = server.removeprefix("http://")
    Busy.is_refused = lambda method, path: False
    Busy.status = 503
    front = ThreadingHTTPServer(("127.0.0.1", 0), Busy)
    Thread(target=front.serve_forever, daemon=True).start()
    os.environ["AWS_ENDPOINT"] = f"http://127.0.0.1:{front.server_port}"
    yield Busy
    os.environ["AWS_ENDPOINT"] = server
    front.shutdown()


ORDER = ["recordings", "estimates", "reversals", "events", "rows", "sums", "runs"]
"""In which the files of a run are written."""
OF_PARTS = {"begin": ("POST", "uploads"), "part": ("PUT", "partNumber="), "complete": ("POST", "uploadId=")}
"""Requests that take a recording to S3 in parts, by method and words in their address."""


@pytest.mark.parametrize("refused", [*ORDER, *OF_PARTS])
def test_a_server_that_is_busy_meanwhile_leaves_no_half_run(
    folder: Path, server: str, busy: type[Busy], refused: str, tmp_path: Path
) -> None:
    path = folder / "1.mcap"
    if refused in OF_PARTS:
        path = tmp_path / "long.mcap"
        told("simulate", "-o", path, "--duration", 500)
    store = inerter.Store(f"s3://lab/{tmp_path.name}/b")
    wanted, part = OF_PARTS.get(refused, ("PUT", f"/{refused}/"))
    busy.is_refused = lambda method, at: method == wanted and part in at
    with pytest.raises(inerter.InerterError, match="cannot be written") as caught:
        store.add(path)
    assert caught.value.code == "inerter::store::access" and "kept" in str(caught.value.help)
    busy.is_refused = lambda method, at: False
    client = boto3.client("s3", endpoint_url=server, region_name="us-east-1")
    assert "Uploads" not in client.list_multipart_uploads(Bucket="lab"), "parts that nobody would remove"
    assert store.runs() == []
    there = ORDER[: ORDER.index(refused)] if refused in ORDER else []
    left = [(damage["file"].split("/")[0], damage["problem"]) for damage in store.verify()]
    assert sorted(left) == sorted((folder, "unfinished") for folder in there)
    name = store.add(path)
    assert store.verify() == [] and [row["run"] for row in store.runs()] == [name]


@pytest.mark.parametrize(
    ("method", "part", "action"),
    [("HEAD", "", "read"), ("GET", ".json", "read"), ("GET", "list-type", "listed"), ("POST", "?delete", "removed")],
)
def test_a_server_that_is_busy_meanwhile_changes_nothing(
    folder: Path, busy: type[Busy], method: str, part: str, action: str, tmp_path: Path
) -> None:
    store = inerter.Store(f"s3://lab/{tmp_path.name}/c")
    name = store.add(folder / "1.mcap")
    works = {"read": lambda: store.add(folder / "2.mcap"), "listed": store.runs, "removed": lambda: store.remove(name)}
    busy.is_refused = lambda asked, at: asked == method and part in at
    with pytest.raises(inerter.InerterError, match=f"cannot be {action}") as caught:
        works[action]()
    assert caught.value.code == "inerter::store::access" and "kept" in str(caught.value.help)
    busy.is_refused = lambda asked, at: False
    assert store.verify() == [] and [row["run"] for row in store.runs()] == [name]
    works[action]()


@pytest.mark.parametrize("refused", ["/inerter-store.json", "/events/"])
def test_a_bucket_that_may_not_be_written_is_told(
    folder: Path, server: str, busy: type[Busy], refused: str, tmp_path: Path
) -> None:
    url = f"s3://lab/{tmp_path.name}/d"
    busy.status = 403
    busy.is_refused = lambda method, at: method == "PUT" and refused in at
    with pytest.raises(inerter.InerterError, match="cannot be written") as caught:
        inerter.Store(url).add(folder / "1.mcap")
    assert caught.value.code == "inerter::store::access"
    assert str(caught.value.help).startswith("ask for permission to this folder or bucket")
    command = [PROGRAM, "store", "add", url, str(folder / "1.mcap")]
    by_program = subprocess.run(command, capture_output=True, text=True)
    assert by_program.returncode == 8 and "cannot be written" in by_program.stderr, by_program.stderr
    assert "help: ask for permission to this folder or bucket" in by_program.stderr
    busy.is_refused = lambda method, at: False
    client = boto3.client("s3", endpoint_url=server, region_name="us-east-1")
    prefix = f"{tmp_path.name}/d/"
    keys = [entry["Key"] for entry in client.list_objects_v2(Bucket="lab", Prefix=prefix).get("Contents", [])]
    there = ["inerter-store.json", *ORDER[: ORDER.index("events")]] if refused == "/events/" else []
    assert sorted(key.removeprefix(prefix).split("/")[0] for key in keys) == sorted(there)
    store = inerter.Store(url)
    name = store.add(folder / "1.mcap")
    assert store.verify() == [] and [row["run"] for row in store.runs()] == [name]


def test_a_server_that_is_busy_or_not_there_is_told(busy: type[Busy], monkeypatch: pytest.MonkeyPatch) -> None:
    busy.is_refused = lambda method, path: True
    for endpoint in (None, "http://127.0.0.1:9"):
        if endpoint is not None:
            monkeypatch.setenv("AWS_ENDPOINT", endpoint)
        with pytest.raises(inerter.InerterError, match="cannot be read") as caught:
            inerter.Store("s3://lab/store").runs()
        assert caught.value.code == "inerter::store::access" and "kept" in str(caught.value.help)


@pytest.mark.parametrize("status", [401, 403])
def test_a_server_that_lets_us_not_in_is_told(server: str, monkeypatch: pytest.MonkeyPatch, status: int) -> None:
    class Closed(Busy):
        def answer(self) -> None:
            self.send_response(status)
            self.send_header("Content-Length", "0")
            self.end_headers()

        do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = answer

    closed = ThreadingHTTPServer(("127.0.0.1", 0), Closed)
    Thread(target=closed.serve_forever, daemon=True).start()
    monkeypatch.setenv("AWS_ENDPOINT", f"http://127.0.0.1:{closed.server_port}")
    with pytest.raises(inerter.InerterError) as caught:
        inerter.Store("s3://lab/store").runs()
    assert caught.value.code == "inerter::store::access" and "AWS_ACCESS_KEY_ID" in str(caught.value.help)
    closed.shutdown()


def test_addresses_that_lead_nowhere_are_told(folder: Path, server: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(inerter.InerterError, match="cannot be") as caught:
        inerter.Store("s3://nobodys/store").add(folder / "1.mcap")
    assert caught.value.code == "inerter::store::access"
    for url in ("s3:///store", "s3://lab/Prüfstand", "s3://lab/a//b", "ftp://lab/store", ""):
        with pytest.raises(inerter.InerterError, match="cannot be used as a store") as caught:
            inerter.Store(url).runs()
        assert caught.value.code == "inerter::store::address"
    monkeypatch.setenv("AWS_ENDPOINT", "no address")
    with pytest.raises(inerter.InerterError, match="AWS_ENDPOINT is not an address"):
        inerter.Store("s3://lab/store").runs()


def queries_over(store: Path, engine: duckdb.DuckDBPyConnection) -> list[str]:
    """Defines the views of docs/STORE.md, and gives its queries, as they stand there."""
    document = (Path(__file__).parents[3] / "docs/STORE.md").read_text()
    queries = [part.split("```")[0].replace("STORE/", f"{store}/") for part in document.split("```sql\n")[1:]]
    for view in queries.pop(0).split(";"):
        engine.execute(view)
    return queries


def columns_of(store: Path) -> dict[str, dict[str, str]]:
    """The columns of each table with their types."""
    with duckdb.connect() as engine:
        queries_over(store, engine)
        tables = {name: engine.sql(f"from {name}") for name in ("runs", "estimates", "reversals", "events")}
        return {name: dict(zip(table.columns, map(str, table.types))) for name, table in tables.items()}


def test_duckdb_pandas_and_polars_read_the_golden_store() -> None:
    """The tables as docs/STORE.md has them, without this package: two linear machines and a rotary one."""
    expected = json.loads((GOLDEN / "expected.json").read_text())
    store = GOLDEN / "store"
    with duckdb.connect() as engine:
        queries = queries_over(store, engine)
        assert len(queries) >= 5
        for query in queries:
            assert engine.sql(query).fetchall(), query
        for name, rows in expected["rows"].items():
            assert engine.sql(f"select count(*) from {name}").fetchall() == [(rows,)], name
            # A later version may add columns, and never takes one away.
            assert set(expected["columns"][name]) <= set(engine.sql(f"from {name}").columns), name
        values = engine.sql("select device, inertance_kg from runs order by device").fetchall()
        assert [list(row) for row in values] == expected["inertance_kg"]
        joined = "select count(*) from estimates join runs using (run) where law is not null"
        assert engine.sql(joined).fetchall() == [(expected["rows"]["estimates"],)]
        assert engine.sql("select sum(inertia_kg_m2) from runs").fetchall()[0][0] > 0.0
        (scatter,) = (engine.sql(query).fetchall() for query in queries if "scatter_m" in query)
    # The same in pandas, whose columns are those of the first file, a linear machine's.
    runs = pd.read_parquet(store / "runs").sort_values("device").astype({"device": str}).replace({np.nan: None})
    assert runs[["device", "inertance_kg"]].values.tolist() == expected["inertance_kg"]
    groups = pd.read_parquet(store / "reversals").groupby(["run", "route"])
    scattered = groups.agg(reversals=("t_s", "size"), scatter_m=("value_m", "std")).reset_index().replace({np.nan: None})
    for ours, theirs in zip(scattered.values.tolist(), scatter, strict=True):
        assert ours[:3] == list(theirs[:3]) and ours[3] == (theirs[3] and pytest.approx(theirs[3], rel=1e-9))
    for name, rows in expected["rows"].items():
        assert len(pd.read_parquet(store / name)) == rows
        scanned = pl.scan_parquet(store / name, hive_partitioning=True, extra_columns="ignore", missing_columns="insert")
        assert scanned.collect().height == rows


def test_a_new_store_has_all_columns_of_the_golden_one(tmp_path: Path) -> None:
    expected = json.loads((GOLDEN / "expected.json").read_text())
    store = inerter.Store(tmp_path / "store")
    for machine in (0.0, 1.0):
        recording = tmp_path / f"{machine}.mcap"
        inerter.simulate(duration_s=6, settings={"machine": machine}, path=recording)
        store.add(recording)
    written, golden = columns_of(tmp_path / "store"), columns_of(GOLDEN / "store")
    for name, columns in expected["columns"].items():
        wanted = {column: golden[name][column] for column in columns}
        assert {column: kind for column, kind in written[name].items() if column in wanted} == wanted, name


def test_this_version_reads_the_golden_store() -> None:
    expected = json.loads((GOLDEN / "expected.json").read_text())
    store = inerter.Store(GOLDEN / "store")
    assert store.verify() == []
    rows = sorted(store.runs(), key=lambda row: row["device"])
    assert [[row["device"], row.get("inertance_kg")] for row in rows] == expected["inertance_kg"]
    for row in store.runs():
        assert store.open(row["run"]).duration_s == row["duration_s"]


def test_files_in_a_folder_are_sealed(folder: Path, tmp_path: Path) -> None:
    store = inerter.Store(tmp_path / "store")
    store.add(folder / "1.mcap")
    files = [path for path in (tmp_path / "store").rglob("*") if path.is_file()]
    assert all(not path.stat().st_mode & stat.S_IWUSR for path in files)
    # A damaged row is a warning, and the run can be removed all the same.
    row = next((tmp_path / "store/rows").rglob("*.json"))
    row.chmod(0o600)
    row.write_text("[]")
    with pytest.warns(UserWarning, match="is changed"):
        assert store.runs() == []
    assert {damage["problem"] for damage in store.verify()} == {"changed"}
    assert store.verify(repair=True) == [] and len(store) == 1
    name = store.runs()[0]["run"]
    store.remove(name, name[:10])
    assert store.runs() == []
    for day in ("yesterday", "2026-99-99"):
        with pytest.raises(inerter.InerterError, match="is not a day|is no condition"):
            store.runs(start=day)


def test_a_run_from_s3_outlives_its_store(folder: Path, server: str) -> None:
    store = inerter.Store("s3://lab/outlives")
    run = store.open(store.add(folder / "1.mcap"))
    del store
    gc.collect()
    assert inerter.replay(run)["final"]


def test_a_recording_that_grows_is_refused(server: str, tmp_path: Path) -> None:
    """Beyond the part that goes to S3 at once, while the estimator is at it."""
    told("simulate", "-o", tmp_path / "run.mcap", "--duration", 420)
    size = (tmp_path / "run.mcap").stat().st_size
    assert (7 << 20) < size < (8 << 20)
    store = inerter.Store("s3://lab/grows")

    def grow(part: float) -> None:
        # At first the recording may not have been named by its bytes yet.
        if part > 0 and (tmp_path / "run.mcap").stat().st_size == size:
            with (tmp_path / "run.mcap").open("ab") as file:
                file.write(bytes(2 << 20))

    with pytest.raises(inerter.InerterError, match="changed while it was added"):
        store.add(tmp_path / "run.mcap", progress=grow)
    assert store.runs() == []


def lines(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def test_the_program_does_in_s3_what_the_package_does(folder: Path, server: str, tmp_path: Path) -> None:
    url = f"s3://lab/{tmp_path.name}/program"
    files = [folder / "1.mcap", folder / "2.mcap"]
    names = [added["run"] for added in lines(told("store", "add", url, *files, "--json"))]
    store = inerter.Store(url)
    assert sorted(row["run"] for row in store.runs()) == sorted(names)
    limits = tmp_path / "limits.toml"
    limits.write_text("[inertance_kg]\nmin = 290\nmax = 310\n")
    listed = lines(told("store", "ls", url, "--limits", limits, "--json"))
    assert [row.pop("limits")["verdict"] for row in listed] == ["pass", "pass"]
    assert listed == store.runs()
    assert lines(told("store", "query", url, "device = SIM-2", "--json")) == [store.run(names[1])]
    told("store", "get", url, names[0][:12], "-o", tmp_path / "back.mcap")
    assert (tmp_path / "back.mcap").read_bytes() == files[0].read_bytes()
    verified = {"kind": "verified", "store": url, "runs": 2, "damages": 0}
    assert lines(told("store", "verify", url, "--json")) == [verified]
    shard = ["replay", "--store", url, "--batch", "parts", "--json", "--shard"]
    kept = [row for part in ("1/2", "2/2") for row in lines(told(*shard, part))]
    assert sorted(row["run"] for row in kept) == sorted(names)
    for row in store.results("parts"):
        file = files[names.index(row["run"])]
        assert row["result"] == lines(told("replay", file, "--json"))[-1] and row["error"] is None
    told("store", "remove", url, names[0], "--yes")
    assert [row["run"] for row in store.runs()] == names[1:]
    nothing = subprocess.run([PROGRAM, "store", "ls", "s3://lab/nothing"], capture_output=True, text=True)
    assert nothing.returncode == 3 and "there is no store at s3://lab/nothing" in nothing.stderr


def test_requests_to_s3_are_as_many_as_the_page_on_scale_counts(folder: Path, busy: type[Busy], tmp_path: Path) -> None:
    """Writes and reads for a run; a process reads the mark of the store twice, and lists cost little."""
    requests = runpy.run_path(str(Path(__file__).parents[3] / "tests/python/scale.py"))["REQUESTS"]
    seen: list[str] = []

    def hear(method: str, at: str) -> bool:
        seen.append("LIST" if "list-type" in at else method)
        return False

    def counted(work: Callable[[], object]) -> tuple[int, int]:
        seen.clear()
        work()
        assert set(seen) <= {"PUT", "GET", "HEAD", "LIST"}
        return seen.count("PUT"), seen.count("GET") + seen.count("HEAD")

    busy.is_refused = hear
    url = f"s3://lab/{tmp_path.name}/requests"
    inerter.Store(url).add(folder / "1.mcap")
    assert counted(lambda: inerter.Store(url).add(folder / "2.mcap")) == requests["added"]
    # Nothing that is there is written again.
    assert counted(lambda: inerter.Store(url).add(folder / "2.mcap"))[0] == 0
    opened = 2

    def of_two(work: Callable[[], object]) -> tuple[float, float]:
        writes, reads = counted(work)
        return writes / 2, (reads - opened) / 2

    assert of_two(lambda: told("replay", "--store", url)) == requests["by the program"]
    assert of_two(lambda: inerter.batch.replay(inerter.Store(url), batch="workers")) == requests["by a worker"]
    assert of_two(lambda: inerter.Store(url).runs()) == requests["looked at"]


def test_the_page_has_the_columns_of_a_new_store_and_no_others(folder: Path, tmp_path: Path) -> None:
    inerter.Store(tmp_path / "store").add(folder / "1.mcap")
    document = (Path(__file__).parents[3] / "docs/STORE.md").read_text()
    for table in ("runs", "estimates", "reversals", "events"):
        listed = []
        for line in document.split(f"### `{table}`\n")[1].split("\n#")[0].splitlines():
            if line.startswith("| `"):
                names, kind = line.split(" | ")[:2]
                listed += [(name.strip("`"), kind) for name in names.removeprefix("| ").split(", ")]
        schema = pq.read_schema(next((tmp_path / "store" / table).rglob("*.parquet")))
        assert sorted(listed) == sorted((field.name, str(field.type)) for field in schema), table
