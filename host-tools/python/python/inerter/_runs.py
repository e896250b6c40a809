"""Runs on their way to a user."""

from __future__ import annotations

import warnings
from collections.abc import Container

from ._inerter import Run, printable


def told(run: Run, stacklevel: int, known: Container[str] = ()) -> Run:
    """The run, after a warning for each of its notes that is not `known`. `stacklevel` as if the caller gave the warning itself."""
    for note in run.notes:
        if note not in known:
            warnings.warn(printable(note), stacklevel=stacklevel + 1)
    return run
