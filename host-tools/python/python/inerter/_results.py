"""Results of runs: the JSON of the command line, with names and tables for people."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from . import _inerter

_UNITS = {
    "kg": "kg",
    "kg_m2": "kg m²",
    "n_s_per_m": "N s/m",
    "n_m_s": "N m s",
    "n_per_m": "N/m",
    "n_m_per_rad": "N m/rad",
    "n_m": "N m",
    "n": "N",
    "m": "m",
    "rad": "rad",
    "s": "s",
}


class _Shown:
    """Base of a dataclass whose `repr` is printable: Python's own rule leaves fillers and selectors as they are."""

    def __repr__(self) -> str:
        of: Any = self
        parts = ", ".join(f"{field.name}={getattr(of, field.name)!r}" for field in fields(of))
        return _inerter.printable(f"{type(of).__qualname__}({parts})")


@dataclass(frozen=True, repr=False)
class Parameter(_Shown):
    """A parameter of the device with its 95 % interval.

    `value` and `u95`, the half width of the interval, are in `unit`; both are None if the motion cannot identify it. `status` is `ok`,
    `below_u95` (it may be zero), `held` or `not_identifiable`. `same_rig_u95` is the half width for comparing runs on one rig,
    `assumes` the causes that this motion cannot separate from it: it is right only in their absence.
    """

    name: str
    value: float | None
    u95: float | None
    unit: str
    status: str
    same_rig_u95: float | None = None
    assumes: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.value is None or self.u95 is None:
            return "not identifiable"
        text = _inerter.interval_text(self.value, self.u95)
        return f"{text} {self.unit}"


@dataclass(frozen=True)
class Figure:
    """A figure of a run, a comparison or a plan: `svg` is the document, `caption` says what it shows. A notebook draws it."""

    name: str
    svg: str
    caption: str

    def _repr_svg_(self) -> str:
        return self.svg

    def __repr__(self) -> str:
        return _inerter.printable(f"inerter.Figure {self.name}: {self.caption}")


