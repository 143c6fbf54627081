"""What an analysis found: quantities, what speaks against them, and how it is told and drawn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cfid.findings import Finding
from cfid.findings import rejected as rejected_among
from cfid.records.covariances import Covariance
from cfid.records.parameters import Parameter, Source

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Figures = Mapping[str, "Figure"]


@dataclass(frozen=True, kw_only=True)
class Result:
    """The result of one analysis, the same type for every experiment.

    `command` is what gives it on the command line, `section` where parameters.toml keeps it. `quantities` has all that
    was found, also what was rejected; `wanted` are the keys that the analysis is for, or patterns of them: all, where
    none is named. `quality` judges the fit in figures. `covariances` and `common` are as a section of parameters.toml
    has them. `lines` tell a person what the quantities do not. `drawings` makes the figures by their file names, and
    `folder` is where they belong.
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

    @property
    def rejected(self) -> Mapping[str, str]:
        """The keys of what was rejected, each with the reason."""
        return rejected_among(self.findings, self.quantities)

    @property
    def accepted(self) -> bool:
        """Whether nothing was rejected of what the analysis is for."""
        against = [one for one in self.findings if one.severity == "rejection"]
        whole = any(not one.quantities for one in against)
        return not whole and not any(fnmatchcase(key, wanted) for key in self.rejected for wanted in self.wanted or "*")

    def summary(self) -> tuple[str, ...]:
        """Return what a person is told besides the table of quantities."""
        return self.lines

    def figures(self) -> Figures:
        """Draw the figures, by file name."""
        return self.drawings() if self.drawings is not None else {}

    def without_rejected(self) -> "Result":
        """Return the result without the quantities that were rejected; why they were stays."""
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
