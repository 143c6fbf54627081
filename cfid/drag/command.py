"""Provide `cfid log wind` and `cfid fit drag`.

`cfid log wind` holds all commands in turn on the load cell, in one wind setting (section 4.4.2); `cfid fit drag` fits
drag coefficients to the forces on a vehicle held in wind.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cfid.console.inputs import Workplace, find_recording, open_workplace
from cfid.console.labels import Note
from cfid.console.lists import comma_list
from cfid.console.options import Figures, FlipFz, Force, Geometry, Markers, Method, Out, YawDeg, finite, positive
from cfid.console.outcome import Delivery, deliver
from cfid.console.recording import Resume, ResumedRun, rehearse, rig_of, run_to_resume
from cfid.console.selection import chosen, interrupted
from cfid.console.vehicle import CellRateHz, NoPreflight, Uri
from cfid.drag.plan import (
    FASTEST_MPS,
    HIGHEST_DEG,
    KIND,
    WindSetting,
    missing_lines,
    missing_runs,
    recorded,
    setting_of,
    wind_runs,
)
from cfid.errors import ConfigError
from cfid.lazy import later
from cfid.motors.command import plan_facts, plan_line
from cfid.motors.plan import LONGEST_STEP_S, StaircasePlan, missing
from cfid.recordings.vehicle import READINGS
from cfid.records.choose import labelled
from cfid.records.run import read_run
from cfid.units import FULL_COMMAND, MOTORS

if TYPE_CHECKING:
    from cfid.drag.plan import PlannedRun, WindSetting
    from cfid.motors.plan import StaircasePlan
    from cfid.records.campaign import Campaign

_MOST_FAN_V = 1000.0
_HOLD_S, _REST_S = 10.0, 3.0  # at each command, and before, between and after the commands
THESIS_COMMANDS = "0,10000,20000,30000,37300,40000,50000"

AzimuthDeg = Annotated[
    float | None,
    typer.Option(
        metavar="DEG",
        help="Azimuth of the wind generator, to the right of the nose; default: the run's, else rig.toml's.",
    ),
]


def wind(
    run: ResumedRun = None,
    *,
    wind: Annotated[
        str | None,
        typer.Option(metavar="MIN,MAX", help="Range of the wind speed, in m/s; 0 for references."),
    ] = None,
    angle: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="Angle of the wind generator to the vertical."),
    ] = None,
    fan_voltage: Annotated[float | None, typer.Option(metavar="V", help="Voltage at the wind generator's fan.")] = None,
    azimuth_deg: AzimuthDeg = None,
    commands: Annotated[
        str,
        typer.Option(metavar="C,C,...", help="Commands to all four motors, one after the other."),
    ] = THESIS_COMMANDS,
    hold: Annotated[float, typer.Option(metavar="S", help="Seconds at each command.")] = _HOLD_S,
    rest: Annotated[
        float,
        typer.Option(metavar="S", help="Seconds of pause around the commands."),
    ] = _REST_S,
    tachometer: Annotated[
        Literal["typed", "none"] | None,
        typer.Option(
            help="Readings typed by you, or none: the fit takes the speed from vibration; default: typed, or as the "
            "run to resume.",
        ),
    ] = None,
    rate_hz: CellRateHz = None,
    resume: Resume = False,
    uri: Uri = None,
    no_preflight: NoPreflight = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print what would be done, how long it takes, and what is missing.")
    ] = False,
    note: Note = None,
) -> None:
    """Record load cell, commands and battery in one wind setting, command by command; Ctrl-C stops the motors.

    Start the wind first, so that the load cell's tare contains the wind's force on the body alone.

    Example: cfid log wind --angle 48.4 --fan-voltage 8 --wind 2.0,3.7
    """
    from cfid.motors.record import StaircaseRecording, record_forces

    rig, word = rig_of(), run_to_resume(run, resume=resume)
    campaign, simulated = rig.campaign, rig.simulated
    staircase = wind_staircase(commands, hold, rest)
    if dry_run and wind is None and word is None:
        _rehearse(None, staircase, _recorded(campaign, simulated=simulated), asks=False)
        return
    resumed = None if word is None else interrupted(word, campaign, kind=KIND)
    if resumed is None:
        setting = wind_setting(wind, angle, fan_voltage, azimuth_deg)
    else:
        if any(value is not None for value in (wind, angle, fan_voltage, azimuth_deg)):
            raise ConfigError(f"--resume {resumed} keeps the wind setting of its run: leave out its options.")
        setting, staircase = setting_of(read_run(resumed)), missing(resumed, kind=KIND)
    asks = (tachometer or _tachometer_of(resumed)) == "typed" and not setting.is_reference
    if dry_run:
        _rehearse(setting, staircase, _recorded(campaign, simulated=simulated), asks=asks)
        return
    recording = StaircaseRecording(
        kind=KIND,
        staircase=staircase,
        rig=rig,
        uri=uri,
        preflight=not no_preflight,
        note=note,
        judge=later("cfid.drag.data", "verdict"),
        question="RPM at command {command}, Enter for none" if asks else None,
        calm=setting.is_reference,
        requested=setting.to_run(),
        found=lambda run: (_missing(_recorded(campaign, simulated=simulated)), ()),
    )
    record_forces(recording, rate_hz=rate_hz)


def wind_setting(
    wind: str | None, angle: float | None, fan_voltage: float | None, azimuth_deg: float | None
) -> "WindSetting":
    """Return the wind setting. Raises ConfigError for one that is incomplete or impossible."""
    if wind is None:
        raise ConfigError("give --wind MIN,MAX, the lowest and highest wind around the vehicle; 0 for references.")
    low, high = _speeds(wind)
    if high == 0:
        return WindSetting()
    if angle is None:
        raise ConfigError(f"--wind {wind}: give --angle DEG too, the wind generator's to the vertical.")
    if not 0 <= angle <= HIGHEST_DEG:
        raise ConfigError(f"--angle {angle:g}: has to be from 0, straight above, to {HIGHEST_DEG:g} degrees.")
    from_deg = None if azimuth_deg is None else finite(azimuth_deg, "--azimuth-deg")
    fan_v = 0.0 if fan_voltage is None else positive(fan_voltage, "--fan-voltage", most=_MOST_FAN_V)
    return WindSetting(angle_deg=angle, fan_v=fan_v, min_mps=low, max_mps=high, azimuth_deg=from_deg)


def wind_staircase(commands: str, hold: float = _HOLD_S, rest: float = _REST_S) -> "StaircasePlan":
    """Return the commands as a staircase of all motors. Raises ConfigError for impossible ones."""
    steps = comma_list(commands, "--commands", int, least=0, most=FULL_COMMAND, example="0,10000")
    if not any(steps):
        raise ConfigError(f"--commands {commands}: no motor turns: give one above 0.")
    return StaircasePlan(
        steps=steps,
        motors=MOTORS,
        hold_s=positive(hold, "--hold", most=LONGEST_STEP_S),
        rest_s=positive(rest, "--rest", most=LONGEST_STEP_S),
    )


def _speeds(text: str) -> tuple[float, float]:
    example = "2.0,3.7, or 0 for references"
    low, *others = comma_list(text, "--wind", float, least=0, most=FASTEST_MPS, example=example)
    high = others[-1] if others else low
    if len(others) > 1 or low > high:
        raise ConfigError(f"--wind {text}: should be the lowest and the highest speed in m/s, as 2.0,3.7, or 0.")
    return low, high


def _tachometer_of(resume: Path | None) -> str:
    """Return whether readings were typed in the run to resume; `typed` for a new run."""
    return "typed" if resume is None or READINGS in read_run(resume).header.devices else "none"


def _rehearse(
    setting: "WindSetting | None", staircase: "StaircasePlan", done: "Sequence[PlannedRun]", *, asks: bool
) -> None:
    lines = [plan_line(staircase)] if setting is None else [setting.sentence, plan_line(staircase)]
    if asks:
        lines.append(f"and as long as it takes to read a tachometer {sum(map(bool, staircase.steps))} times")
    facts = plan_facts(staircase) | ({} if setting is None else setting.to_run())
    rehearse("log wind", [*lines, *missing_lines(done)], **facts, missing_runs=len(missing_runs(done)))


def _missing(done: "Sequence[PlannedRun]") -> Mapping[str, Any]:
    """Return how many of the thesis' runs the campaign lacks, as for --json."""
    return {"wind.missing_runs": {"value": len(missing_runs(done)), "std": None, "unit": "1"}}