class Result(Mapping[str, Any]):
    """A result as the command line prints it: the object of its JSON, with attributes for people."""

    _title = "Result"
    _shows = ""
    """Name of the figure that belongs to it."""

    def __init__(self, line: Mapping[str, Any], run: _inerter.Run | None = None) -> None:
        self._line = line
        self._run = run
        self._figure: Figure | None = None

    @property
    def figure(self) -> Figure | None:
        """The figure that belongs to it; None if there is none."""
        if self._figure is None and self._run is not None and self._shows:
            try:
                self._figure = Figure(self._shows, *_inerter.plot(self._run, self._shows, None, False, None))
            except _inerter.InerterError:
                self._run = None
        return self._figure

    def __getitem__(self, key: str) -> Any:
        return self._line[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._line)

    def __len__(self) -> int:
        return len(self._line)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The parameters by name; each name ends with the unit."""
        return {}

    @property
    def remarks(self) -> list[str]:
        """Sentences for a person: what is wrong, and what to do about it."""
        return []

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.parameters]

    def __getattr__(self, name: str) -> Parameter:
        if name.startswith("_"):
            raise AttributeError(name)
        parameters = self.parameters
        if name in parameters:
            return parameters[name]
        known = ", ".join(parameters) or "none"
        raise AttributeError(_inerter.printable(f"there is no parameter {name!r} in this result; there are: {known}"))

    def __repr__(self) -> str:
        rows = [f"{name:<28} {parameter}" for name, parameter in self.parameters.items()]
        return _lines(self._title, *rows, *self.remarks)

    def _repr_html_(self) -> str:
        cells = "".join(
            f"<tr><th style='text-align:left'>{_escaped(name)}</th><td>{_escaped(str(parameter))}</td>"
            f"<td>{_escaped(parameter.status)}</td></tr>"
            for name, parameter in self.parameters.items()
        )
        remarks = "".join(f"<p>{_escaped(words)}</p>" for words in self.remarks)
        return f"<table><caption>{_escaped(self._title)}</caption>{cells}</table>{remarks}{_drawn(self.figure)}"


def _lines(*texts: str) -> str:
    """Texts that may quote files and devices, each as one printable line."""
    return "\n".join(map(_inerter.printable, texts))


def _escaped(text: str) -> str:
    """Text that may quote files and devices, printable on a page."""
    return html.escape(_inerter.printable(text))


def _drawn(figure: Figure | None) -> str:
    return f"<figure>{figure.svg}<figcaption>{_escaped(figure.caption)}</figcaption></figure>" if figure else ""


def _judged(limits: Mapping[str, Any] | None, of: str = "") -> list[str]:
    """The verdicts on limits, if there are any, as a sentence."""
    if limits is None:
        return []
    each = [f"{one['parameter']} {one['verdict']}" + (f" ({one['reason']})" if one.get("reason") else "") for one in limits["parameters"]]
    return [f"Limits{of}: {limits['verdict']}: {'; '.join(each)}."]


def _law(line: Mapping[str, Any]) -> str:
    law = line.get("law") or {}
    words = {"holds": "The law holds.", "broken": "The law is broken."}
    return words.get(law.get("status", ""), "Whether the law holds is not known.")


def _named(of: Mapping[str, Any] | None, budgets: Mapping[str, Any] | None = None) -> dict[str, Parameter]:
    named = {}
    for name, found in (of or {}).items():
        if not isinstance(found, Mapping) or "u95" not in found or "status" not in found:
            continue
        budget = (budgets or {}).get(name) or {}
        u95 = budget.get("u95", found["u95"]) if found["value"] is not None else None
        # By this interval, which may be wider than the one that the status was found with; of an offset none is a finding, too.
        below = found["status"] == "ok" and u95 is not None and abs(found["value"]) < u95 and name != "offset_n"
        named[name] = Parameter(
            name=name,
            value=found["value"],
            u95=u95,
            unit=_unit(name),
            status="below_u95" if below else found["status"],
            same_rig_u95=budget.get("same_rig_u95"),
            assumes=tuple(budget.get("assumes", ())),
        )
    return named


def _unit(name: str) -> str:
    matching = [suffix for suffix in _UNITS if name.endswith("_" + suffix)]
    return _UNITS[max(matching, key=len)] if matching else ""


class Summed(Result):
    """A result of exact sums."""

    def __init__(self, line: Mapping[str, Any], sums: _inerter.Sums, run: _inerter.Run | None = None) -> None:
        super().__init__(line, run)
        self._sums = sums

    @property
    def sums(self) -> _inerter.Sums:
        """The exact sums of the run, or of all runs, for `merge`."""
        return self._sums


class Replay(Summed):
    """The result of a whole run: the last line of `inerter replay --json`."""

    _title = "Replay"
    _shows = "parameters"

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Inertance, friction and offset over the whole run, and what is known of the contact.

        `u95` follows from the samples: it is wider than the device's own interval if these show more than the law explains.
        `replay["inertance_kg"]` and the like, as in the JSON, are those of the recent motion, with the device's own intervals.
        """
        budgets = self.get("uncertainty")
        found = _named(self["whole_run"], budgets)
        rest = {name: value for name, value in self.items() if name not in found}
        return {**found, **_named(rest, budgets)}

    @property
    def remarks(self) -> list[str]:
        """Whether the law holds, the verdicts on limits, what is wrong with samples or law, and which motion would have been more
        informative.
        """
        advice = self.get("advice")
        warnings = [warning["text"] for warning in self["warnings"]]
        return [_law(self), *_judged(self.get("limits")), *warnings, *([advice["text"]] if advice else [])]


class Estimate(Result):
    """An estimate of a device: a line of `inerter monitor --json`. Its parameters are those over the whole run."""

    _title = "Estimate"

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Inertance, friction and offset over the whole run so far, and what is known of backlash and contact."""
        found = _named(self["whole_run"])
        return {**found, **_named({name: value for name, value in self.items() if name not in found})}

    @property
    def remarks(self) -> list[str]:
        """Whether the law holds."""
        return [_law(self)] if "law" in self else []


class Diagnosis(Result):
    """What breaks the law, the strongest cause first: the line of `inerter diagnose --json`."""

    _title = "Diagnosis"
    _shows = "residual"

    def __init__(self, line: Mapping[str, Any], words: list[str], run: _inerter.Run) -> None:
        super().__init__(line, run)
        self._words = words

    @property
    def causes(self) -> list[dict[str, Any]]:
        """Each cause with `name`, `value`, `u95`, `unit` and `f`, the F statistic."""
        return list(self["causes"])

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The parameters with all causes included, if they are known."""
        return _named(self["corrected"])

    @property
    def remarks(self) -> list[str]:
        """Whether the law holds, what breaks it, and what to do about it."""
        return list(self._words)


