"""A connected device."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from types import TracebackType

from . import _inerter
from ._results import Estimate
from ._runs import told


class Device:
    """A conversation with one device: its estimates as they come, and recordings.

    `inerter.connect()` makes it, and the end of `with` closes it. Iterating it waits for the next estimate, about ten per second, and
    ends when a simulated device has no more samples. The system buffers what comes meanwhile; if you do not read for long, some is lost.
    """

    def __init__(self, device: _inerter.Device) -> None:
        self._device = device

    @property
    def name(self) -> str:
        """Its port or address."""
        return self._device.name

    @property
    def identity(self) -> dict[str, str]:
        """Its `board`, `serial` number, `firmware` and `git` commit."""
        return self._device.identity

    @property
    def settings(self) -> dict[str, float]:
        """The settings in use, by name."""
        return self._device.settings

    def record(
        self,
        path: str | os.PathLike[str],
        *,
        duration_s: float | None = None,
        replace: bool = False,
        calibration: str | os.PathLike[str] | None = None,
    ) -> _inerter.Run:
        """Records everything that the device sends, and opens it: `inerter record`.

        Ends after `duration_s` [s], or when a simulated device has no more samples. At Ctrl-C, or if the device goes away for good, the
        file holds what came until then. `calibration` is a settings file whose table `[calibration]` says when and how the rig was
        calibrated: `date`, and `certificate` and `expires` if known. It is stored in the recording; if it has expired, that is a warning.

        Raises InerterError if the file exists and `replace` is not given, the settings file has no such table, or the device goes away,
        and KeyboardInterrupt on Ctrl-C.
        """
        if duration_s is not None and not duration_s > 0:
            raise ValueError(f"duration_s must be more than 0, not {duration_s}")
        until_s = float("inf") if duration_s is None else float(duration_s)
        self._device.record(os.fspath(path), until_s, replace, None if calibration is None else os.fspath(calibration))
        return told(_inerter.open(os.fspath(path), {}, None), 2)

    def close(self) -> None:
        """Ends the conversation; another program can then control the device."""
        self._device.close()

    def __iter__(self) -> Iterator[Estimate]:
        return self

    def __next__(self) -> Estimate:
        line = self._device.next_estimate()
        if line is None:
            raise StopIteration
        return Estimate(json.loads(line))

    def __enter__(self) -> Device:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        identity = self.identity
        return _inerter.printable(f"inerter.Device {identity.get('board', '')} {identity.get('serial', '')} at {self.name}")
