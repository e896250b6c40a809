"""The runs of a store, many at once: by one process after another here, or by the workers of a Dask cluster.

    from dask.distributed import Client

    store = inerter.Store("runs")
    with Client() as client:
        inerter.batch.replay(store, client, batch="stiffer", settings={"stiffness_n_per_m": 5e6})

The result of each run goes back into the store, in the batch of that name: `store.results("stiffer")`. Runs that a batch already has
are not repeated, so an interrupted batch continues where it was; if a worker dies, another one takes over its current run.
A run that cannot be used is a row with its error; one that is removed meanwhile is left out. `dask` and `distributed` are optional:
docs/PYTHON.md says how to install them.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from . import _inerter
from ._inerter import InerterError
from ._store import key as _key

if TYPE_CHECKING:
    from ._store import Store

__all__ = ["diagnose", "identify", "replay"]

Progress = Callable[[float], object]
"""Called with the part of the runs that is done, from 0 to 1."""

_REMOVED = "inerter::store::no_run"
"""Code of the error for a run that was removed meanwhile."""


def replay(
    store: Store,
    client: Any = None,
    *,
    batch: str = "replay",
    settings: Mapping[str, float] | None = None,
    where: str | Iterable[str] = (),
    device: str | None = None,
    start: str | None = None,
    end: str | None = None,
    again: bool = False,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Takes the runs of a store through the estimator: `inerter replay` of each.

    `client` is a Dask `Client`, whose workers must have this package and reach the store; without one the work is done here. `batch` is the
    name of the results: letters, digits, `-` and `_`. `settings` override those of each recording. `where` (a condition or several),
    `device`, `start` and `end` choose runs as `store.runs` does. `again` repeats what the batch already has. Returns the rows of the
    batch, as `store.results` does.

    Raises InerterError if the store or a setting cannot be used or the batch was made in another way, and RuntimeError if a worker does
    not have this version of the package.
    """
    return _batch(store, client, "replay", batch, settings, (where, device, start, end), again, progress)


def diagnose(
    store: Store,
    client: Any = None,
    *,
    batch: str = "diagnose",
    settings: Mapping[str, float] | None = None,
    where: str | Iterable[str] = (),
    device: str | None = None,
    start: str | None = None,
    end: str | None = None,
    again: bool = False,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Identifies what breaks the law in each run of a store: `inerter diagnose`. The rest as for `replay`."""
    return _batch(store, client, "diagnose", batch, settings, (where, device, start, end), again, progress)


def identify(
    store: Store,
    client: Any = None,
    *,
    batch: str = "identify",
    settings: Mapping[str, float] | None = None,
    where: str | Iterable[str] = (),
    device: str | None = None,
    start: str | None = None,
    end: str | None = None,
    again: bool = False,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Identifies the complete model of the device from each run of a store separately: `inerter identify`. The rest as for `replay`."""
    return _batch(store, client, "identify", batch, settings, (where, device, start, end), again, progress)


def _batch(
    store: Store,
    client: Any,
    kind: str,
    batch: str,
    settings: Mapping[str, float] | None,
    choice: tuple[str | Iterable[str], str | None, str | None, str | None],
    again: bool,
    progress: Progress | None,
) -> list[dict[str, Any]]:
    where, device, start, end = choice
    where = (where,) if isinstance(where, str) else where
    given = dict(settings or {})
    kept = set() if again else set(store._store.kept(batch, kind, given))
    # By their keys they are found without a look at all others.
    keys = {row["run"]: _key(row) for row in store.runs(*where, device=device, start=start, end=end)}
    todo = [key for name, key in keys.items() if name not in kept]
    # A worker may stand in another folder.
    url = store.url if "://" in store.url else os.path.abspath(store.url)
    work = partial(_work, url=url, kind=kind, batch=batch, given=given)
    done = ((work(key), None) for key in todo) if client is None else _spread(client, work, todo)
    for number, (key, error) in enumerate(done, 1):
        if error is not None:
            _keep(store, batch, key, kind, given, None, ("inerter::batch::worker_died", error))
        if progress is not None:
            progress(number / len(todo))
    return [row for row in store.results(batch) if row["run"] in keys]


def _spread(client: Any, work: Callable[[str], str], keys: list[str]) -> Iterator[tuple[str, str | None]]:
    """The work on a cluster: the keys in the order in which they are done, and why one is not."""
    _check(client)
    import distributed

    as_completed: Any = distributed.as_completed
    # What a worker had not done when it died is done by another one.
    futures = dict(zip(client.map(work, keys, pure=False), keys, strict=True))
    try:
        for future in as_completed(list(futures)):
            failure = future.exception()
            # What is done is in the store: a worker that dies later takes nothing of it along.
            key = futures.pop(future)
            future.release()
            # One that ends each worker that takes it is a run that fails.
            if failure is not None and not isinstance(failure, distributed.KilledWorker):
                raise failure
            yield key, None if failure is None else str(failure)
    finally:
        # Nobody waits for the rest, where there is one.
        client.cancel(list(futures))


def _work(key: str, *, url: str, kind: str, batch: str, given: dict[str, float]) -> str:
    """Does one run, and keeps what comes of it; gives its key."""
    import inerter

    store = inerter.Store(url)
    call: Callable[[inerter.Run], Mapping[str, Any]] = getattr(inerter, kind)
    result: str | None = None
    error = ("", "")
    # A worker does many runs: what it fetches for one is removed after it.
    with tempfile.TemporaryDirectory(prefix="inerter-") as folder:
        try:
            path = store._store.path(key)
            if path is None:
                path = os.path.join(folder, "run.mcap")
                store._store.get(key, path, False)
        except InerterError as raised:
            if raised.code == _REMOVED:
                return key
            # What hangs on the store or on this computer is nobody's result.
            if raised.code != "inerter::store::damaged":
                raise
            error = (str(raised.code), str(raised))
        else:
            try:
                result = json.dumps(dict(call(_inerter.open(path, given, None))))
            except InerterError as raised:
                error = (str(raised.code), str(raised))
        _keep(store, batch, key, kind, given, result, error)
    return key


def _keep(
    store: Store,
    batch: str,
    key: str,
    kind: str,
    given: dict[str, float],
    result: str | None,
    error: tuple[str, str],
) -> None:
    """Keeps what came of a run, unless it was removed meanwhile."""
    try:
        store._store.keep(batch, key, kind, given, result, error)
    except InerterError as raised:
        if raised.code != _REMOVED:
            raise


def _check(client: Any) -> None:
    """Says so at once where a worker could do nothing."""
    help = "install the same wheel on every worker: `pip install inerter-*.whl`"
    # By built-in functions, as nothing of ours may be there; one that dies meanwhile is no matter.
    found = client.run(eval, "__import__('inerter').__version__", on_error="return").values()
    for version in found:
        if isinstance(version, ImportError):
            words = f"a worker of the cluster has no package inerter ({version}): {help}"
            raise RuntimeError(_inerter.printable(words)) from version
        if isinstance(version, str) and version != _inerter.__version__:
            words = f"a worker has inerter {version}, here it is {_inerter.__version__}: {help}"
            raise RuntimeError(_inerter.printable(words))
