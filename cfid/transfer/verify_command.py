"""`cfid tf verify`: an identified transfer function against sine runs that it was not made from (figure 3.16)."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cfid.console.inputs import Workplace, open_workplace
from cfid.console.lists import comma_list
from cfid.console.options import Delivery, LoadCellOptions, ReadingOptions, RigOptions, flat
from cfid.console.outcome import deliver
from cfid.errors import ConfigError, DataError
from cfid.findings import rejection, warning
from cfid.records.result import Result
from cfid.transfer.command import SECTION
from cfid.transfer.sines.data import SineInputs, SineSet, read_sines

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cfid.transfer.model import DifferenceEquation
    from cfid.transfer.sines.alignment import SineRun, SineSeries
    from cfid.transfer.verification import Verification

_FUNCTION = "Transfer function"
_VAGUE = 0.1  # of the sine, one deviation
_LONGEST_S = 10.0  # a delay, of either sign


@dataclass(frozen=True, kw_only=True)
class FunctionOptions:
    """A transfer function by its numbers, in place of the campaign's."""

    numerator: Annotated[
        str | None,
        typer.Option(metavar="B0,B1,...", help="Coefficients of z^0, z^-1, ...", rich_help_panel=_FUNCTION),
    ] = None
    denominator: Annotated[
        str | None,
        typer.Option(metavar="1,A1,...", help="The same, with the leading 1.", rich_help_panel=_FUNCTION),
    ] = None
    delay_s: Annotated[
        float | None,
        typer.Option(help="Of force after stamped command; may be negative.", rich_help_panel=_FUNCTION),
    ] = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Function:
    """What is verified: coefficients, and the delay after average or, if it is known, after quickest reports.

    `delay_std_s` is one deviation of the one that counts, 0 where nobody said.
    """

    equation: "DifferenceEquation"
    delay_s: float
    delay_std_s: float
    after_quickest_s: float | None
    used: frozenset[str]

    def delay_in(self, series: "SineSeries") -> tuple[float, float]:
        """Return the delay after the quickest reports of a series, and what is uncertain about it there."""
        from math import hypot

        if self.after_quickest_s is not None:
            return self.after_quickest_s, self.delay_std_s
        return self.delay_s + series.mean_lateness_s, hypot(self.delay_std_s, series.mean_lateness_std_s)


@flat
def verify(
    *,
    runs: Annotated[
        list[str] | None, typer.Argument(metavar="RUN ...", help="Runs that were left out of the fit.")
    ] = None,
    inputs: SineInputs,
    function: FunctionOptions,
    settle_s: Annotated[float, typer.Option(min=0, help="Of each run's beginning left out.")] = 1.0,
    rig: RigOptions,
    reading: ReadingOptions,
    scale: LoadCellOptions,
    delivery: Delivery,
) -> None:
    """Simulate the campaign's transfer function, or one by its numbers, against runs it was not identified from.

    Example: [bold]cfid tf verify 2026-11-21_083012_sine_l12[/bold]
    """
    from cfid.transfer.sines.alignment import align
    from cfid.transfer.verification import verify as compare

    workplace = open_workplace(rig)
    known = _function(function, workplace)
    if not runs and inputs.index is None:
        raise ConfigError("nothing to verify with: give a RUN that was left out of the fit, or --index FILE.")
    sines = read_sines(runs or [], inputs, reading, scale, workplace)
    if still := [run.plan.name for run in sines.runs if run.plan.periods == 0]:
        raise DataError(f"{still[0]}: has no frequency, and nothing to compare: leave it out.")
    compared: list[tuple[SineRun, Verification]] = []
    for recorded in sines.series.values():
        series = align(recorded, sign=inputs.sign)
        delay_s, std_s = known.delay_in(series)
        compared += [
            (
                run,
                compare(
                    run, known.equation, after_quickest_s=delay_s, delay_std_s=std_s, form="thesis", settle_s=settle_s
                ),
            )
            for run in series.runs
        ]
    deliver(_outcome(compared, known, sines, workplace), delivery, workplace.campaign)


def _function(options: FunctionOptions, workplace: Workplace) -> Function:
    """Return the function of the options, else that of the campaign. Raises ConfigError for half of either."""
    import numpy as np

    from cfid.transfer.model import DifferenceEquation

    if options.delay_s is not None and not abs(options.delay_s) <= _LONGEST_S:
        raise ConfigError(f"--delay-s {options.delay_s:g}: should be from {-_LONGEST_S:g} to {_LONGEST_S:g} s.")
    if options.numerator is None and options.denominator is None:
        return _of_campaign(options, workplace)
    if options.numerator is None or options.denominator is None:
        raise ConfigError("--numerator and --denominator belong together: give both, or none for the campaign's.")
    over = comma_list(options.numerator, "--numerator", float, example="1,-0.97")
    under = comma_list(options.denominator, "--denominator", float, example="1,-0.97")
    if under[0] != 1:
        raise ConfigError(f"--denominator {options.denominator}: should begin with its leading 1.")
    if not any(over):
        raise ConfigError(
            f"--numerator {options.numerator}: nothing is left of any command: give one that is not zero."
        )
    if np.max(np.abs(np.roots(under)), initial=0.0) >= 1:
        raise ConfigError(f"--denominator {options.denominator}: never settles, which no motor does: is a sign wrong?")
    return Function(
        equation=DifferenceEquation(numerator=np.array(over), denominator=np.array(under)),
        delay_s=options.delay_s or 0.0,
        delay_std_s=0.0,
        after_quickest_s=None,
        used=frozenset(),
    )