class Identification(Result):
    """The complete model of a device: the line of `inerter identify --json`."""

    _title = "Identification"
    _shows = "force"

    @property
    def parameters(self) -> dict[str, Parameter]:
        """All parameters of the model; `status` is `given` for those from the settings."""
        return _named(self["parameters"])

    @property
    def remarks(self) -> list[str]:
        """Notes on the fit."""
        return [str(note) for note in self.get("notes", [])]


class Merged(Summed):
    """Several runs fitted together: the line of `inerter fit --json`."""

    _title = "Fit"

    def __init__(self, line: Mapping[str, Any], remarks: list[str], sums: _inerter.Sums) -> None:
        super().__init__(line, sums)
        self._remarks = remarks

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Inertance, friction and offset, with the same friction in both directions; `["by_direction"]` has them by direction."""
        return _named(self["symmetric"])

    @property
    def remarks(self) -> list[str]:
        """How many runs there are, whether they differ, and for which of them the law does not hold."""
        return [f"{self._sums!r}, fitted together.".removeprefix("inerter."), *self._remarks]


@dataclass(frozen=True, repr=False)
class Difference(_Shown):
    """A parameter of a run minus that of the first one.

    `value` and `u95`, the half width of the 95 % interval, are in `unit`, and `p` is the chance of a difference at least this large if
    there is none; all three are None if one of the two motions cannot identify the parameter. `verdict` is `differs`, `not_shown` or
    `undecided`, with the `reason` if the run proves nothing.
    """

    name: str
    run: str
    value: float | None
    u95: float | None
    unit: str
    p: float | None
    verdict: str
    reason: str | None = None

    def __str__(self) -> str:
        if self.value is None or self.u95 is None:
            return "not identifiable"
        return f"{_inerter.interval_text(self.value, self.u95)} {self.unit}"


class Comparison(Result):
    """Runs compared with the first one: the line of `inerter compare --json`. `["parameters"]` has a list of all runs for each."""

    _title = "Comparison"

    def __init__(self, line: Mapping[str, Any], words: list[str], loops: tuple[str, str] | None) -> None:
        super().__init__(line)
        self._words = words
        self._figure = None if loops is None else Figure("loops", *loops)

    @property
    def differences(self) -> list[Difference]:
        """How each run but the first differs from it, parameter by parameter."""
        found = []
        for name, runs in self["parameters"].items():
            for run, told in zip(self["files"][1:], runs[1:]):
                of = told["difference"] or {"value": None, "u95": None, "p": None}
                found.append(Difference(name, run, of["value"], of["u95"], _unit(name), of["p"], told["verdict"], told["reason"]))
        return found

    @property
    def remarks(self) -> list[str]:
        """Which intervals these are, and the verdicts of each run on limits."""
        of_each = zip(self["files"], self.get("limits", ()))
        return [*self._words, *(words for run, limits in of_each for words in _judged(limits, f" of {run}"))]

    def __repr__(self) -> str:
        rows = [f"{one.name:<28} {one.run}: {one}, {one.verdict}" for one in self.differences]
        return _lines(f"{self._title} with {self['files'][0]}", *rows, *self.remarks)

    def _repr_html_(self) -> str:
        cells = "".join(
            "<tr>" + "".join(f"<td>{_escaped(text)}</td>" for text in (one.name, one.run, str(one), one.verdict)) + "</tr>"
            for one in self.differences
        )
        words = "".join(f"<p>{_escaped(one)}</p>" for one in self.remarks)
        title = _escaped(f"{self._title} with {self['files'][0]}")
        return f"<table><caption>{title}</caption>{cells}</table>{words}{_drawn(self.figure)}"


class Plan(Result):
    """A motion and its predicted intervals: the line of `inerter plan --json`, without its files."""

    _title = "Plan"

    def __init__(
        self,
        line: Mapping[str, Any],
        remarks: list[str],
        missed: str | None,
        motion: _inerter.Table,
        figure: tuple[str, str],
    ) -> None:
        super().__init__(line)
        self._figure = Figure("motion", *figure)
        self._remarks = remarks
        self._missed = missed
        self._motion = motion

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The prediction for each parameter: the expected value with its interval."""
        return _named(self["predicted"], self["predicted"])

    @property
    def motion(self) -> _inerter.Table:
        """The points of the motion, `t_s` and `terminal_m`, for a shaker or for `simulate`."""
        return self._motion

    @property
    def missed(self) -> str | None:
        """Wanted intervals that are out of reach; None if there are none."""
        return self._missed

    @property
    def remarks(self) -> list[str]:
        """Its duration, what is out of reach, and notes."""
        return [f"It takes {self['duration_s']:.4g} s.", *([self._missed] if self._missed else []), *self._remarks]
