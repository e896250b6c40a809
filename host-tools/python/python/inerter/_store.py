"""Stores of runs: a folder, or a place in S3."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from . import _inerter
from ._inerter import Run


class Store:
    """A store of runs in a folder or in S3-compatible storage: `inerter store`.

        store = inerter.Store("runs")
        store.add("run.mcap")
        pandas.DataFrame(store.runs())

    `url` is a folder, or `s3://BUCKET/FOLDER` with the credentials of the usual variables: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY,
    AWS_REGION, AWS_ENDPOINT. The first `add` makes the store; before that all else raises InerterError. A run is named by the SHA-256 of
    its recording, and everywhere the beginning of a name is enough. pandas, Polars and DuckDB read the tables of a store without
    this package: docs/STORE.md.
    """

    def __init__(self, url: str | os.PathLike[str]) -> None:
        self._store = _inerter.Store(os.fspath(url))
        self._fetched: tempfile.TemporaryDirectory[str] | None = None

    @property
    def url(self) -> str:
        """Where it is."""
        return self._store.url

    def __repr__(self) -> str:
        return f"inerter.Store({self.url!r})"

    def __reduce__(self) -> tuple[type[Store], tuple[str]]:
        return Store, (self.url,)

    def __len__(self) -> int:
        return len(self.runs())

    def add(self, path: str | os.PathLike[str], *, progress: Callable[[float], object] | None = None) -> str:
        """Adds a recording (.mcap), and gives the name of its run; the same recording twice is one run.

        It goes through the estimator, and what comes out becomes the tables of the store. `progress` is called with the part that is
        done, from 0 to 1.

        Raises InerterError where it is no recording, cannot be used, or the store cannot be written, and KeyboardInterrupt on Ctrl-C;
        then there is no such run.
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

        Those of `device` alone, by its serial number; those recorded from the day `start` to the day `end` (UTC, `2026-01-31`, or a month
        `2026-01`); and those that meet every condition of `where`: a column, one of < <= > >= = !=, and a number or a word, such
        as "inertance_kg < 300". Names end in their unit; what is not known is None.

        Raises InerterError where a condition cannot be read or there is no store.
        """
        return [json.loads(row) for row in self._store.rows(device, start, end, list(where))]

    def run(self, name: str) -> dict[str, Any]:
        """The columns of one run. Raises InerterError where there is none, or several begin like this."""
        row: dict[str, Any] = json.loads(self._store.row(name))
        return row

    def open(self, name: str) -> Run:
        """Opens the recording of a run, as `inerter.open` does. From S3 it is fetched first, and checked against its name."""
        path = self._store.path(name)
        if path is None:
            if self._fetched is None:
                self._fetched = tempfile.TemporaryDirectory(prefix="inerter-")
            path = os.path.join(self._fetched.name, f"{self.run(name)['run']}.mcap")
            if not Path(path).exists():
                self._store.get(name, path, False)
        return _inerter.open(path, {})

    def get(self, name: str, path: str | os.PathLike[str], *, replace: bool = False) -> None:
        """Writes the recording of a run into a file. Raises InerterError where it is damaged, or the file is there and not to be replaced."""
        self._store.get(name, os.fspath(path), replace)

    def verify(self, *, progress: Callable[[float], object] | None = None) -> list[dict[str, str]]:
        """Reads every file, and lists what is not as it was written: `run`, `file` and `problem`, which is `missing`, `changed` or `unfinished`."""
        return [dict(zip(("run", "file", "problem"), damage, strict=True)) for damage in self._store.verify(progress)]

    def remove(self, *names: str) -> None:
        """Removes runs with their recordings. Raises InerterError, before anything is removed, where there is no such run."""
        for whole in [self.run(name)["run"] for name in _checked(names)]:
            self._store.remove(whole)


def _checked(names: Sequence[str]) -> Sequence[str]:
    if not all(names):
        raise ValueError("the name of a run is empty")
    return names
