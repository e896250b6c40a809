"""Stores of runs: a folder, or a place in S3."""

from __future__ import annotations

import json
import os
import tempfile
import warnings
from collections.abc import Callable, Mapping
from typing import Any

from . import _inerter
from ._inerter import Run
from ._runs import told


def key(run: str | Mapping[str, Any]) -> str:
    """What the store finds a run by: a name or its beginning, or for a row of `Store.runs` its place, which is found directly."""
    return run if isinstance(run, str) else f"device={run['device']}/date={run['date']}/{run['run']}"


class Store:
    """A store of runs in a folder or in S3-compatible storage: `inerter store`.

        store = inerter.Store("runs")
        store.add("run.mcap")
        pandas.DataFrame(store.runs())

    `url` is a folder, or `s3://BUCKET/FOLDER` with the credentials of the usual variables: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY,
    AWS_REGION, AWS_ENDPOINT. The first `add` creates the store; before that everything else raises InerterError. A run is named by the
    SHA-256 of its recording, and the beginning of a name is always enough; a row of `runs` finds it faster in a large store. pandas,
    Polars and DuckDB read the tables of a store without this package: docs/STORE.md.
    """

    def __init__(self, url: str | os.PathLike[str]) -> None:
        self._store = _inerter.Store(os.fspath(url))

    @property
    def url(self) -> str:
        """Where it is."""
        return self._store.url

    def __repr__(self) -> str:
        return _inerter.printable(f"inerter.Store({self.url!r})")

    def __reduce__(self) -> tuple[type[Store], tuple[str]]:
        return Store, (self.url,)

    def __len__(self) -> int:
        return len(self.runs())

    def add(self, path: str | os.PathLike[str], *, progress: Callable[[float], object] | None = None) -> str:
        """Adds a recording (.mcap), and returns the name of its run; the same recording twice is one run.

        It goes through the estimator, and the results become the tables of the store. `progress` is called with the part that is
        done, from 0 to 1.

        Raises InerterError if it is not a recording, cannot be used, or the store cannot be written, and KeyboardInterrupt on Ctrl-C.
        """
        return self._store.add(os.fspath(path), progress)[0]

    def runs(
        self,
        *where: str,
        device: str | None = None,
        start: str | None = None,
        end: str | None = None,
    ) -> list[dict[str, Any]]:
        """The runs, each with the columns of the table `runs` by name: `pandas.DataFrame(store.runs())`.

        Only those of `device`, by its serial number; those recorded from the day `start` to the day `end` (UTC, `2026-01-31`, or a month
        `2026-01`); and those that meet every condition of `where`: a column, one of < <= > >= = !=, and a number or a word, such
        as "inertance_kg < 300". Names end in their unit; what is not known is None. A damaged run is a warning.

        Raises InerterError if a condition or a day cannot be read or there is no store.
        """
        rows, damages = self._store.rows(device, start, end, list(where))
        for _, file, problem in damages:
            words = f"{file} in the store {self.url} is {problem}: see verify()"
            warnings.warn(_inerter.printable(words), stacklevel=2)
        return [json.loads(row) for row in rows]

    def run(self, run: str | Mapping[str, Any]) -> dict[str, Any]:
        """The columns of one run. Raises InerterError if there is none, or several begin with this name."""
        row: dict[str, Any] = json.loads(self._store.row(key(run)))
        return row

    def open(self, run: str | Mapping[str, Any], *, settings: Mapping[str, float] | None = None) -> Run:
        """Opens the recording of a run, by its name or its row of `runs`, as `inerter.open` does. From S3 it is fetched first,
        checked against its name, and kept until this process ends.

        Raises InerterError if there is no such run, several begin with this name, its recording is damaged, the store cannot be read, or
        a setting is invalid.
        """
        path = self._store.path(key(run))
        if path is None:
            path = os.path.join(_fetched(), f"{self._store.find(key(run))}.mcap")
            if not os.path.exists(path):
                # Another thread may fetch it as well.
                with tempfile.TemporaryDirectory(dir=_fetched()) as folder:
                    part = os.path.join(folder, "run.mcap")
                    self._store.get(key(run), part, False)
                    os.replace(part, path)
        return told(_inerter.open(path, dict(settings or {}), None), 2)

    def results(self, batch: str) -> list[dict[str, Any]]:
        """The result of each run in a batch (`inerter.batch`, `inerter replay --store`): `run`, `kind`, `software`, `given` (the settings
        over those of the recording), `result` (what the command prints with --json; None if it failed), `code` and `error` (None
        if it did not). For a batch that does not exist the list is empty.

        Raises InerterError if there is no store, it cannot be read, or `batch` cannot be a name.
        """
        return [json.loads(row) for row in self._store.results(batch)]

    def get(self, run: str | Mapping[str, Any], path: str | os.PathLike[str], *, replace: bool = False) -> None:
        """Writes the recording of a run into a file.

        Raises InerterError if there is no such run, it is damaged, or the file exists and may not be replaced.
        """
        self._store.get(key(run), os.fspath(path), replace)

    def verify(
        self, *, repair: bool = False, progress: Callable[[float], object] | None = None
    ) -> list[dict[str, str]]:
        """Reads every file, and lists what is not as it was written: `run`, `file` and `problem`, which is `missing`, `changed`,
        `unreadable`, `oversized` (a row of more than 256 KB or 512 columns), `unfinished` or `foreign`. With `repair`, what follows from
        intact recordings is rebuilt first; nobody may add or remove runs meanwhile. `progress` is called with the part that is done,
        from 0 to 1; with `repair` it starts over for each step.

        Raises InerterError if there is no store, or it cannot be read or, with `repair`, written, and KeyboardInterrupt on Ctrl-C.
        """
        damages = self._store.verify(repair, progress)
        return [dict(zip(("run", "file", "problem"), damage, strict=True)) for damage in damages]

    def remove(self, *names: str) -> None:
        """Removes runs with their recordings and results. Raises InerterError, before anything is removed, if there is no such run."""
        for whole in sorted({self._store.find(name) for name in names}):
            self._store.remove(whole)


_folder: tempfile.TemporaryDirectory[str] | None = None


def _fetched() -> str:
    """Folder of what was fetched, for as long as this process lasts: runs read their recording when they are asked."""
    global _folder
    if _folder is None:
        _folder = tempfile.TemporaryDirectory(prefix="inerter-")
    return _folder.name
