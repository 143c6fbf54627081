"""Provide `cfid log sine`, `cfid tf identify` and `cfid tf verify`: sines, their transfer function, and its check."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.labels import Note
from cfid.console.lists import comma_list, measured
from cfid.console.messages import clock, echo, fitted, print_json, printable, result
from cfid.console.messages import note as print_note
from cfid.console.options import Figures, Force, Geometry, Method, Out, YawDeg, finite, positive
from cfid.console.outcome import Delivery, deliver
from cfid.console.program import program
from cfid.console.recording import DryRun, Resume, ResumedRun, rehearse, rig_of, run_to_resume
from cfid.console.run_summary import stop_line, verdict_line
from cfid.console.selection import chosen, interrupted
from cfid.console.vehicle import CellRateHz, NoPreflight, Uri, motors_of
from cfid.counted import counted
from cfid.errors import ConfigError, DataError
from cfid.lazy import later
from cfid.records.run import read_run
from cfid.transfer.data import read_sines
from cfid.transfer.model import TransferFunction
from cfid.transfer.plan import THESIS_FIRST, THESIS_SECOND, SineSweep, above_cutoff, log_spaced, missing_sines
from cfid.units import FULL_COMMAND, MM
from cfid.version import __version__
from cfid.wire.app import MIDDLE, SAMPLES_PER_S

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign
    from cfid.records.run import Run
    from cfid.transfer.data import SineSet
    from cfid.transfer.model import TransferFunction
    from cfid.transfer.plan import Sine, SineSweep

_LONGEST_S = 600.0  # of a sine: longer than any battery lasts
_USUAL_N = 4000
_ROUNDING = 0.01  # of the distance between two frequencies: those that are typed are rounded
_USUAL_PLAN: Literal["log"] = "log"
_PLANS = {"thesis-first": THESIS_FIRST, "thesis-second": THESIS_SECOND}
_BEFORE_S = 1.0  # of baseline before each sine, for the bias
# Added to each run: connecting to the load cell, and the second until the vehicle reports the end.
_EXTRA_S = 2.5

Words = Annotated[
    list[str] | None, typer.Argument(metavar="RUN ...", help="Runs of cfid log sine; default: all complete ones.")
]
Plan = Literal["log", "thesis-first", "thesis-second"]
Index = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="CSV file with a row per run: l, n, amplitude, motor, loadcell, crossings, optionally series. A loadcell "
        "is a run, or a file beside the index whose columns name their units.",
    ),
]
Channel = Annotated[
    Literal["arm", "Tx", "Ty", "Fz"],
    typer.Option(help="Torque about the motor's arm, x or y, or force."),
]
Sign = Annotated[
    Literal["auto", "+", "-"],
    typer.Option(help="Sign of thrust in the channel."),
]
ArmMm = Annotated[
    str | None,
    typer.Option(
        metavar="MM[:STD]",
        help="From the load cell's z axis to the motor's; default: the run's, else rig.toml's.",
    ),
]
Offset = Annotated[
    float, typer.Option(min=0, max=FULL_COMMAND, metavar="C", help="B of eq. 3.6, offset of the command, for files.")
]


def identify(
    runs: Words = None,
    *,
    index: Index = None,
    channel: Channel = "arm",
    sign: Sign = "auto",
    arm_mm: ArmMm = None,
    yaw_deg: YawDeg = None,
    offset: Offset = 30000.0,
    shape: Annotated[
        Literal["first", "first+delay", "second", "zero", "auto"],
        typer.Option(
            metavar="MODEL", help="Lags and delay: first, first+delay, second, zero; or auto, by corrected AIC."
        ),
    ] = "first+delay",
    geometry: Geometry = None,
    method: Method = "default",
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Identify thrust over command: gain, time constant and delay, from sines of many frequencies (section 3.4).

    H(z) is given in z^-1 with the denominator's leading 1. The delay is relative to the timestamps of the reports.

    Example: cfid tf identify --shape second
    """
    from cfid import transfer

    workplace = open_workplace(geometry)
    words = [] if index is not None and not runs else _chosen(runs, workplace)
    sines = _read(words, workplace, index, channel=channel, arm_mm=arm_mm, yaw_deg=yaw_deg, offset=offset)
    identified = transfer.fit(
        sines,
        sign=sign,
        shape=shape,
        thrust_poly=_thrust_poly(workplace),
        method=method,
    )
    deliver(identified, Delivery(force, figures, out), workplace)


