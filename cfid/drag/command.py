"""`cfid fit drag`: forces on a fastened vehicle in wind to drag coefficients."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.inputs import Workplace, open_workplace
from cfid.console.options import Delivery, LoadCellOptions, Method, ReadingOptions, RigOptions, flat
from cfid.console.outcome import deliver
from cfid.drag.data import WindEvidence, WindInputs, Words, read_wind_evidence
from cfid.drag.result import Grouping
from cfid.errors import ConfigError
from cfid.findings import rejection, warning
from cfid.records.result import Result

if TYPE_CHECKING:
    from cfid.drag.selection import DragChoices, DragResult

_MODELS = "Models"


@dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """What is fitted beside the thesis' models, and how the simple one is grouped."""

    grouping: Annotated[
        Grouping | None,
        typer.Option(
            help="Simple coefficients, as C.3.1 groups them: of each run and axis, x and y together, all winds of a "
            "command, all commands of a wind, all of an angle.",
            rich_help_panel=_MODELS,
        ),
    ] = None
    mended: Annotated[
        bool,
        typer.Option("--mended", help="Cross-coupling loses lift both ways: kappa_4 |v_xy|.", rich_help_panel=_MODELS),
    ] = False
    intercepts: Annotated[
        bool, typer.Option("--intercepts", help="A constant force in each wind: tare drift.", rich_help_panel=_MODELS)
    ] = False
    parasitic: Annotated[
        bool, typer.Option("--parasitic", help="Drag of the body too, k |v| v.", rich_help_panel=_MODELS)
    ] = False

    def choices(self, method: Method) -> "DragChoices":
        """Return how models are fitted. Raises ConfigError for what no campaign can tell apart."""
        from cfid.drag.selection import DragChoices

        if self.intercepts and self.parasitic:
            raise ConfigError(
                "--intercepts and --parasitic: both forces stay the same throughout a wind, and nothing tells them "
                "apart: ask for one."
            )
        return DragChoices(method=method, mended=self.mended, intercepts=self.intercepts, parasitic=self.parasitic)


@flat
def drag(
    *,
    runs: Words = None,
    wind: WindInputs,
    models: ModelOptions,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
    method: Method = "default",
) -> None:
    """Fit the simple, the cross-coupling and the complex model of drag, and judge which of them is asked for.

    Example: [bold]cfid fit drag --index wind.csv --azimuth-deg 28.46 --yaw-deg 45[/bold]
    """
    from cfid.drag.selection import fit_models

    workplace, choices = open_workplace(rig), models.choices(method)
    evidence = read_wind_evidence(runs or [], wind, reading, scale, workplace, method=method)
    found = fit_models(evidence.experiments, choices)
    deliver(_outcome(found, evidence, models.grouping, method, workplace), delivery, workplace.campaign)


def _outcome(
    found: "DragResult", evidence: WindEvidence, grouping: Grouping | None, method: Method, workplace: Workplace
) -> Result:
    from cfid.drag import result as told

    def drawings() -> dict[str, Any]:
        from cfid.drag.figures import coefficients_figure, forces_figure, models_figure

        figures = {"drag_forces": forces_figure(found.experiments), "drag_models": models_figure(found)}
        return figures if found.groups is None else {**figures, "drag_coefficients": coefficients_figure(found)}

    return Result(
        command="fit drag",
        method=method,
        quantities=told.drag_parameters(found, grouping),
        covariances=told.drag_covariances(found),
        quality=told.drag_quality(found),
        sources=evidence.sources,
        findings=(
            *(warning("drag-warning", text) for text in (*evidence.warnings, *found.warnings)),
            *(rejection("drag-rejected", text, "drag.*") for text in (*evidence.doubts, *found.chosen.doubts)),
        ),
        lines=tuple(told.drag_lines(found, grouping)),
        drawings=drawings,
        folder=workplace.figures_beside(evidence.paths),
    )
