"""The result of an analysis: its quantities, findings, lines for the terminal and figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.findings import Finding, merged
from cfid.findings import rejected as rejected_among
from cfid.quantities.registry import find, unit_of
from cfid.quantities.values import is_rows
from cfid.records.covariances import Covariance
from cfid.records.parameters import Parameter, Source

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Figures = Mapping[str, "Figure"]

_GONE = object()  # in place of what a rejection took


class Dependent:
    """A figure of merit or a line that shows the numbers of quantities; it is removed where one of them is rejected.

    `instead` then takes its place; with None, nothing does.
    """

    def __init__(self, value: Any, *quantities: str, instead: Any = None) -> None:
        """Let a value depend on quantities, which are named by their keys."""
        self.value, self.quantities, self.instead = value, quantities, instead

    def is_lost(self, rejections: Sequence[Finding]) -> bool:
        """Return whether a rejection concerns one of the quantities."""
        return any(one.concerns(key) for one in rejections for key in self.quantities)


@dataclass(frozen=True, kw_only=True)
class Result:
    """The result of one analysis, the same type for every experiment.

    `command` is the command that gives the result, `section` the name of its fit. `quantities` has every quantity,
    rejected ones included; `wanted` are the keys that the analysis is for, or patterns of them; empty means all.
    `beside` are patterns of those that the terminal shows on request alone. `merits` has the fit's figures of
    merit, which `quality` returns. `covariances` and `common` are as in a section of a fit. `rests_on` names what
    the analysis takes from rig.toml, such as "vehicle.mass_kg" or "mounts.x", in addition to what recordings
    themselves state. `facts` are numbers that recordings state and that the quantities depend on, under rig.toml's
    keys; rig.toml should state the same. `suspects` are the mounts, or runs, that a rejection names as wrong.
    `lines` are further lines, which `summary` returns and the terminal shows on request, or always with
    `prints_lines`, where they are what the command is for. `drawings` makes the figures by file name, and `folder` is
    their folder; without one, they are drawn on request alone.
    """

    command: str
    section: str = ""
    method: str
    quantities: Mapping[str, Parameter]
    wanted: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    merits: Mapping[str, Any] = field(default_factory=dict)
    sources: tuple[Source, ...] = ()
    covariances: tuple[Covariance, ...] = ()
    common: Mapping[str, Mapping[str, list[float]]] = field(default_factory=dict)
    rests_on: tuple[str, ...] = ()
    facts: Mapping[str, float] = field(default_factory=dict)
    suspects: tuple[str, ...] = ()
    lines: tuple[str | Dependent, ...] = ()
    prints_lines: bool = False
    drawings: Callable[[], Figures] | None = None
    folder: Path | None = None

    def __post_init__(self) -> None:
        """Give each quantity without a unit that of the registry, and merge findings of several files."""
        named = {key: one if one.unit else replace(one, unit=unit_of(key)) for key, one in self.quantities.items()}
        object.__setattr__(self, "quantities", named)
        object.__setattr__(self, "findings", merged(self.findings))

    @property
    def section_name(self) -> str:
        """The name of the fit that keeps the result."""
        return self.section or self.command.removeprefix("fit ")

    @property
    def rejected(self) -> Mapping[str, str]:
        """The keys of the rejected quantities, each with the reason."""
        return rejected_among(self.findings, self.quantities)

    @property
    def accepted(self) -> bool:
        """Whether no quantity that the analysis is for was rejected."""
        rejections = [one for one in self.findings if one.severity == "rejection"]
        whole = any(not one.quantities for one in rejections)
        return not whole and not any(fnmatchcase(key, wanted) for key in self.rejected for wanted in self.wanted or "*")

    def summary(self) -> tuple[str, ...]:
        """Return the lines for the terminal besides the table of quantities."""
        return tuple(_shown(self.lines))

    @property
    def quality(self) -> Mapping[str, Any]:
        """The figures of merit of the fit, by name."""
        return dict(_shown(self.merits))

    def figures(self) -> Figures:
        """Draw the figures, by file name."""
        return self.drawings() if self.drawings is not None else {}

    def without_rejected(self) -> "Result":
        """Return the result without the rejected quantities and what shows their numbers; the findings stay.

        In a table, only the measured columns of the rejected rows become unknown.
        """
        gone = self.rejected.keys()
        rejections = [one for one in self.findings if one.severity == "rejection"]
        common = {
            cause: {key: effect for key, effect in effects.items() if key not in gone}
            for cause, effects in self.common.items()
        }
        return replace(
            self,
            quantities={key: _accepted_rows(key, one) for key, one in self.quantities.items() if key not in gone},
            merits=_shown(self.merits, rejections),
            lines=_shown(self.lines, rejections),
            covariances=tuple(one for one in self.covariances if not gone & set(one.of)),
            common={cause: effects for cause, effects in common.items() if effects},
        )


def _accepted_rows(key: str, quantity: Parameter) -> Parameter:
    """Return a quantity in whose rejected rows the measured columns are unknown."""
    found = find(key)
    if found is None or not is_rows(quantity.value):
        return quantity
    unknown = dict.fromkeys(found.measured)
    rows = [row if row.get("accepted", True) else {**row, **unknown} for row in quantity.value]
    return replace(quantity, value=rows)


def _shown(content: Any, rejections: Sequence[Finding] = ()) -> Any:
    """Return nested content where each `Dependent` is replaced by its value, or removed where a rejection takes it."""
    if isinstance(content, Mapping):
        return {key: shown for key, part in content.items() if (shown := _shown(part, rejections)) is not _GONE}
    if type(content) in (list, tuple):
        return type(content)(shown for part in content if (shown := _shown(part, rejections)) is not _GONE)
    if not isinstance(content, Dependent):
        return content
    if content.is_lost(rejections):
        return _GONE if content.instead is None else _shown(content.instead, rejections)
    return content.value