def _chosen(words: Sequence[str] | None, workplace: Workplace, *, excluded: bool = False) -> list[str]:
    """Return the sine runs of these words, with a glob also those `excluded`; without words, all complete ones."""
    if not words and workplace.campaign is None:
        raise ConfigError("no sine to read: give RUNs of `cfid log sine`, or --index FILE.")
    return chosen(
        words,
        workplace.campaign,
        suits=lambda run: run.header.family == "sine",
        wanted="sines",
        excluded=excluded,
    )


def _read(
    words: Sequence[str],
    workplace: Workplace,
    index: Path | None,
    *,
    channel: Literal["arm", "Tx", "Ty", "Fz"],
    arm_mm: str | None,
    yaw_deg: float | None,
    offset: float,
) -> "SineSet":
    """Read the index and the runs. Raises ConfigError and DataError."""
    arm = measured(arm_mm, "--arm-mm")
    return read_sines(
        [find_recording(word, workplace) for word in words],
        index=index,
        channel=channel,
        arm_m=None if arm.value is None else MM * arm.value,
        arm_std_m=None if arm.std is None else MM * arm.std,
        yaw_deg=None if yaw_deg is None else finite(yaw_deg, "--yaw-deg"),
        facts=workplace.facts,
        middle=offset,
    )


def _thrust_poly(workplace: Workplace) -> list[float] | None:
    """Return the campaign's thrust over command, if it has been fitted."""
    if workplace.campaign is None:
        return None
    found = workplace.campaign.values().find("motor.thrust_poly")
    return None if found is None else list(found.parameter.value)


