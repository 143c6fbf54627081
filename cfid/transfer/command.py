"""Provide `cfid log sine`, `cfid tf identify` and `cfid tf verify`: sines, their transfer function, and its check."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.console import messages as speech
from cfid.console.flat import flat
from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.labels import Note
from cfid.console.lists import comma_list, measured
from cfid.console.log_summary import print_json, stop_line
from cfid.console.messages import clock, echo, fitted, printable, result
from cfid.console.options import Delivery, Method, RigOptions, YawDeg, finite, panel, positive
from cfid.console.outcome import deliver
from cfid.console.recording import DryRun, KeepOptions, ResumeOptions, rig_of
from cfid.console.selection import chosen, interrupted
from cfid.console.vehicle import CellRateHz, ExperimentOptions, LogMs, motors_of
from cfid.console.verdicts import verdict_line
from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.lazy import later
from cfid.units import FULL_COMMAND, MM
from cfid.wire.app import MIDDLE, SAMPLES_PER_S

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign
    from cfid.records.run import Run
    from cfid.transfer.data import SineSet
    from cfid.transfer.model import TransferFunction
    from cfid.transfer.plan import Sine, SineSweep

_measured_option, _model_option = panel("What was measured"), panel("Model")
_function_option, _sine_option = panel("Transfer function"), panel("Sine")
_LARGEST_N = 2**32 - 1
_USUAL_N = 4000
_USUAL_PLAN: Literal["log"] = "log"
_MOST_BEFORE_S = 600.0
# Added to each run: connecting to the load cell, and the second until the vehicle reports the end.
_EXTRA_S = 2.5
_EXAMPLE = "1,-0.97"

Words = Annotated[
    list[str] | None, typer.Argument(metavar="RUN ...", help="Runs of cfid log sine; default: all complete ones.")
]
Preset = Annotated[
    Literal["first", "second"] | None,
    typer.Option(help="Constants of C.2.5 for the thesis method: those of its first or second series; default: by N."),
]
Compare = Annotated[Literal["eq3.15", "eq3.16"] | None, typer.Option(help="Result of the thesis to compare with.")]


@dataclass(frozen=True, kw_only=True)
class SineInputs:
    """The location of sine runs, and the channel of the load cell that gives their thrust."""

    index: Annotated[
        Path | None,
        _measured_option(
            help="CSV file with one row per run: l,n,amplitude,motor,loadcell,crossings[,series]; paths are relative "
            "to the file; a load cell is a file whose columns name their unit (Fz_n, Fz_counts) or a run."
        ),
    ] = None
    channel: Annotated[
        Literal["arm", "Tx", "Ty", "Fz"],
        _measured_option(
            help="Channel of the load cell: torque about the motor's own arm, torque about x or y, or the force."
        ),
    ] = "arm"
    sign: Annotated[
        Literal["auto", "+", "-"],
        _measured_option(help="Sign of thrust in the channel; auto: chosen so that thrust is positive."),
    ] = "auto"
    arm_mm: Annotated[
        str | None,
        _measured_option(
            metavar="MM[:STD]",
            help="Distance from the load cell's z axis to the motor's; default: the run's, else rig.toml's.",
        ),
    ] = None
    yaw_deg: YawDeg = None
    offset: Annotated[
        float,
        _measured_option(min=0, max=FULL_COMMAND, help="B of eq. 3.6, the offset of the command, for files."),
    ] = 30000.0

    def read(self, words: Sequence[str] | None, workplace: Workplace, *, excluded: bool = False) -> "SineSet":
        """Read the index and the RUNs, with a glob also those `excluded`; without either, all complete sines.

        Raises ConfigError and DataError.
        """
        from cfid.transfer.data import read_sines

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
        _model_option(
            help="Model: a lag alone, with delay, with a second lag, or with a zero; auto: by corrected AIC."
        ),
    ] = "first+delay"
    settle_s: Annotated[float, _model_option(min=0, help="Seconds to leave out at the start of each run.")] = 1.0
    cutoff_hz: Annotated[float, _model_option(min=0, help="Leave out runs with sines above this frequency.")] = 12.5


@dataclass(frozen=True, kw_only=True)
class FunctionOptions:
    """A transfer function given by its numbers, instead of the campaign's."""

    numerator: Annotated[
        str | None,
        _function_option(metavar="B0,B1,...", help="Numerator coefficients of z^0, z^-1, ..."),
    ] = None
    denominator: Annotated[
        str | None,
        _function_option(metavar="1,A1,...", help="Denominator coefficients of z^0, z^-1, ..., with the leading 1."),
    ] = None
    delay_s: Annotated[
        float | None,
        _function_option(help="Delay of the force after the stamped command; may be negative."),
    ] = None


