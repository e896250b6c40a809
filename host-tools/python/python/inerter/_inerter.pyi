from collections.abc import Callable, Mapping
from typing import Any, final

__all__ = [
    "Device",
    "InerterError",
    "Run",
    "Store",
    "Sums",
    "Table",
    "__version__",
    "compare",
    "connect",
    "diagnose",
    "from_columns",
    "identify",
    "interval_text",
    "merge",
    "open",
    "plan",
    "plot",
    "printable",
    "replay",
    "report",
    "simulate",
    "with_settings",
]

__version__: str

class InerterError(Exception):
    """Raised when something cannot be done."""

    code: str | None
    """Its name, as the command line has it, such as `inerter::csv::column`."""
    help: str | None
    """What to do next."""

@final
class Device:
    """A conversation with one device."""

    @property
    def name(self) -> str: ...
    @property
    def identity(self) -> dict[str, str]: ...
    @property
    def settings(self) -> dict[str, float]: ...
    def next_estimate(self) -> str | None: ...
    def record(self, path: str, duration_s: float, replace: bool, calibration: str | None) -> None: ...
    def close(self) -> None: ...

@final
class Store:
    """A store, which is opened on first use."""

    def __new__(cls, url: str) -> Store: ...
    @property
    def url(self) -> str: ...
    def add(self, path: str, told: Callable[[float], object] | None) -> tuple[str, bool]: ...
    def rows(
        self, device: str | None, from_: str | None, to: str | None, conditions: list[str], /
    ) -> tuple[list[str], list[tuple[str, str, str]]]: ...
    def row(self, run: str) -> str: ...
    def find(self, run: str) -> str: ...
    def path(self, run: str) -> str | None: ...
    def get(self, run: str, path: str, replace: bool) -> None: ...
    def verify(self, repair: bool, told: Callable[[float], object] | None) -> list[tuple[str, str, str]]: ...
    def keep(
        self,
        batch: str,
        run: str,
        kind: str,
        given: Mapping[str, float],
        result: str | None,
        error: tuple[str, str],
    ) -> None: ...
    def kept(self, batch: str, kind: str, given: Mapping[str, float]) -> list[str]: ...
    def results(self, batch: str) -> list[str]: ...
    def remove(self, run: str) -> None: ...

@final
class Sums:
    """Exact sums of one run or of several, which `merge` fits. They can be pickled."""

    @classmethod
    def from_bytes(cls, bytes: bytes) -> Sums:
        """What `to_bytes` gave. Raises InerterError if it is something else."""
    def to_bytes(self) -> bytes:
        """For a file or another worker: the same for any order and grouping."""
    @property
    def names(self) -> list[str]:
        """Names of the runs, in alphabetical order."""
    def __add__(self, value: Sums, /) -> Sums:
        """Both together, without a fit. Raises InerterError if their settings differ."""
    def __radd__(self, value: Sums, /) -> Sums: ...
    def __len__(self) -> int: ...
    def __eq__(self, other: object, /) -> bool: ...

@final
class Table:
    """A table of a run with the Arrow PyCapsule interface, read on demand."""

    @property
    def column_names(self) -> list[str]: ...
    @property
    def units(self) -> dict[str, str]: ...
    def __len__(self) -> int: ...
    def __getitem__(self, name: str, /) -> list[Any]:
        """The values of a column, for use without these libraries. Raises KeyError for an unknown one."""
    def __arrow_c_stream__(self, requested_schema: object | None = None) -> Any: ...

@final
class Run:
    """A run: settings and samples, with what is known of the device."""

    @property
    def name(self) -> str: ...
    @property
    def machine(self) -> str: ...
    @property
    def settings(self) -> dict[str, float]: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def device(self) -> dict[str, str]: ...
    @property
    def calibration(self) -> dict[str, str]: ...
    @property
    def truth(self) -> dict[str, str]: ...
    @property
    def duration_s(self) -> float: ...
    @property
    def samples(self) -> Table: ...
    @property
    def estimates(self) -> Table: ...

_Told = Callable[[float], object] | None

def connect(
    port: str | None, address: str | None, serial: str | None, baud: int | None, wait_s: float
) -> Device: ...
def open(path: str, settings: Mapping[str, float], told: _Told) -> Run: ...
def from_columns(
    name: str,
    rotary: bool,
    t_s: bytes,
    encoder_count: bytes,
    force: bytes,
    terminal: bytes,
    settings: Mapping[str, float],
) -> Run: ...
def with_settings(run: Run, settings: Mapping[str, float]) -> Run: ...
def interval_text(value: float, u95: float) -> str: ...
def printable(text: str) -> str: ...
def replay(run: Run, limits: str | None, told: _Told) -> tuple[str, Sums]: ...
def merge(sums: list[Sums], offset_n: float | None) -> tuple[str, list[str], Sums]: ...
def diagnose(
    run: Run, counts_per_turn: float | None, counts_per_line: float | None, told: _Told
) -> tuple[str, list[str]]: ...
def identify(
    runs: list[Run],
    staged: bool,
    segment_s: float | None,
    free_structure_mass: bool,
    free_skew: bool,
    profiles: bool,
    told: _Told,
) -> str: ...
def plan(
    run: Run | None,
    preset: str | None,
    given: Mapping[str, float],
    force_noise_n: float | None,
    settings: Mapping[str, float],
    wants: str,
    motion: tuple[str, int] | None,
    limits: Mapping[str, float],
    told: _Told,
) -> tuple[str, list[str], str | None, Table, tuple[str, str]]: ...
def plot(run: Run, name: str, path: str | None, replace: bool, told: _Told) -> tuple[str, str]: ...
def report(run: Run, path: str, replace: bool, limits: str | None, told: _Told) -> list[str]: ...
def compare(
    runs: list[tuple[str | None, Run]],
    is_one_rig: bool | None,
    path: str | None,
    replace: bool,
    limits: str | None,
    told: _Told,
) -> tuple[str, list[str], tuple[str, str] | None]: ...
def simulate(
    name: str | None,
    file: str | None,
    points: tuple[float, bytes] | None,
    preset: str,
    given: Mapping[str, float],
    seed: int,
    duration_s: float | None,
    load_n: float,
    change: tuple[float, Mapping[str, float]] | None,
    settings: Mapping[str, float],
    path: str | None,
    replace: bool,
    told: _Told,
) -> Run: ...