def _of_campaign(options: FunctionOptions, workplace: Workplace) -> Function:
    import numpy as np

    from cfid.records.parameters import load_sections
    from cfid.transfer.model import DifferenceEquation

    if workplace.campaign is None:
        raise ConfigError("no campaign here that knows a transfer function: say --numerator, --denominator, --delay-s.")
    path = workplace.campaign.parameters_file
    section = load_sections(path).get(SECTION)
    if section is None:
        raise ConfigError(f"{path}: has no transfer function yet: run `cfid tf identify`, or say --numerator ...")
    try:
        found = {key: section.parameters[f"tf.{key}"] for key in ("numerator", "denominator", "delay_s")}
    except KeyError as error:
        raise DataError(f"{path}: section {SECTION} has no {error.args[0]}: run `cfid tf identify` again.") from None
    quickest = section.parameters.get("tf.delay_after_quickest_s")
    counts = found["delay_s"] if quickest is None else quickest
    by_hand = options.delay_s
    return Function(
        equation=DifferenceEquation(
            numerator=np.array(found["numerator"].value), denominator=np.array(found["denominator"].value)
        ),
        delay_s=found["delay_s"].value if by_hand is None else by_hand,
        delay_std_s=counts.std or 0.0 if by_hand is None else 0.0,
        after_quickest_s=quickest.value if by_hand is None and quickest is not None else None,
        used=frozenset(source.sha256 for source in section.sources),
    )


def _outcome(
    compared: "list[tuple[SineRun, Verification]]", known: Function, sines: SineSet, workplace: Workplace
) -> Result:
    from cfid.records.parameters import Parameter

    parameters: dict[str, Parameter] = {}
    keys = _apart(own.name.partition(" (")[2].removesuffix(")").removesuffix(".csv") for _, own in compared)
    names = _apart(own.name for _, own in compared)
    for name, (_, own) in zip(keys, compared, strict=True):
        key = f"tf.verify.{name}"
        parameters |= {
            f"{key}.fit_percent": Parameter(value=own.fit_percent, unit="%"),
            f"{key}.residual_rms_n": Parameter(value=own.residual_rms_n, unit="N"),
            f"{key}.late_s": Parameter(value=own.late_s, std=own.late_std_s, unit="s"),
            f"{key}.gain_ratio": Parameter(value=own.gain_ratio, std=own.gain_ratio_std, unit="1"),
        }

    def drawings() -> "dict[str, Figure]":
        from cfid.transfer.figures import verification_figure

        figures = _apart(f"tf_verify_l{run.plan.periods}" for run, _ in compared)
        return {name: verification_figure(run, own) for name, (run, own) in zip(figures, compared, strict=True)}

    return Result(
        command="tf verify",
        section="tf verify",
        method="default",
        quantities=parameters,
        quality={"runs": {name: _quality(own) for name, (_, own) in zip(names, compared, strict=True)}},
        findings=(
            *(
                warning("tf-warning", text)
                for text in (*sines.warnings, *_reused(known, sines), *_vague(own for _, own in compared))
            ),
            *(
                rejection(
                    "tf-contradicted",
                    f"{own.name}: the measured sine differs from the simulated one by {100 * own.off:.0f} % of it, "
                    f"with a deviation of {100 * own.off_std:.1g} %.",
                )
                for _, own in compared
                if not own.believed
            ),
        ),
        sources=sines.sources,
        lines=tuple(_line(own) for _, own in compared),
        drawings=drawings,
        folder=workplace.figures_beside(sines.paths),
    )


def _quality(own: "Verification") -> dict[str, Any]:
    return {"off": own.off, "off_std": own.off_std, "unfiltered_fit_percent": own.unfiltered_fit_percent}


def _line(own: "Verification") -> str:
    return (
        f"{own.name}: fit {own.fit_percent:.1f} % ({own.unfiltered_fit_percent:.1f} % with the vibration), residual "
        f"{1e3 * own.residual_rms_n:.2g} mN rms; measured {1e3 * own.late_s:+.2f} +- {1e3 * own.late_std_s:.2g} ms "
        f"later and {own.gain_ratio:.4f} +- {own.gain_ratio_std:.2g} times as large as simulated"
    )


def _apart(names: Iterable[str]) -> list[str]:
    """Return names of which no two are alike: files of different folders may be called the same."""
    seen: Counter[str] = Counter()
    found = []
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return found


def _vague(compared: "Iterable[Verification]") -> list[str]:
    """Return a word on runs whose noise lets them fit almost any function."""
    return [
        f"{own.name}: is known to {100 * own.off_std:.0f} % of the sine only: it verifies little."
        for own in compared
        if own.off_std > _VAGUE
    ]


def _reused(known: Function, sines: SineSet) -> list[str]:
    """Return a word on runs that the function was identified from: they verify nothing."""
    again = [run.path for run in sines.sources if run.sha256 in known.used]
    return [f"{again[0]}: the transfer function was identified from it: this verifies nothing."] if again else []