@flat
def identify(
    *,
    runs: Words = None,
    inputs: SineInputs,
    fit: FitOptions,
    rig: RigOptions,
    delivery: Delivery,
    preset: Preset = None,
    compare: Compare = None,
    method: Method = "default",
) -> None:
    """Identify thrust over command: gain, time constant and delay, from sines of many frequencies (section 3.4).

    H(z) is given in z^-1 with the denominator's leading 1. The delay is relative to the timestamps of the reports.

    Example: [bold]cfid tf identify 2026-11-21_083012_sine_l1 2026-11-21_083030_sine_l2 ...[/bold]
    """
    from cfid import transfer
    from cfid.transfer.thesis import settings_of

    workplace = open_workplace(rig)
    sines = inputs.read(runs, workplace)
    identified = transfer.fit(
        sines,
        sign=inputs.sign,
        shape=fit.shape,
        settle_s=fit.settle_s,
        cutoff_hz=fit.cutoff_hz,
        settings=partial(settings_of, preset=preset),
        thrust_poly=_thrust_poly(workplace),
        compare=compare,
        method=method,
    )
    deliver(replace(identified, folder=workplace.figures), delivery, workplace.campaign, workplace.own_rig)


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
    known, used = _function(function, workplace)
    if not runs and inputs.index is None:
        raise ConfigError("nothing to verify with: give a RUN that was left out of the fit, or --index FILE.")
    sines = inputs.read(runs, workplace, excluded=True)
    verified = transfer.verify(sines, known, used=used, sign=inputs.sign, settle_s=settle_s)
    deliver(replace(verified, folder=workplace.figures), delivery, workplace.campaign, workplace.own_rig)


def _function(options: FunctionOptions, workplace: Workplace) -> tuple["TransferFunction", frozenset[str]]:
    """Return the function of the options, else that of the campaign, and the sha256 of the files it was made from.

    Raises ConfigError if either is incomplete.
    """
    from cfid.transfer.model import TransferFunction

    if options.numerator is not None and options.denominator is not None:
        numerator = comma_list(options.numerator, "--numerator", float, example=_EXAMPLE)
        denominator = comma_list(options.denominator, "--denominator", float, example=_EXAMPLE)
        return TransferFunction.of_coefficients(numerator, denominator, delay_s=options.delay_s or 0.0), frozenset()
    if options.numerator is not None or options.denominator is not None:
        raise ConfigError("--numerator and --denominator belong together: give both, or none for the campaign's.")
    if workplace.campaign is None:
        raise ConfigError("no campaign here that has a transfer function: give --numerator, --denominator, --delay-s.")
    values = workplace.campaign.values()
    found = values.find("tf.time_constant_s") or values.find("tf.numerator")
    if found is None:
        raise ConfigError("this campaign has no transfer function yet: run `cfid tf identify`, or give --numerator ...")
    try:
        function = TransferFunction.of_quantities(found.section.parameters, delay_s=options.delay_s)
    except DataError as error:
        raise DataError(f"{found.fit.stem}: {error}") from None
    return function, frozenset(source.sha256 for source in found.section.sources)


