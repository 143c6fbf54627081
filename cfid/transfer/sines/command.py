"""`cfid log sine`: sines of many frequencies played on board, each a run of its own (section 3.4.2)."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid import __version__
from cfid.console import messages as speech
from cfid.console.lists import comma_list
from cfid.console.live import LiveLine
from cfid.console.options import flat, positive
from cfid.console.recording import KeepOptions, ResumeOptions, attempt, print_json, rig_of, summary
from cfid.console.vehicle import LogMs, VehicleOptions, confirm, reach
from cfid.errors import CfidError, ConfigError
from cfid.transfer.sines.plan import THESIS_FIRST, THESIS_SECOND, SineSeries, log_spaced
from cfid.wire.app import LARGEST_COMMAND, MIDDLE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cfid.records.campaign import Campaign, LoadCellBox
    from cfid.records.run import Run
    from cfid.rig.log import Device, Plan

_SINE = "Sine"
_LARGEST_N = 2**32 - 1
_SAMPLES_PER_S = 500
_USUAL_N = 4000
_UNCLIPPED = MIDDLE
_BESIDE_S = 2.5  # of each run: connecting to the load cell, and the second before the vehicle says that it ended


@dataclass(frozen=True, kw_only=True)
class SineOptions:
    """Eq. 3.6: u[n] = A cos(2 pi l n/N) + 30000."""

    l: Annotated[  # noqa: E741 - the letter of the equation and of the option
        str | None,
        typer.Option(
            "--periods",
            "--l",
            metavar="L,L,...",
            help="Periods within N samples, each a run; default: --plan.",
            rich_help_panel=_SINE,
        ),
    ] = None
    plan: Annotated[
        Literal["log", "thesis-first", "thesis-second"],
        typer.Option(
            help="log: some twenty up to 12.5 Hz; thesis-...: table 3.1's series with its N, A and motor, of which "
            "most l had to be reconstructed.",
            rich_help_panel=_SINE,
        ),
    ] = "log"
    n: Annotated[
        int | None,
        typer.Option(
            "--samples", "--n", min=1, max=_LARGEST_N, help="Samples at 500 Hz; default: 4000.", rich_help_panel=_SINE
        ),
    ] = None
    amplitude: Annotated[
        int | None, typer.Option(min=0, max=65535, help="A, in commands; default: 20000.", rich_help_panel=_SINE)
    ] = None
    motor: Annotated[
        int | None, typer.Option(min=0, max=4, help="Which motor, 0 for all; default: 1.", rich_help_panel=_SINE)
    ] = None
    series: Annotated[
        str | None, typer.Option(help="Name of the series, kept with each run.", rich_help_panel=_SINE)
    ] = None
    before: Annotated[
        float, typer.Option(metavar="S", help="Seconds at rest before, for the bias.", rich_help_panel=_SINE)
    ] = 1.0
    force: Annotated[bool, typer.Option("--force", help="Allow an amplitude that clips.", rich_help_panel=_SINE)] = (
        False
    )
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be done and how long it takes.", rich_help_panel=_SINE)
    ] = False

    def chosen(self, resumed: Mapping[str, Any]) -> SineSeries:
        """Return the sines to play, checked as C.2.4 checks them; a resumed run's N, A, motor and series hold.

        Raises ConfigError.
        """
        planned = self._named() if self.l is not None else self._planned()
        given: dict[str, Any] = {
            "samples": self.n,
            "amplitude": self.amplitude,
            "motor": self.motor,
            "series": self.series,
        }
        known = {name: resumed.get(key) for name, key in zip(given, ("n", "amplitude", "motor", "series"), strict=True)}
        for name, value in given.items():
            if resumed and value is not None and value != known[name]:
                raise ConfigError(f"--{name} {value}: the run to resume has {known[name]}: leave the option out.")
        given = known if resumed else given
        chosen = replace(planned, **{name: value for name, value in given.items() if value is not None})
        for l in chosen.periods:  # noqa: E741
            if not 0 <= l <= chosen.samples // 2:
                raise ConfigError(f"--periods {l}: has to be from 0 to N/2 = {chosen.samples // 2}.")
        if chosen.amplitude > _UNCLIPPED and not self.force:
            raise ConfigError(
                f"--amplitude {chosen.amplitude}: above {_UNCLIPPED} the sine is clipped; --force allows it."
            )
        return chosen

    def _planned(self) -> SineSeries:
        if self.plan == "log":
            return log_spaced(self.n or _USUAL_N)
        return THESIS_FIRST if self.plan == "thesis-first" else THESIS_SECOND

    def _named(self) -> SineSeries:
        assert self.l is not None
        if self.plan != "log":
            raise ConfigError(f"--periods and --plan {self.plan}: say one of them.")
        periods = comma_list(self.l, "--periods", int, least=0, example="1,2,4")
        if len(set(periods)) < len(periods):
            raise ConfigError(f"--periods {self.l}: names a frequency twice.")
        return SineSeries(periods=periods, samples=_USUAL_N)


def _asked(sines: SineSeries, l: int) -> dict[str, Any]:  # noqa: E741
    """Return what run.toml says of one sine, by which --resume knows it again."""
    series = {} if sines.series is None else {"series": sines.series}
    return {"l": l, "n": sines.samples, "amplitude": sines.amplitude, "motor": sines.motor, **series}


def _asked_of(word: Path, campaign: "Campaign") -> Mapping[str, Any]:
    """Return what a run of `cfid log sine` was asked. Raises ConfigError for a run of something else."""
    from cfid.motors.resume import interrupted
    from cfid.records.run import read_run

    run = read_run(interrupted(word, campaign, kind="sine"))
    if not run.header.kind.startswith("sine"):
        raise ConfigError(f"{run.folder}: is no run of `cfid log sine` that could be resumed.")
    return run.header.asked


@flat
def sine(
    *,
    options: SineOptions,
    resume: ResumeOptions,
    vehicle: VehicleOptions,
    log_ms: LogMs = 10,
    keep: KeepOptions,
    note: Annotated[str | None, typer.Option(help="A note, kept with each run.")] = None,
    rate_hz: Annotated[int | None, typer.Option(min=1, help="Load cell's rate; default: rig.toml's.")] = None,
) -> None:
    """Play sines on board, one after the other, and record load cell and crossings; Ctrl-C stops the motors.

    How long that takes is said before the first motor turns.

    Example: [bold]cfid log sine --periods 1,2,4,8,16,32 --samples 4000 --amplitude 20000 --motor 1[/bold]
    """
    before_s = positive(options.before, "--before")
    if resume.word is None:
        sines = options.chosen({})  # what cannot be is told before any device is looked for
    campaign, devices, simulated = rig_of(keep.campaign)
    if resume.word is not None:
        sines = options.chosen({} if resume.run is None else _asked_of(resume.run, campaign))
    periods = list(sines.periods) if resume.word is None else _lacking(sines, campaign, simulated=simulated)
    each_s = sines.samples / _SAMPLES_PER_S + before_s + _BESIDE_S
    lasts = f"{len(periods)} sines of {each_s:.0f} s: {len(periods) * each_s / 60:.1f} min"
    if sines.told:
        speech.note(f"l = {', '.join(map(str, periods))}: {sines.told}")
    if options.dry_run:
        typer.echo(lasts)
        return
    speech.note(lasts)
    cell = devices.loadcell.model_copy(update={"rate_hz": rate_hz} if rate_hz else {})
    live = LiveLine()
    with ExitStack() as held:
        crazyflie = reach(vehicle, devices, held, simulated=simulated)
        reports = crazyflie.crossings()  # refuses a vehicle that cannot play before anything is asked of the operator
        motors = (1, 2, 3, 4) if sines.motor == 0 else (sines.motor,)
        swing = (max(MIDDLE - sines.amplitude, 1), min(MIDDLE + sines.amplitude, LARGEST_COMMAND))
        confirm(crazyflie, motors, swing, yes=vehicle.yes)
        runs = []
        for count, l in enumerate(periods):  # noqa: E741
            left_s = (len(periods) - count) * each_s
            run, failure = _play(
                _plan(sines, l, campaign, before_s, live, note=note, simulated=simulated, left_s=left_s),
                [reports, *crazyflie.watch(log_ms)],
                cell,
                live,
            )
            if run is not None:
                runs.append(summary("log sine", run, failure))
                if not keep.json:
                    typer.echo(f"l = {l}: {run.header.state} -> {run.folder}")
            if failure is not None or run is None or run.header.state != "complete":
                break
    if keep.json:
        print_json({"command": "log sine", "runs": runs, "wanted": periods, "version": __version__})
    if failure is not None:
        raise failure


def _plan(
    sines: SineSeries,
    l: int,  # noqa: E741
    campaign: "Campaign",
    before_s: float,
    live: LiveLine,
    *,
    note: str | None,
    simulated: bool,
    left_s: float,
) -> "Plan":
    from cfid.records.run import Label
    from cfid.rig.log import Plan
    from cfid.rig.procedures import clock, play_sine
    from cfid.wire.app import SineRequest, omega_of

    request = SineRequest(sines.motor, sines.amplitude, omega_of(l, sines.samples), sines.samples)

    def tell(text: str) -> None:
        live.task(f"l = {l}: {text} ({clock(left_s)} in all)")

    return Plan(
        runs_folder=campaign.runs_folder,
        kind=f"sine_l{l}",
        label=Label(note=note),
        procedure=lambda there, loop: play_sine(request, there["crossings"], before_s=before_s, loop=loop, tell=tell),
        facts=campaign.rig.facts,
        asked=_asked(sines, l),
        simulated=simulated,
    )


def _play(
    plan: "Plan", vehicle: "Sequence[Device]", cell: "LoadCellBox", live: LiveLine
) -> "tuple[Run | None, CfidError | None]":
    from cfid.rig.log import ready_loadcell

    reports, *others = vehicle
    with ExitStack() as stream:
        try:
            loadcell = ready_loadcell(cell, stream, buffered=True, bias=False, say=live.say, patient=False)
        except CfidError as error:
            return None, error
        return attempt(plan, [reports, loadcell, *others], live)


def _lacking(sines: SineSeries, campaign: "Campaign", *, simulated: bool) -> list[int]:
    """Return the l that the campaign has not completely; simulated runs count for a simulated rig only.

    Raises ConfigError when it has all.
    """
    from cfid.errors import DataError
    from cfid.records.run import list_runs

    runs = [run for run in list_runs(campaign.runs_folder) if not isinstance(run, DataError)]
    same = [run.header for run in runs if run.header.simulated == simulated]
    there = [header.asked for header in same if header.state == "complete"]
    lacking = [l for l in sines.periods if _asked(sines, l) not in there]  # noqa: E741
    if not lacking:
        raise ConfigError("--resume: the campaign has all of them completely.")
    return lacking
