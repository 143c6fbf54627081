"""Provide `cfid log sine`: sines of many frequencies played on board, each a run of its own (section 3.4.2)."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.console import messages as speech
from cfid.console.flat import flat
from cfid.console.labels import Note
from cfid.console.lists import comma_list
from cfid.console.log_summary import print_json, stop_line
from cfid.console.messages import clock, echo, fitted, printable, result
from cfid.console.options import positive
from cfid.console.recording import KeepOptions, ResumeOptions, rig_of
from cfid.console.selection import interrupted
from cfid.console.vehicle import ExperimentOptions, LogMs, motors_of
from cfid.console.verdicts import verdict_line
from cfid.counted import counted
from cfid.errors import ConfigError
from cfid.lazy import later
from cfid.units import FULL_COMMAND
from cfid.wire.app import MIDDLE, SAMPLES_PER_S

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign
    from cfid.records.run import Run
    from cfid.transfer.sines.plan import Sine, SineSweep

_SINE = "Sine"
_LARGEST_N = 2**32 - 1
_USUAL_N = 4000
_USUAL_PLAN: Literal["log"] = "log"
_MOST_BEFORE_S = 600.0
# Added to each run: connecting to the load cell, and the second until the vehicle reports the end.
_EXTRA_S = 2.5


@dataclass(frozen=True, kw_only=True)
class SineOptions:
    """Eq. 3.6: u[n] = A cos(2 pi l n/N) + 30000."""

    l: Annotated[  # noqa: E741 - the letter of the equation and of the option
        str | None,
        typer.Option(
            "--periods",
            "--l",
            metavar="L,L,...",
            help="Periods within N samples, one run each; default: those of --plan.",
            rich_help_panel=_SINE,
        ),
    ] = None
    plan: Annotated[
        Literal["log", "thesis-first", "thesis-second"],
        typer.Option(
            help="log: about twenty sines up to 12.5 Hz; thesis-...: a series of table 3.1 with its N, A and motor "
            "(most values of l are reconstructed).",
            rich_help_panel=_SINE,
        ),
    ] = _USUAL_PLAN
    n: Annotated[
        int | None,
        typer.Option(
            "--samples",
            "--n",
            min=1,
            max=_LARGEST_N,
            help="N, the number of samples at 500 Hz; default: 4000.",
            rich_help_panel=_SINE,
        ),
    ] = None
    amplitude: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=FULL_COMMAND,
            help="A, the amplitude in units of the command; default: 20000.",
            rich_help_panel=_SINE,
        ),
    ] = None
    motor: Annotated[
        list[str] | None,
        typer.Option(
            metavar="1,3",
            help="Motors to use one after the other, separated by commas; 0 is all at once; default: 1.",
            rich_help_panel=_SINE,
        ),
    ] = None
    series: Annotated[
        str | None, typer.Option(help="Name of the series, kept with each run.", rich_help_panel=_SINE)
    ] = None
    before: Annotated[
        float,
        typer.Option(metavar="S", help="Seconds of baseline before each sine, for the bias.", rich_help_panel=_SINE),
    ] = 1.0
    force: Annotated[bool, typer.Option("--force", help="Allow an amplitude that clips.", rich_help_panel=_SINE)] = (
        False
    )
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Print what would be done and how long it would take.", rich_help_panel=_SINE),
    ] = False

    def chosen(self, resumed: "SineSweep | None" = None) -> "SineSweep":
        """Return the sines to play, checked as in C.2.4; a resumed run keeps its N, A, motor and series.

        It also keeps the l of its series unless others are given. Raises ConfigError.
        """
        planned = self._named() if self.l is not None else self._planned()
        if resumed is not None and self.l is None and self.plan == _USUAL_PLAN and len(resumed.periods) > 1:
            planned = resumed
        given: dict[str, Any] = {
            "samples": self.n,
            "amplitude": self.amplitude,
            "motors": None if self.motor is None else motors_of(self.motor, (), least=0),
            "series": self.series,
        }
        if resumed is not None:
            given = _held(given, resumed)
        chosen = replace(planned, **{name: value for name, value in given.items() if value is not None})
        for l in chosen.periods:  # noqa: E741
            if not 0 <= l <= chosen.samples // 2:
                raise ConfigError(f"--periods {l}: has to be from 0 to N/2 = {chosen.samples // 2}.")
        if chosen.amplitude > MIDDLE and not self.force:
            raise ConfigError(f"--amplitude {chosen.amplitude}: above {MIDDLE} the sine is clipped; --force allows it.")
        return chosen

    def _planned(self) -> "SineSweep":
        from cfid.transfer.sines.plan import THESIS_FIRST, THESIS_SECOND, log_spaced

        if self.plan == _USUAL_PLAN:
            return log_spaced(self.n or _USUAL_N)
        return THESIS_FIRST if self.plan == "thesis-first" else THESIS_SECOND

    def _named(self) -> "SineSweep":
        from cfid.transfer.sines.plan import SineSweep

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


def _held(given: Mapping[str, Any], resumed: "SineSweep") -> dict[str, Any]:
    """Return N, A, motor and series of the run to resume. Raises ConfigError where a different one is given."""
    own = {
        "samples": resumed.samples,
        "amplitude": resumed.amplitude,
        "motors": resumed.motors,
        "series": resumed.series,
    }
    for name, value in given.items():
        if value is not None and value != own[name]:
            option, has = ("motor", resumed.motors[0]) if name == "motors" else (name, own[name])
            raise ConfigError(f"--{option}: the run to resume has {has}: leave the option out.")
    return own


def _series_of(word: Path, campaign: "Campaign") -> "SineSweep":
    """Return the series of a run of `cfid log sine`. Raises ConfigError for a run of something else."""
    from cfid.records.run import read_run
    from cfid.transfer.sines.plan import SineSweep

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
    rate_hz: Annotated[
        int | None, typer.Option(min=1, help="Load-cell samples per second; default: rig.toml's.")
    ] = None,
) -> None:
    """Play sines on board, one after the other, and record load cell and crossings; Ctrl-C stops the motors.

    The duration is printed before the first motor turns.

    Example: [bold]cfid log sine --periods 1,2,4,8,16,32 --samples 4000 --amplitude 20000 --motor 1[/bold]
    """
    from cfid.transfer.sines.plan import above_cutoff, missing_sines
    from cfid.transfer.sines.record import record_sines
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
        judge=later("cfid.transfer.sines.verdict", "verdict"),
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
