"""Provide `cfid tf identify` and `cfid tf verify`: fit a transfer function to sine runs, and check it on others."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cfid.console.flat import flat
from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.lists import comma_list, measured
from cfid.console.options import Delivery, Method, RigOptions, YawDeg, finite
from cfid.console.outcome import deliver
from cfid.console.selection import chosen
from cfid.errors import ConfigError, DataError
from cfid.units import FULL_COMMAND, MM

if TYPE_CHECKING:
    from cfid.transfer.sines.data import SineSet
    from cfid.transfer.thesis import ThesisSettings
    from cfid.transfer.verification_result import Function

_INPUT, _FIT, _THESIS, _FUNCTION = "What was measured", "Model", "As the thesis", "Transfer function"
_EXAMPLE = "1,-0.97"

Words = Annotated[
    list[str] | None, typer.Argument(metavar="RUN ...", help="Runs of cfid log sine; default: all complete ones.")
]
Compare = Annotated[Literal["eq3.15", "eq3.16"] | None, typer.Option(help="Result of the thesis to compare with.")]


@dataclass(frozen=True, kw_only=True)
class SineInputs:
    """The location of sine runs, and the channel of the load cell that gives their thrust."""

    index: Annotated[
        Path | None,
        typer.Option(
            help="CSV file with one row per run: l,n,amplitude,motor,loadcell,crossings[,series]; paths are relative "
            "to the file; a load cell is a file whose columns name their unit (Fz_n, Fz_counts) or a run.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    channel: Annotated[
        Literal["arm", "Tx", "Ty", "Fz"],
        typer.Option(
            help="Channel of the load cell: torque about the motor's own arm, torque about x or y, or the force.",
            rich_help_panel=_INPUT,
        ),
    ] = "arm"
    sign: Annotated[
        Literal["auto", "+", "-"],
        typer.Option(
            help="Sign of thrust in the channel; auto: chosen so that thrust is positive.", rich_help_panel=_INPUT
        ),
    ] = "auto"
    arm_mm: Annotated[
        str | None,
        typer.Option(
            metavar="MM[:STD]",
            help="Distance from the load cell's z axis to the motor's; default: the run's, else rig.toml's.",
            rich_help_panel=_INPUT,
        ),
    ] = None
    yaw_deg: YawDeg = None
    offset: Annotated[
        float,
        typer.Option(
            min=0, max=FULL_COMMAND, help="B of eq. 3.6, the offset of the command, for files.", rich_help_panel=_INPUT
        ),
    ] = 30000.0

    def read(self, words: Sequence[str] | None, workplace: Workplace, *, excluded: bool = False) -> "SineSet":
        """Read the index and the RUNs, with a glob also those `excluded`; without either, all complete sines.

        Raises ConfigError and DataError.
        """
        from cfid.transfer.sines.data import read_sines

        arm = measured(self.arm_mm, "--arm-mm")
        return read_sines(
            [find_recording(word, workplace) for word in self._chosen(words, workplace, excluded)],
            index=self.index,
            channel=self.channel,
            arm_m=None if arm.value is None else MM * arm.value,
            arm_std_m=None if arm.std is None else MM * arm.std,
            yaw_deg=None if self.yaw_deg is None else finite(self.yaw_deg, "--yaw-deg"),
            facts=workplace.facts,
            middle=self.offset,
        )

    def _chosen(self, words: Sequence[str] | None, workplace: Workplace, excluded: bool) -> list[str]:
        if not words and self.index is not None:
            return []
        if not words and workplace.campaign is None:
            raise ConfigError("no sine to read: give RUNs of `cfid log sine`, or --index FILE.")
        return chosen(
            words,
            workplace.campaign,
            suits=lambda run: run.header.family == "sine",
            wanted="sines",
            excluded=excluded,
        )


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """The quantities to identify, and the part of the runs to use."""

    shape: Annotated[
        Literal["first", "first+delay", "second", "zero", "auto"],
        typer.Option(
            help="Model: a lag alone, with delay, with a second lag, or with a zero; auto: by corrected AIC.",
            rich_help_panel=_FIT,
        ),
    ] = "first+delay"
    form: Annotated[
        Literal["hold", "thesis"],
        typer.Option(help="hold: H(z) has a factor z^-1; thesis: it has none, as in eq. 3.15.", rich_help_panel=_FIT),
    ] = "hold"
    settle_s: Annotated[
        float, typer.Option(min=0, help="Seconds to leave out at the start of each run.", rich_help_panel=_FIT)
    ] = 1.0
    cutoff_hz: Annotated[
        float, typer.Option(min=0, help="Leave out runs with sines above this frequency.", rich_help_panel=_FIT)
    ] = 12.5


@dataclass(frozen=True, kw_only=True)
class ThesisOptions:
    """The constants of C.2.5; the thesis has one set for each of its two series."""

    preset: Annotated[
        Literal["first", "second"] | None,
        typer.Option(
            help="Settings of the thesis' first or second series; default: chosen by N.", rich_help_panel=_THESIS
        ),
    ] = None
    settle_samples: Annotated[
        int | None,
        typer.Option(
            "--n-t", min=1, help="N_T, the number of samples to leave out at the start.", rich_help_panel=_THESIS
        ),
    ] = None
    weight_low: Annotated[
        float | None, typer.Option(min=0, help="Weight of slow sines; enters squared.", rich_help_panel=_THESIS)
    ] = None
    weight_high: Annotated[
        float | None, typer.Option(min=0, help="Weight of the other sines.", rich_help_panel=_THESIS)
    ] = None
    low_up_to: Annotated[
        int | None, typer.Option(min=0, help="Largest l that counts as slow.", rich_help_panel=_THESIS)
    ] = None
    count_up_to: Annotated[int | None, typer.Option(min=1, help="Largest l to use.", rich_help_panel=_THESIS)] = None
    denominator: Annotated[int, typer.Option("--a", min=1, help="A of eq. 3.10.", rich_help_panel=_THESIS)] = 2
    numerator: Annotated[int, typer.Option("--b", min=1, help="B of eq. 3.10.", rich_help_panel=_THESIS)] = 1

    def settings(self, samples: int) -> "ThesisSettings":
        """Return the settings for runs of N samples."""
        from cfid.transfer.thesis import FIRST_SERIES, SECOND_SERIES, settings_of

        presets = {None: settings_of(samples), "first": FIRST_SERIES, "second": SECOND_SERIES}
        given = {name: value for name, value in asdict(self).items() if name != "preset" and value is not None}
        return replace(presets[self.preset], **given)


@dataclass(frozen=True, kw_only=True)
class FunctionOptions:
    """A transfer function given by its numbers, instead of the campaign's."""

    numerator: Annotated[
        str | None,
        typer.Option(metavar="B0,B1,...", help="Numerator coefficients of z^0, z^-1, ...", rich_help_panel=_FUNCTION),
    ] = None
    denominator: Annotated[
        str | None,
        typer.Option(
            metavar="1,A1,...",
            help="Denominator coefficients of z^0, z^-1, ..., with the leading 1.",
            rich_help_panel=_FUNCTION,
        ),
    ] = None
    delay_s: Annotated[
        float | None,
        typer.Option(help="Delay of the force after the stamped command; may be negative.", rich_help_panel=_FUNCTION),
    ] = None