@dataclass(frozen=True, kw_only=True)
class SineOptions:
    """Eq. 3.6: u[n] = A cos(2 pi l n/N) + 30000."""

    l: Annotated[  # noqa: E741 - the letter of the equation and of the option
        str | None,
        _sine_option(
            "--periods",
            "--l",
            metavar="L,L,...",
            help="Periods within N samples, one run each; default: those of --plan.",
        ),
    ] = None
    plan: Annotated[
        Literal["log", "thesis-first", "thesis-second"],
        _sine_option(
            help="log: about twenty sines up to 12.5 Hz; thesis-...: a series of table 3.1 with its N, A and motor "
            "(most values of l are reconstructed)."
        ),
    ] = _USUAL_PLAN
    n: Annotated[
        int | None,
        _sine_option(
            "--samples", "--n", min=1, max=_LARGEST_N, help="N, the number of samples at 500 Hz; default: 4000."
        ),
    ] = None
    amplitude: Annotated[
        int | None,
        _sine_option(min=1, max=FULL_COMMAND, help="A, the amplitude in units of the command; default: 20000."),
    ] = None
    motor: Annotated[
        list[str] | None,
        _sine_option(
            metavar="1,3", help="Motors to use one after the other, separated by commas; 0 is all at once; default: 1."
        ),
    ] = None
    series: Annotated[str | None, _sine_option(help="Name of the series, kept with each run.")] = None
    before: Annotated[
        float,
        _sine_option(metavar="S", help="Seconds of baseline before each sine, for the bias."),
    ] = 1.0
    force: Annotated[bool, _sine_option("--force", help="Allow an amplitude that clips.")] = False
    dry_run: DryRun = False

    def chosen(self, resumed: "SineSweep | None" = None) -> "SineSweep":
        """Return the sines to play, checked as in C.2.4; a resumed run keeps its N, A, motor and series.

        It also keeps the l of its series unless others are given. Raises ConfigError.
        """
        planned = self._named() if self.l is not None else self._planned()
        options: dict[str, Any] = {
            "samples": self.n,
            "amplitude": self.amplitude,
            "motors": None if self.motor is None else motors_of(self.motor, (), least=0),
            "series": self.series,
        }
        given = {name: value for name, value in options.items() if value is not None}
        if resumed is None:
            chosen = replace(planned, **given)
        else:
            for name, value in given.items():
                if value != getattr(resumed, name):
                    option, has = ("motor", resumed.motors[0]) if name == "motors" else (name, getattr(resumed, name))
                    raise ConfigError(f"--{option}: the run to resume has {has}: leave the option out.")
            series_known = self.l is None and self.plan == _USUAL_PLAN and len(resumed.periods) > 1
            chosen = resumed if series_known else replace(resumed, periods=planned.periods, text=planned.text)
        for l in chosen.periods:  # noqa: E741
            if not 0 <= l <= chosen.samples // 2:
                raise ConfigError(f"--periods {l}: has to be from 0 to N/2 = {chosen.samples // 2}.")
        if chosen.amplitude > MIDDLE and not self.force:
            raise ConfigError(f"--amplitude {chosen.amplitude}: above {MIDDLE} the sine is clipped; --force allows it.")
        return chosen

    def _planned(self) -> "SineSweep":
        from cfid.transfer.plan import THESIS_FIRST, THESIS_SECOND, log_spaced

        if self.plan == _USUAL_PLAN:
            return log_spaced(self.n or _USUAL_N)
        return THESIS_FIRST if self.plan == "thesis-first" else THESIS_SECOND

    def _named(self) -> "SineSweep":
        from cfid.transfer.plan import SineSweep

        assert self.l is not None
        if self.plan != _USUAL_PLAN:
            raise ConfigError(f"--periods and --plan {self.plan}: give one of them.")
        periods = comma_list(self.l, "--periods", int, least=0, example="1,2,4")
        if len(set(periods)) < len(periods):
            raise ConfigError(f"--periods {self.l}: names a frequency twice.")
        return SineSweep(periods=periods, samples=_USUAL_N)


