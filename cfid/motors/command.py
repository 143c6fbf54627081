"""`cfid log thrust`, `cfid log speed`, `cfid log scales`: a staircase of commands, with readings at each."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from cfid.console.flat import flat
from cfid.console.labels import Note
from cfid.console.messages import clock, echo, fitted
from cfid.console.options import panel, positive
from cfid.console.recording import DryRun, KeepOptions, ResumeOptions, rig_of
from cfid.console.selection import interrupted
from cfid.console.vehicle import CellRateHz, ExperimentOptions, LogMs, Motor, motors_of
from cfid.counted import counted
from cfid.errors import ConfigError
from cfid.lazy import later
from cfid.units import FULL_COMMAND

if TYPE_CHECKING:
    from cfid.motors.plan import StaircasePlan
    from cfid.records.campaign import Campaign

_staircase_option, _instrument_option = panel("Staircase"), panel("Instrument")

Tachometer = Literal["typed", "ut372", "lines", "deck", "brushless"]

Wait = Annotated[
    float | None,
    _instrument_option(
        metavar="S",
        help="Longest wait for a typed reading while motors run, then they pause until you resume; default: 60 s.",
    ),
]

_SPEED_STEP, _SPEED_HOLD_S, _SPEED_REST_S = 2000, 6.0, 2.0  # a tachometer's display takes seconds to settle
_SCALES_STEP, _SCALES_HOLD_S, _SCALES_REST_S = 4000, 5.0, 3.0  # as in figure 3.9
_SCALES_BAUD = 9600


@dataclass(frozen=True, kw_only=True)
class StaircaseOptions:
    """The commands, and how long each is held."""

    from_: Annotated[int, _staircase_option("--from", min=0, max=FULL_COMMAND, help="First command.")] = 0
    to: Annotated[int, _staircase_option(min=0, max=FULL_COMMAND, help="Last command.")] = 64000
    step: Annotated[
        int | None,
        _staircase_option(min=1, help="Difference between commands; default: as in the thesis."),
    ] = None
    down: Annotated[
        bool,
        _staircase_option("--down", help="Also step down again, to separate the battery's sag."),
    ] = False
    hold: Annotated[float | None, _staircase_option(metavar="S", help="Seconds at each command.")] = None
    rest: Annotated[
        float | None,
        _staircase_option(metavar="S", help="Seconds of pause before, between and after the commands."),
    ] = None
    dry_run: DryRun = False

    def staircase(self, motors: tuple[int, ...], *, step: int, hold_s: float, rest_s: float) -> "StaircasePlan":
        """Return the staircase. Raises ConfigError for one without steps."""
        from cfid.motors.plan import LONGEST_STEP_S, StaircasePlan

        steps = tuple(range(self.from_, self.to + 1, self.step or step))
        if not steps:
            raise ConfigError(f"--from {self.from_} --to {self.to}: there is no command between them.")
        if not any(steps):
            raise ConfigError(
                f"--from {self.from_} --to {self.to} --step {self.step or step}: no motor turns at command 0 alone."
            )
        steps += steps[-2::-1] if self.down else ()
        hold_s = hold_s if self.hold is None else positive(self.hold, "--hold", most=LONGEST_STEP_S)
        rest_s = rest_s if self.rest is None else positive(self.rest, "--rest", most=LONGEST_STEP_S)
        return StaircasePlan(steps=steps, motors=motors, hold_s=hold_s, rest_s=rest_s)


@flat
def thrust(
    *,
    options: StaircaseOptions,
    motor: Motor = None,
    vehicle: ExperimentOptions,
    log_ms: LogMs = 10,
    resume: ResumeOptions,
    keep: KeepOptions,
    note: Note = None,
    rate_hz: CellRateHz = None,
) -> None:
    """Record load cell, commands and battery while the motors run a staircase; Ctrl-C stops them.

    Example: [bold]cfid log thrust --from 0 --to 64000 --step 2000 --motor 1,3[/bold]
    """
    from cfid.motors.record import StaircaseRecording, record_forces

    rig = rig_of(keep.campaign)
    wanted = thrust_staircase(options, motor)
    wanted = _left("thrust", wanted, resume, rig.campaign)
    if options.dry_run:
        announce(wanted)
    else:
        recording = StaircaseRecording(
            kind="thrust",
            staircase=wanted,
            rig=rig,
            vehicle=vehicle,
            log_ms=log_ms,
            keep=keep,
            note=note,
            judge=later("cfid.motors.maps.verdict", "of_forces"),
        )
        record_forces(recording, rate_hz=rate_hz)


@flat
def speed(
    *,
    options: StaircaseOptions,
    tachometer: Annotated[
        Tachometer | None,
        _instrument_option(
            help="Source of the speed: typed by you, a UT372, a device that sends lines, the RPM deck, or brushless "
            "motors; default: typed, or that of the run to resume."
        ),
    ] = None,
    port: Annotated[str | None, _instrument_option(help="Port of the UT372; default: search for it.")] = None,
    wait: Wait = None,
    motor: Motor = None,
    vehicle: ExperimentOptions,
    log_ms: LogMs = 10,
    resume: ResumeOptions,
    keep: KeepOptions,
    note: Note = None,
) -> None:
    """Record rotor speeds while motors run a staircase; Ctrl-C stops them. Enter alone skips a reading.

    Example: [bold]cfid log speed --motor 1[/bold]
    """
    from cfid.motors.record import StaircaseRecording, record_speed

    rig = rig_of(keep.campaign)
    tachometer = tachometer or _tachometer_of(resume, rig.campaign)
    if port is not None and tachometer != "ut372":
        raise ConfigError(f"--port is the UT372's, and --tachometer is {tachometer}.")
    wanted = options.staircase(motors_of(motor, (1,)), step=_SPEED_STEP, hold_s=_SPEED_HOLD_S, rest_s=_SPEED_REST_S)
    wanted = _left("speed", wanted, resume, rig.campaign)
    if options.dry_run:
        announce(wanted)
    else:
        recording = StaircaseRecording(
            kind="speed",
            staircase=wanted,
            rig=rig,
            vehicle=vehicle,
            log_ms=log_ms,
            keep=keep,
            note=note,
            judge=later("cfid.motors.maps.verdict", "of_readings"),
            wait=wait,
        )
        record_speed(recording, tachometer=tachometer, port=port)


@flat
def scales(
    *,
    options: StaircaseOptions,
    port: Annotated[
        str | None,
        _instrument_option(
            help="Serial port of the scales; default: that of the run to resume, else scales in rig.toml that send "
            "lines, else you type the readings."
        ),
    ] = None,
    baud: Annotated[
        int | None,
        _instrument_option(min=1, help="Baud rate of the scales' port; default: 9600, or that of the run to resume."),
    ] = None,
    wait: Wait = None,
    motor: Motor = None,
    vehicle: ExperimentOptions,
    log_ms: LogMs = 10,
    resume: ResumeOptions,
    keep: KeepOptions,
    note: Note = None,
) -> None:
    """Record the readings of scales while motors run a staircase (figure 3.9); Ctrl-C stops the motors.

    Example: [bold]cfid log scales --motor 1,3[/bold]
    """
    from cfid.motors.record import StaircaseRecording, record_scales

    wanted = options.staircase(
        motors_of(motor, (1, 3)), step=_SCALES_STEP, hold_s=_SCALES_HOLD_S, rest_s=_SCALES_REST_S
    )
    rig = rig_of(keep.campaign)
    wanted = _left("scales", wanted, resume, rig.campaign)
    known = _scales_of(resume, rig.campaign)
    if options.dry_run:
        announce(wanted)
    else:
        recording = StaircaseRecording(
            kind="scales",
            staircase=wanted,
            rig=rig,
            vehicle=vehicle,
            log_ms=log_ms,
            keep=keep,
            note=note,
            judge=later("cfid.motors.maps.verdict", "of_readings"),
            wait=wait,
        )
        port, baud = port or known.get("port"), baud or known.get("baud") or _SCALES_BAUD
        record_scales(recording, port=port, baud=baud)


def thrust_staircase(options: StaircaseOptions, motor: list[str] | None = None) -> "StaircasePlan":
    """Return the staircase of `cfid log thrust`. Raises ConfigError for impossible options."""
    return options.staircase(motors_of(motor, (1, 3)), step=2000, hold_s=10.0, rest_s=3.0)


def announce(staircase: "StaircasePlan") -> None:
    """Print what a staircase would do."""
    steps, motors = staircase.steps, ", ".join(map(str, staircase.motors))
    several = "s" * (len(staircase.motors) > 1)
    text = (
        f"{counted(len(steps), 'command')} from {min(steps)} to {max(steps)} on motor{several} {motors}, "
        f"{staircase.hold_s:g} s each with {staircase.rest_s:g} s of pause: {clock(staircase.duration_s)} min"
    )
    echo(fitted(text))


def _tachometer_of(resume: ResumeOptions, campaign: "Campaign") -> Tachometer:
    """Return the instrument of the run to resume, or `typed` for a new run and where that run states none."""
    from cfid.records.run import read_run

    if resume.word is None:
        return "typed"
    stated = read_run(interrupted(resume.word, campaign, kind="speed")).header.requested.get("tachometer")
    return next((one for one in get_args(Tachometer) if one == stated), "typed")


def _scales_of(resume: ResumeOptions, campaign: "Campaign") -> Mapping[str, Any]:
    """Return what the run.toml of the run to resume states about scales at a port; empty where it had none."""
    from cfid.recordings.vehicle import SCALES
    from cfid.records.run import read_run

    if resume.word is None:
        return {}
    record = read_run(interrupted(resume.word, campaign, kind="scales")).header.devices.get(SCALES)
    return {} if record is None else record.model_extra or {}


def _left(kind: str, wanted: "StaircasePlan", resume: ResumeOptions, campaign: "Campaign") -> "StaircasePlan":
    """Return the staircase or, with --resume, the steps that the interrupted run still lacks."""
    if resume.word is None:
        return wanted
    from cfid.motors.plan import missing

    return missing(interrupted(resume.word, campaign, kind=kind), kind=kind)