@flat
def identify(
    *,
    runs: Words = None,
    inputs: SineInputs,
    fit: FitOptions,
    thesis: ThesisOptions,
    rig: RigOptions,
    delivery: Delivery,
    compare: Compare = None,
    method: Method = "default",
) -> None:
    """Identify thrust over command: gain, time constant and delay, from sines of many frequencies (section 3.4).

    H(z) is given in z^-1 with the denominator's leading 1. The delay is relative to the timestamps of the reports.

    Example: [bold]cfid tf identify 2026-11-21_083012_sine_l1 2026-11-21_083030_sine_l2 ...[/bold]
    """
    from cfid import transfer

    workplace = open_workplace(rig)
    sines = inputs.read(runs, workplace)
    result = transfer.fit(
        sines,
        sign=inputs.sign,
        shape=fit.shape,
        form=fit.form,
        settle_s=fit.settle_s,
        cutoff_hz=fit.cutoff_hz,
        settings=thesis.settings,
        thrust_poly=_thrust_poly(workplace),
        compare=compare,
        method=method,
    )
    deliver(replace(result, folder=workplace.figures), delivery, workplace.campaign, workplace.own_rig)


def _thrust_poly(workplace: Workplace) -> list[float] | None:
    """Return the campaign's thrust over command, if it has been fitted."""
    if workplace.campaign is None:
        return None
    found = workplace.campaign.values().find("motor.thrust_poly")
    return None if found is None else list(found.parameter.value)


@flat
def verify(
    *,
    runs: Annotated[
        list[str] | None, typer.Argument(metavar="RUN ...", help="Runs that were left out of the fit.")
    ] = None,
    inputs: SineInputs,
    function: FunctionOptions,
    settle_s: Annotated[float, typer.Option(min=0, help="Seconds to leave out at the start of each run.")] = 1.0,
    rig: RigOptions,
    delivery: Delivery,
) -> None:
    """Simulate the campaign's transfer function, or one given by its coefficients, against runs left out of the fit.

    Example: [bold]cfid tf verify 2026-11-21_083012_sine_l12[/bold]
    """
    from cfid import transfer

    workplace = open_workplace(rig)
    known = _function(function, workplace)
    if not runs and inputs.index is None:
        raise ConfigError("nothing to verify with: give a RUN that was left out of the fit, or --index FILE.")
    sines = inputs.read(runs, workplace, excluded=True)
    result = transfer.verify(sines, known, sign=inputs.sign, settle_s=settle_s)
    deliver(replace(result, folder=workplace.figures), delivery, workplace.campaign, workplace.own_rig)


def _function(options: FunctionOptions, workplace: Workplace) -> "Function":
    """Return the function of the options, else that of the campaign. Raises ConfigError if either is incomplete."""
    from cfid.transfer.verification_result import Function

    if options.numerator is None and options.denominator is None:
        return _of_campaign(options, workplace)
    if options.numerator is None or options.denominator is None:
        raise ConfigError("--numerator and --denominator belong together: give both, or none for the campaign's.")
    return Function.of_coefficients(
        comma_list(options.numerator, "--numerator", float, example=_EXAMPLE),
        comma_list(options.denominator, "--denominator", float, example=_EXAMPLE),
        delay_s=options.delay_s or 0.0,
    )


def _of_campaign(options: FunctionOptions, workplace: Workplace) -> "Function":
    from cfid.transfer.verification_result import Function

    if workplace.campaign is None:
        raise ConfigError("no campaign here that has a transfer function: give --numerator, --denominator, --delay-s.")
    found = workplace.campaign.values().find("tf.time_constant_s") or workplace.campaign.values().find("tf.numerator")
    if found is None:
        raise ConfigError("this campaign has no transfer function yet: run `cfid tf identify`, or give --numerator ...")
    try:
        return Function.of_quantities(found.section.parameters, found.section.sources, delay_s=options.delay_s)
    except DataError as error:
        raise DataError(f"{found.fit.stem}: {error}") from None