def _recorded(campaign: "Campaign", *, simulated: bool) -> "list[PlannedRun]":
    return recorded(wind_runs(campaign, simulated=simulated))


Runs = Annotated[
    list[str] | None,
    typer.Argument(metavar="RUN ...", help="Runs of cfid log wind; default: the campaign's complete ones."),
]


def drag(
    runs: Runs = None,
    *,
    index: Annotated[
        Path | None,
        typer.Option(
            help="CSV file with a row per run: command, angle_deg, wind_min_mps, wind_max_mps (0: a reference), "
            "tach_rpm, loadcell; optionally azimuth_deg, from_s, to_s. A loadcell is a run, or a file beside the index "
            "whose columns name their units.",
        ),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(
            help="CSV file of reduced forces: command, angle_deg, v[xyz]_mps, speed_sum_rad_s, f[xyz]_n.",
        ),
    ] = None,
    azimuth_deg: AzimuthDeg = None,
    yaw_deg: YawDeg = None,
    markers: Markers = None,
    flip_fz: FlipFz = None,
    geometry: Geometry = None,
    method: Method = "default",
    force: Force = False,
    figures: Figures = None,
    out: Out = None,
) -> None:
    """Fit the simple, cross-coupling and complex drag models, and choose the one that the data support.

    Example: cfid fit drag --index wind.csv --azimuth-deg 28.46 --yaw-deg 45
    """
    from cfid.drag import fit, read_forces

    workplace = open_workplace(geometry)
    paths = _paths(runs or [], workplace, index=index, table=table)
    result = fit(
        paths if table is None else read_forces(table),
        index=index,
        azimuth_deg=None if azimuth_deg is None else finite(azimuth_deg, "--azimuth-deg"),
        yaw_deg=None if yaw_deg is None else finite(yaw_deg, "--yaw-deg"),
        markers=markers,
        flip_fz=flip_fz,
        rig=workplace.facts,
        method=method,
    )
    deliver(result, Delivery(force, figures, out), workplace)


def _paths(words: list[str], workplace: Workplace, *, index: Path | None, table: Path | None) -> list[Path]:
    """Return the given runs, or all runs of the campaign if none is given. Raises ConfigError."""
    if table is not None:
        if words or index is not None:
            raise ConfigError(f"--table {table} contains forces that are reduced already: give it alone.")
        return []
    if index is None:
        if not words and workplace.campaign is None:
            raise ConfigError("nothing to fit: give RUNs of `cfid log wind`, --index FILE, or --table FILE.")
        words = chosen(words, workplace.campaign, suits=labelled("wind"), wanted="runs in wind and without")
    return [find_recording(word, workplace) for word in words]
