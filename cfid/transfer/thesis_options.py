"""The thesis' own calculation of a transfer function (C.2.5), its numbers as options, and what it says beside ours."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.errors import CfidError
from cfid.transfer.sines.data import SineSet

if TYPE_CHECKING:
    from cfid.transfer.sines.alignment import RecordedSine
    from cfid.transfer.thesis import ThesisFit, ThesisSettings

_THESIS = "As the thesis"
_SECOND_SAMPLES = 8000


@dataclass(frozen=True, kw_only=True)
class ThesisOptions:
    """C.2.5's constants, which are two sets: one for each of its series."""

    preset: Annotated[
        Literal["first", "second"] | None,
        typer.Option(help="Settings of the thesis' first or second series; default: by N.", rich_help_panel=_THESIS),
    ] = None
    settle_samples: Annotated[
        int | None, typer.Option("--n-t", min=1, help="N_T, samples left out.", rich_help_panel=_THESIS)
    ] = None
    weight_low: Annotated[
        float | None, typer.Option(min=0, help="Weight of slow sines; enters squared.", rich_help_panel=_THESIS)
    ] = None
    weight_high: Annotated[float | None, typer.Option(min=0, help="Weight of the others.", rich_help_panel=_THESIS)] = (
        None
    )
    low_up_to: Annotated[
        int | None, typer.Option(min=0, help="The largest l of the slow ones.", rich_help_panel=_THESIS)
    ] = None
    count_up_to: Annotated[
        int | None, typer.Option(min=1, help="The largest l that counts.", rich_help_panel=_THESIS)
    ] = None
    denominator: Annotated[int, typer.Option("--a", min=1, help="A of eq. 3.10.", rich_help_panel=_THESIS)] = 2
    numerator: Annotated[int, typer.Option("--b", min=1, help="B of eq. 3.10.", rich_help_panel=_THESIS)] = 1

    def settings(self, samples: int) -> "ThesisSettings":
        """Return the settings for runs of N samples."""
        from dataclasses import replace

        from cfid.transfer.thesis import FIRST_SERIES, SECOND_SERIES

        preset = self.preset or ("second" if samples == _SECOND_SAMPLES else "first")
        given = {name: value for name, value in asdict(self).items() if name != "preset" and value is not None}
        return replace(FIRST_SERIES if preset == "first" else SECOND_SERIES, **given)


@dataclass(frozen=True, kw_only=True, eq=False)
class AsThesis:
    """One fit a series, and the least squares of all their responses with their weights."""

    each: "dict[str, ThesisFit]"
    joint: "ThesisFit"


def fit_as_thesis(sines: SineSet, options: ThesisOptions, *, sign: Literal["auto", "+", "-"]) -> AsThesis:
    """Identify as C.2.5 does. Raises DataError and FitError with a run's name."""
    from cfid.transfer.thesis import fit_thesis, join_thesis

    settings = {name: options.settings(runs[0].plan.samples) for name, runs in sines.series.items()}
    each = {
        name: fit_thesis([_upward(run, sign) for run in runs], settings[name]) for name, runs in sines.series.items()
    }
    joint = next(iter(each.values())) if len(each) == 1 else join_thesis(list(each.values()), options.settings(0))
    return AsThesis(each=each, joint=joint)


def beside_thesis(sines: SineSet, options: ThesisOptions, *, sign: Literal["auto", "+", "-"]) -> "AsThesis | str":
    """Return the thesis' calculation, or why there is none."""
    try:
        return fit_as_thesis(sines, options, sign=sign)
    except CfidError as error:
        return str(error)


def as_json(fit: "ThesisFit") -> dict[str, Any]:
    """Return the thesis' result as --json has it beside ours."""
    return {
        "numerator": fit.numerator.tolist(),
        "denominator": fit.denominator.tolist(),
        "static_gain_n": fit.static_gain_n,
        "time_constant_s": fit.time_constant_s,
    }


def _upward(run: "RecordedSine", sign: Literal["auto", "+", "-"]) -> "RecordedSine":
    """Give a run's force the sign of thrust: while it is played motors push one way."""
    from dataclasses import replace

    import numpy as np

    begin, end = np.searchsorted(run.time_s, run.reports.host_s[[0, -1]])
    down = sign == "-"
    if sign == "auto" and begin > 0 and end > begin:
        down = bool(run.force_n[begin:end].mean() < run.force_n[:1000].mean())
    return replace(run, force_n=-run.force_n) if down else run