def verify(
    runs: Annotated[
        list[str] | None, typer.Argument(metavar="RUN ...", help="Runs that were left out of the fit.")
    ] = None,
    *,
    index: Index = None,
    channel: Channel = "arm",
    sign: Sign = "auto",
    arm_mm: ArmMm = None,
    yaw_deg: YawDeg = None,
    offset: Offset = 30000.0,
    geometry: Geometry = None,
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Simulate the campaign's transfer function against runs that were left out of its fit.

    Example: cfid tf verify 2026-11-21_083012_sine_l12
    """
    from cfid import transfer

    workplace = open_workplace(geometry)
    function, used = _function(workplace)
    if not runs and index is None:
        raise ConfigError("nothing to verify with: give a RUN that was left out of the fit, or --index FILE.")
    words = _chosen(runs, workplace, excluded=True) if runs else []
    sines = _read(words, workplace, index, channel=channel, arm_mm=arm_mm, yaw_deg=yaw_deg, offset=offset)
    verified = transfer.verify(sines, function, used=used, sign=sign)
    deliver(verified, Delivery(force, figures, out), workplace)


def _function(workplace: Workplace) -> tuple["TransferFunction", frozenset[str]]:
    """Return the campaign's function, and the sha256 of the files it was made from.

    Raises ConfigError where there is none, DataError where it is incomplete.
    """
    if workplace.campaign is None:
        raise ConfigError("no campaign here that has a transfer function: run `cfid tf identify` in one first.")
    values = workplace.campaign.values()
    found = values.find("tf.time_constant_s") or values.find("tf.numerator")
    if found is None:
        raise ConfigError("this campaign has no transfer function yet: run `cfid tf identify` first.")
    try:
        function = TransferFunction.of_quantities(found.section.parameters)
    except DataError as error:
        raise DataError(f"{found.fit.stem}: {error}") from None
    return function, frozenset(source.sha256 for source in found.section.sources)


@dataclass(frozen=True, kw_only=True)
class SineChoice:
    """The options of the sines u[n] = A cos(2 pi l n/N) + 30000 (eq. 3.6), as given; None for the usual ones."""

    hz: str | None = None
    plan: Plan = _USUAL_PLAN
    for_s: float | None = None
    amplitude: int | None = None
    motor: list[str] | None = None
    force: bool = False

    def chosen(self, resumed: "SineSweep | None" = None) -> "SineSweep":
        """Return the sines to play, checked as in C.2.4; a resumed run keeps its duration, A and motor.

        It also keeps the frequencies of its series unless others are given. Raises ConfigError.
        """
        samples = None if self.for_s is None else round(SAMPLES_PER_S * positive(self.for_s, "--for", most=_LONGEST_S))
        options: dict[str, Any] = {
            "samples": samples,
            "amplitude": self.amplitude,
            "motors": None if self.motor is None else motors_of(self.motor, (), least=0),
        }
        given = {name: value for name, value in options.items() if value is not None}
        for name, value in {} if resumed is None else given.items():
            if value != getattr(resumed, name):
                option = {"samples": "for", "motors": "motor"}.get(name, name)
                raise ConfigError(f"--{option}: the run to resume has another one: leave the option out.")
        if self.hz is not None:
            usual = SineSweep(periods=(), samples=samples or _USUAL_N) if resumed is None else resumed
            sweep = replace(usual, periods=self._periods(self.hz, usual.samples), text="")
        elif resumed is not None and self.plan == _USUAL_PLAN and len(resumed.periods) > 1:
            sweep = resumed
        else:
            planned = _PLANS[self.plan] if self.plan in _PLANS else log_spaced(samples or _USUAL_N)
            sweep = planned if resumed is None else replace(resumed, periods=planned.periods, text=planned.text)
        sweep = replace(sweep, **given)
        if sweep.amplitude > MIDDLE and not self.force:
            raise ConfigError(f"--amplitude {sweep.amplitude}: above {MIDDLE} the sine is clipped; --force allows it.")
        return sweep

    def _periods(self, hz: str, samples: int) -> tuple[int, ...]:
        """Return the l of frequencies, of which N samples hold whole periods. Raises ConfigError."""
        if self.plan != _USUAL_PLAN:
            raise ConfigError(f"--hz and --plan {self.plan}: give one of them.")
        frequencies = comma_list(hz, "--hz", float, least=0, most=SAMPLES_PER_S / 2, example="0.5,1,2.5")
        step_hz = SAMPLES_PER_S / samples
        for frequency in frequencies:
            below = math.floor(frequency / step_hz) * step_hz
            if abs(frequency - round(frequency / step_hz) * step_hz) > _ROUNDING * step_hz:
                raise ConfigError(
                    f"--hz {frequency:g}: {samples / SAMPLES_PER_S:g} s hold no whole periods of it: take "
                    f"{below:g} or {below + step_hz:g}, or another --for."
                )
        periods = tuple(round(frequency / step_hz) for frequency in frequencies)
        if len(set(periods)) < len(periods):
            raise ConfigError(f"--hz {hz}: names a frequency twice.")
        return periods


USUAL_SINES = SineChoice()


def seconds_of_each(sweep: "SineSweep") -> float:
    """Return the duration of each sine, with its baseline."""
    return sweep.samples / SAMPLES_PER_S + _BEFORE_S + _EXTRA_S


def _series_of(word: Path, campaign: "Campaign") -> "SineSweep":
    """Return the series of a run of `cfid log sine`. Raises ConfigError for a run of something else."""
    run = read_run(interrupted(word, campaign, kind="sine"))
    if run.header.family != "sine":
        raise ConfigError(f"{run.folder}: is no run of `cfid log sine` that could be resumed.")
    return SineSweep.of_run(run)


def sine(
    run: ResumedRun = None,
    *,
    hz: Annotated[
        str | None,
        typer.Option(metavar="HZ,HZ,...", help="Frequencies, one run each; default: those of --plan."),
    ] = None,
    plan: Annotated[
        Plan,
        typer.Option(
            metavar="PLAN",
            help="log: twenty sines up to 12.5 Hz; thesis-first, thesis-second: a series of table 3.1, with its "
            "duration, A and motor.",
        ),
    ] = _USUAL_PLAN,
    for_s: Annotated[float | None, typer.Option("--for", metavar="S", help="Seconds of each sine; default: 8.")] = None,
    amplitude: Annotated[
        int | None,
        typer.Option(min=1, max=FULL_COMMAND, metavar="C", help="A, amplitude of the command; default: 20000."),
    ] = None,
    motor: Annotated[
        list[str] | None,
        typer.Option(metavar="1,3", help="Motors, one after the other; 0 is all; default: 1."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Allow an amplitude that clips.")] = False,
    rate_hz: CellRateHz = None,
    resume: Resume = False,
    uri: Uri = None,
    no_preflight: NoPreflight = False,
    dry_run: DryRun = False,
    note: Note = None,
) -> None:
    """Play sines on board, one after the other, and record load cell and crossings; Ctrl-C stops the motors.

    The duration is printed before the first motor turns.

    Example: cfid log sine --hz 0.25,0.5,1,2,4,8 --amplitude 20000 --motor 1
    """
    from cfid.transfer.record import record_sines

    choice = SineChoice(hz=hz, plan=plan, for_s=for_s, amplitude=amplitude, motor=motor, force=force)
    word = run_to_resume(run, resume=resume)
    if word is None:
        sweep = choice.chosen()  # invalid options are refused before the search for devices
    rig = rig_of()
    campaign, simulated = rig.campaign, rig.simulated
    if word is not None:
        by_plan = run is None and choice.plan != _USUAL_PLAN  # all that is missing of the plan, of whatever run
        sweep = choice.chosen(None if by_plan else _series_of(word, campaign))
    recorded = campaign.runs(complete=False)
    sines = sweep.sines if word is None else missing_sines(sweep, recorded, simulated=simulated)
    if not sines:
        raise ConfigError("--resume: nothing is left to record: the campaign has every sine of the series.")
    wanted = [own.periods for own in sines]
    each_s = seconds_of_each(sweep)
    where = f" on motors {', '.join(map(str, sweep.motors))} in turn" if len(sweep.motors) > 1 else ""
    lasts = f"{counted(len(sines), 'sine')} of {each_s:.0f} s{where}: {clock(len(sines) * each_s)} min"
    if above := above_cutoff(sines):
        print_note(f"{above}: `cfid tf identify` leaves such sines out.")
    if sweep.text:
        frequencies = ", ".join(dict.fromkeys(f"{own.hz:g}" for own in sines))
        print_note(f"{frequencies} Hz: {sweep.text}")
    if dry_run:
        facts = {"hz": [own.hz for own in sines], "motors": sweep.motors, "amplitude": sweep.amplitude}
        rehearse("log sine", [lasts], **facts, lasts_s=len(sines) * each_s)
        return
    print_note(lasts)
    json = program().json
    runs, failure = record_sines(
        sines,
        rig,
        planned=sweep.periods,
        before_s=_BEFORE_S,
        each_s=each_s,
        uri=uri,
        preflight=not no_preflight,
        rate_hz=rate_hz,
        note=note,
        judge=later("cfid.transfer.record", "verdict"),
        show=lambda own, recorded_run: None if json else echo(_sine_line(own, recorded_run)),
    )
    if json:
        print_json({"command": "log sine", "runs": runs, "wanted": wanted, "version": __version__})
    elif runs and runs[-1]["stopped_in_s"] is not None:
        result(stop_line(runs[-1]["stopped_in_s"]))
    if failure is not None:
        raise failure


def _sine_line(sine: "Sine", run: "Run") -> str:
    header = run.header
    state = ", ".join(filter(None, [header.state, header.reason if header.state == "interrupted" else ""]))
    lines = (
        fitted(f"{sine.hz:g} Hz: {state} -> {run.folder}", indent=2),
        fitted(f"  {printable(verdict_line(run))}", indent=2),
    )
    return "\n".join(line for line in lines if line.strip())