def seconds_of_each(sweep: "SineSweep", *, before_s: float) -> float:
    """Return the duration of each sine, with a baseline of `before_s` seconds."""
    return sweep.samples / SAMPLES_PER_S + before_s + _EXTRA_S


def _series_of(word: Path, campaign: "Campaign") -> "SineSweep":
    """Return the series of a run of `cfid log sine`. Raises ConfigError for a run of something else."""
    from cfid.records.run import read_run
    from cfid.transfer.plan import SineSweep

    run = read_run(interrupted(word, campaign, kind="sine"))
    if run.header.family != "sine":
        raise ConfigError(f"{run.folder}: is no run of `cfid log sine` that could be resumed.")
    return SineSweep.of_run(run)


@flat
def sine(
    *,
    options: SineOptions,
    resume: ResumeOptions,
    vehicle: ExperimentOptions,
    log_ms: LogMs = 10,
    keep: KeepOptions,
    note: Note = None,
    rate_hz: CellRateHz = None,
) -> None:
    """Play sines on board, one after the other, and record load cell and crossings; Ctrl-C stops the motors.

    The duration is printed before the first motor turns.

    Example: [bold]cfid log sine --periods 1,2,4,8,16,32 --samples 4000 --amplitude 20000 --motor 1[/bold]
    """
    from cfid.transfer.plan import above_cutoff, missing_sines
    from cfid.transfer.record import record_sines
    from cfid.version import __version__

    before_s = positive(options.before, "--before", most=_MOST_BEFORE_S)
    if resume.word is None:
        sweep = options.chosen()  # invalid options are refused before the search for devices
    rig = rig_of(keep.campaign)
    campaign, simulated = rig.campaign, rig.simulated
    if resume.word is not None:
        sweep = options.chosen(None if resume.run is None else _series_of(resume.run, campaign))
    recorded = campaign.runs(complete=False)
    sines = sweep.sines if resume.word is None else missing_sines(sweep, recorded, simulated=simulated)
    if not sines:
        raise ConfigError("--resume: nothing is left to record: the campaign has every sine of the series.")
    periods = [own.periods for own in sines]
    each_s = seconds_of_each(sweep, before_s=before_s)
    where = f" on motors {', '.join(map(str, sweep.motors))} in turn" if len(sweep.motors) > 1 else ""
    lasts = f"{counted(len(sines), 'sine')} of {each_s:.0f} s{where}: {clock(len(sines) * each_s)} min"
    if above := above_cutoff(sines):
        speech.note(f"{above}: `cfid tf identify` leaves such sines out unless --cutoff-hz is raised.")
    if sweep.text:
        speech.note(f"l = {', '.join(map(str, dict.fromkeys(periods)))}: {sweep.text}")
    if options.dry_run:
        echo(lasts)
        return
    speech.note(lasts)
    runs, failure = record_sines(
        sines,
        rig,
        planned=sweep.periods,
        before_s=before_s,
        each_s=each_s,
        vehicle=vehicle,
        log_ms=log_ms,
        rate_hz=rate_hz,
        note=note,
        quiet=keep.quiet,
        judge=later("cfid.transfer.record", "verdict"),
        show=lambda own, run: None if keep.json else echo(_sine_line(own, run)),
    )
    if keep.json:
        print_json({"command": "log sine", "runs": runs, "wanted": periods, "version": __version__})
    elif runs and runs[-1]["stopped_in_s"] is not None:
        result(stop_line(runs[-1]["stopped_in_s"]))
    if failure is not None:
        raise failure


def _sine_line(sine: "Sine", run: "Run") -> str:
    lines = (
        fitted(f"l = {sine.periods}: {run.header.state} -> {run.folder}", indent=2),
        fitted(f"  {printable(verdict_line(run))}", indent=2),
    )
    return "\n".join(line for line in lines if line.strip())
