"""The result of an analysis: its quantities, findings, lines for the terminal and figures."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.findings import Finding, merged
from cfid.findings import rejected as rejected_among
from cfid.quantities.lookup import unit_of
from cfid.records.covariances import Covariance
from cfid.records.parameters import Parameter, Source

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Figures = Mapping[str, "Figure"]


@dataclass(frozen=True, kw_only=True)
class Result:
    """The result of one analysis, the same type for every experiment.

    `command` is the command that gives it, `section` its section of parameters.toml. `quantities` has every quantity,
    rejected ones included; `wanted` are the keys that the analysis is for, or patterns of them; empty means all.
    `quality` has figures of merit of the fit. `covariances` and `common` are as in a section of parameters.toml.
    `lines` are further lines for the terminal. `drawings` makes the figures by file name, and `folder` is their folder.
    """

    command: str
    section: str = ""
    method: str
    quantities: Mapping[str, Parameter]
    wanted: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    quality: Mapping[str, Any] = field(default_factory=dict)
    sources: tuple[Source, ...] = ()
    covariances: tuple[Covariance, ...] = ()
    common: Mapping[str, Mapping[str, list[float]]] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    drawings: Callable[[], Figures] | None = None
    folder: Path = field(default_factory=Path)

    def __post_init__(self) -> None:
        """Give a quantity that states no unit that of the registry, and merge findings of several files."""
        named = {key: one if one.unit else replace(one, unit=unit_of(key)) for key, one in self.quantities.items()}
        object.__setattr__(self, "quantities", named)
        object.__setattr__(self, "findings", merged(self.findings))

    @property
    def rejected(self) -> Mapping[str, str]:
        """The keys of the rejected quantities, each with the reason."""
        return rejected_among(self.findings, self.quantities)

    @property
    def accepted(self) -> bool:
        """Whether no quantity that the analysis is for was rejected."""
        against = [one for one in self.findings if one.severity == "rejection"]
        whole = any(not one.quantities for one in against)
        return not whole and not any(fnmatchcase(key, wanted) for key in self.rejected for wanted in self.wanted or "*")

    def summary(self) -> tuple[str, ...]:
        """Return the lines for the terminal besides the table of quantities."""
        return self.lines

    def figures(self) -> Figures:
        """Draw the figures, by file name."""
        return self.drawings() if self.drawings is not None else {}

    def without_rejected(self) -> "Result":
        """Return the result without the rejected quantities; the findings stay."""
        gone = self.rejected.keys()
        common = {
            cause: {key: effect for key, effect in effects.items() if key not in gone}
            for cause, effects in self.common.items()
        }
        return replace(
            self,
            quantities={key: found for key, found in self.quantities.items() if key not in gone},
            covariances=tuple(one for one in self.covariances if not gone & set(one.of)),
            common={cause: effects for cause, effects in common.items() if effects},
        )
