"""`cfid log thrust`, `cfid log speed`, `cfid log scales`: a staircase of commands, with readings at each."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from cfid.console.labels import Note
from cfid.console.messages import clock
from cfid.console.options import positive
from cfid.console.recording import DryRun, Resume, ResumedRun, rehearse, rig_of, run_to_resume
from cfid.console.selection import interrupted
from cfid.console.vehicle import CellRateHz, Motor, NoPreflight, Uri, motors_of
from cfid.counted import counted
from cfid.errors import ConfigError
from cfid.lazy import later
from cfid.motors.plan import LONGEST_STEP_S, StaircasePlan, missing
from cfid.recordings.vehicle import SCALES
from cfid.records.run import read_run
from cfid.units import FULL_COMMAND

if TYPE_CHECKING:
    from cfid.motors.plan import StaircasePlan
    from cfid.records.campaign import Campaign


Tachometer = Literal["typed", "ut372", "lines", "deck", "brushless"]

_SCALES_BAUD = 9600
_FORCES_HZ = 1000  # enough for means of steps; a rotor's speed from its vibration takes 7 kHz
# Seconds at a command and in the pause after it: ten time constants of a rotor for a load cell's box; for a device that
# sends some ten lines a second, what its means take.
_SECONDS = {"netft": (1.2, 0.8), "lines": (6.0, 2.0)}


From = Annotated[int, typer.Option("--from", metavar="C", min=0, max=FULL_COMMAND, help="First command.")]
To = Annotated[int, typer.Option("--to", metavar="C", min=0, max=FULL_COMMAND, help="Last command.")]
Step = Annotated[int, typer.Option(metavar="C", min=1, help="Difference between commands.")]
Rest = Annotated[float, typer.Option(metavar="S", help="Seconds of pause around the commands.")]
Hold = Annotated[float, typer.Option(metavar="S", help="Seconds at each command.")]


def staircase_of(
    motors: tuple[int, ...], first: int, last: int, step: int, *, hold_s: float, rest_s: float, twice: bool
) -> "StaircasePlan":
    """Return a staircase that rises and falls, so that a battery that drains does not look like the command's effect.

    It holds each command `twice`, or every other one on its way up and those between on its way down.

    Raises ConfigError for one without steps, and for impossible times.
    """
    steps = tuple(range(first, last + 1, step))
    if not steps:
        raise ConfigError(f"--from {first} --to {last}: there is no command between them.")
    if not any(steps):
        raise ConfigError(f"--from {first} --to {last} --step {step}: no motor turns at command 0 alone.")
    return StaircasePlan(
        steps=steps + steps[-2::-1] if twice else steps[::2] + steps[1::2][::-1],
        motors=motors,
        hold_s=positive(hold_s, "--hold", most=LONGEST_STEP_S),
        rest_s=positive(rest_s, "--rest", most=LONGEST_STEP_S),
    )


def thrust(
    run: ResumedRun = None,
    *,
    first: From = 0,
    last: To = 64000,
    step: Step = 4000,
    hold: Annotated[
        float | None,
        typer.Option(metavar="S", help="Seconds at each command; default: 1.2, with lines 6."),
    ] = None,
    rest: Annotated[
        float | None,
        typer.Option(metavar="S", help="Seconds of pause around the commands; default: 0.8, with lines 2."),
    ] = None,
    motor: Motor = None,
    rate_hz: CellRateHz = None,
    resume: Resume = False,
    uri: Uri = None,
    no_preflight: NoPreflight = False,
    dry_run: DryRun = False,
    note: Note = None,
) -> None:
    """Record load cell, commands and battery while the motors run a staircase up and down; Ctrl-C stops them.

    Example: cfid log thrust --from 0 --to 64000 --step 4000 --motor 1,3
    """
    from cfid.motors.record import StaircaseRecording, record_forces

    rig, word = rig_of(), run_to_resume(run, resume=resume)
    kind = rig.devices.loadcell.kind
    hold_s, rest_s = (
        usual if stated is None else stated for usual, stated in zip(_SECONDS[kind], (hold, rest), strict=True)
    )
    wanted = staircase_of(motors_of(motor, (1, 3)), first, last, step, hold_s=hold_s, rest_s=rest_s, twice=True)
    wanted = _remaining("thrust", wanted, word, rig.campaign)
    if dry_run:
        rehearse("log thrust", [plan_line(wanted)], **plan_facts(wanted))
        return
    recording = StaircaseRecording(
        kind="thrust",
        staircase=wanted,
        rig=rig,
        uri=uri,
        preflight=not no_preflight,
        note=note,
        judge=later("cfid.motors.maps.verdict", "of_forces"),
    )
    record_forces(recording, rate_hz=_FORCES_HZ if rate_hz is None and kind == "netft" else rate_hz)


def speed(
    run: ResumedRun = None,
    *,
    tachometer: Annotated[
        Tachometer | None,
        typer.Option(
            metavar="SOURCE",
            help="typed (by you), ut372, lines (of a device), deck (the RPM deck) or brushless (motors that report); "
            "default: typed, or as the run to resume.",
        ),
    ] = None,
    port: Annotated[str | None, typer.Option(metavar="PORT", help="Port of the UT372; default: search for it.")] = None,
    first: From = 0,
    last: To = 64000,
    step: Step = 4000,
    hold: Hold = 6.0,  # a tachometer's display takes seconds to settle
    rest: Rest = 2.0,
    motor: Motor = None,
    resume: Resume = False,
    uri: Uri = None,
    no_preflight: NoPreflight = False,
    dry_run: DryRun = False,
    note: Note = None,
) -> None:
    """Record rotor speeds while motors run a staircase up and down; Ctrl-C stops them.

    Every other command is held on the way up, and those between on the way down. Enter alone skips a reading.

    Example: cfid log speed --motor 1
    """
    from cfid.motors.record import StaircaseRecording, record_speed

    rig, word = rig_of(), run_to_resume(run, resume=resume)
    tachometer = tachometer or _tachometer_of(word, rig.campaign)
    if port is not None and tachometer != "ut372":
        raise ConfigError(f"--port is the UT372's, and --tachometer is {tachometer}.")
    wanted = staircase_of(motors_of(motor, (1,)), first, last, step, hold_s=hold, rest_s=rest, twice=False)
    wanted = _remaining("speed", wanted, word, rig.campaign)
    if dry_run:
        rehearse("log speed", [plan_line(wanted)], **plan_facts(wanted))
        return
    recording = StaircaseRecording(
        kind="speed",
        staircase=wanted,
        rig=rig,
        uri=uri,
        preflight=not no_preflight,
        note=note,
        judge=later("cfid.motors.maps.verdict", "of_readings"),
    )
    record_speed(recording, tachometer=tachometer, port=port)


def scales(
    run: ResumedRun = None,
    *,
    port: Annotated[
        str | None,
        typer.Option(
            metavar="PORT",
            help="Serial port of the scales; default: of the run to resume, else of rig.toml, else you type.",
        ),
    ] = None,
    first: From = 0,
    last: To = 64000,
    step: Step = 8000,
    hold: Hold = 5.0,
    rest: Rest = 3.0,
    motor: Motor = None,
    resume: Resume = False,
    uri: Uri = None,
    no_preflight: NoPreflight = False,
    dry_run: DryRun = False,
    note: Note = None,
) -> None:
    """Record the readings of scales while motors run a staircase up and down (figure 3.9); Ctrl-C stops the motors.

    Example: cfid log scales --motor 1,3
    """
    from cfid.motors.record import StaircaseRecording, record_scales

    rig, word = rig_of(), run_to_resume(run, resume=resume)
    wanted = staircase_of(motors_of(motor, (1, 3)), first, last, step, hold_s=hold, rest_s=rest, twice=True)
    wanted = _remaining("scales", wanted, word, rig.campaign)
    known = _scales_of(word, rig.campaign)
    if dry_run:
        rehearse("log scales", [plan_line(wanted)], **plan_facts(wanted))
        return
    recording = StaircaseRecording(
        kind="scales",
        staircase=wanted,
        rig=rig,
        uri=uri,
        preflight=not no_preflight,
        note=note,
        judge=later("cfid.motors.maps.verdict", "of_readings"),
    )
    record_scales(recording, port=port or known.get("port"), baud=known.get("baud") or _SCALES_BAUD)


def plan_facts(staircase: "StaircasePlan") -> dict[str, Any]:
    """Return the facts of a staircase, in the form of --json."""
    return {**staircase.to_run(), "lasts_s": staircase.duration_s}


def plan_line(staircase: "StaircasePlan") -> str:
    """Return a line on what a staircase does."""
    steps, motors = staircase.steps, ", ".join(map(str, staircase.motors))
    several = "s" * (len(staircase.motors) > 1)
    return (
        f"{counted(len(steps), 'command')} from {min(steps)} to {max(steps)} on motor{several} {motors}, "
        f"{staircase.hold_s:g} s each with {staircase.rest_s:g} s of pause: {clock(staircase.duration_s)} min"
    )


def _tachometer_of(word: Path | None, campaign: "Campaign") -> Tachometer:
    """Return the instrument of the run to resume, or `typed` for a new run and where that run states none."""
    if word is None:
        return "typed"
    stated = read_run(interrupted(word, campaign, kind="speed")).header.requested.get("tachometer")
    return next((one for one in get_args(Tachometer) if one == stated), "typed")


def _scales_of(word: Path | None, campaign: "Campaign") -> Mapping[str, Any]:
    """Return what the run.toml of the run to resume states about scales at a port; empty where it had none."""
    if word is None:
        return {}
    record = read_run(interrupted(word, campaign, kind="scales")).header.devices.get(SCALES)
    return {} if record is None else record.model_extra or {}


def _remaining(kind: str, wanted: "StaircasePlan", word: Path | None, campaign: "Campaign") -> "StaircasePlan":
    """Return the staircase or, with --resume, the steps that the interrupted run still lacks."""
    if word is None:
        return wanted

    return missing(interrupted(word, campaign, kind=kind), kind=kind)
