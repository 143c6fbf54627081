"""Steady points of motors from everything that measures them: runs, load-cell files by command, and stands' tables."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.console.inputs import Workplace, find_recording, split_label
from cfid.console.selection import chosen
from cfid.counted import counted
from cfid.errors import CfidError, ConfigError, DataError, FitError
from cfid.estimate.common_causes import Cause
from cfid.estimate.linear import weighted_mean
from cfid.estimate.propagation import widened
from cfid.estimate.staircase import (
    FZ,
    NeverRanError,
    NoBaselineError,
    Point,
    Staircase,
    mean_in_windows,
    reduce_single,
    reduce_staircase,
)
from cfid.findings import Finding, explained, note, of_recording, warning
from cfid.large import chosen_rows, side_by_side
from cfid.motors.data import RunStaircase, channels_of, reduce_run, reduce_speeds, without_dead
from cfid.motors.points import Points, column, frame, joined, points_of, rotor_speed_rad_s
from cfid.motors.vibration.data import Rotors, speeds_from_vibration
from cfid.motors.weighing import Weighing, digit_g, thrust_points, weighed_thrusts
from cfid.recordings.read import kind_at, read_recording
from cfid.recordings.recording import How
from cfid.recordings.resumed import with_completed
from cfid.recordings.stand import STAND, USUAL_ESC_US, StandTable, holds_stand, read_stand, stand_of
from cfid.recordings.vehicle import (
    READINGS,
    SCALES,
    TACHOMETER,
    VEHICLE_LOG,
    holds,
    read_commands,
    read_rows,
    reported_speeds_rad_s,
    shown_at_commands,
)
from cfid.recordings.wrench import LOADCELL, WrenchRecord, wrench_of
from cfid.records.choose import Matches, labelled
from cfid.records.parameters import Source
from cfid.records.rig_file import NONE_STATED, LoadCellMount, RigFacts, Tachometer
from cfid.records.run import Run, refuse_contradiction, run_at, run_holding
from cfid.units import DEAD_COMMAND, FULL_COMMAND, MOTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

_BIAS = slice(9, 60)  # MATLAB's 10:60
# Kinds of runs of each map, the best first.
_MEASURED_BY = {"thrust": ("thrust", "scales"), "torque": ("thrust",), "speed": ("speed",)}
_LEAST_HELD_S = 0.2  # five time constants of the fastest rotor
_TOGETHER = 0.8  # share of the rows with a thrust that also have a torque
_MOST_NAMED = 8  # steps left out, up to which each has its own sentence
_LARGEST_IN_STD = 3.0  # of a load cell's drift that is noise
_SAGGED = 0.005  # of the battery's voltage: where it changed by more, the thrust itself changed
_NOTABLE = 0.01  # of the thrust: a smaller drift need not be seen
_OF_FORCES = ("motor.thrust_poly", "motor.torque_poly", "motor.max_thrust_n", "motor.hover_mass_kg")


@dataclass(frozen=True, kw_only=True)
class Stand:
    """Facts that files do not contain: motors that ran, markers of a tachometer, a window set by hand, Fz downwards.

    `facts` are those of the rig with which the files were recorded.
    """

    motors: int | None = None
    markers: int | None = None
    window_s: tuple[float, float] | None = None
    flip_fz: bool | None = None
    facts: RigFacts = NONE_STATED

    def where(self, facts: RigFacts) -> "Stand":
        """Return these facts, completed from those of a rig."""
        given = RigFacts(loadcell=LoadCellMount(flip_fz=self.flip_fz), tachometer=Tachometer(markers=self.markers))
        known = given.over(facts)
        return replace(self, markers=known.tachometer.markers, flip_fz=known.loadcell.flip_fz, facts=facts)

    def divided(self, speed_rad_s: Array, path: Path) -> Array:
        """Return speeds (n,) from a tachometer's readings. Raises ConfigError where its markers are not stated."""
        if self.markers is None:
            raise ConfigError(f"{path}: no rig.toml stated how many markers the tachometer counts: give `markers`.")
        return speed_rad_s / self.markers


class Reduced(NamedTuple):
    """A record of the load cell that was reduced, for its figure; `thrust` is the index of the thrust's channel."""

    name: str
    time_s: Array
    thrust_n: Array
    staircase: Staircase
    thrust: int = FZ


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Steady points of one motor, and where they come from.

    `expected` are the commands that were requested. `loadcells` and `tachometers` are the facts of the rigs whose load
    cell or tachometer measured the points, `scales` those whose scales did; `drifts` are the drifts of load cells
    within a recording.
    """

    points: Points
    lines: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    sources: tuple[Source, ...] = ()
    reduced: tuple[Reduced, ...] = ()
    expected: tuple[int, ...] = ()
    loadcells: tuple[RigFacts, ...] = ()
    drifts: tuple[Cause, ...] = ()
    tachometers: tuple[RigFacts, ...] = ()
    scales: tuple[RigFacts, ...] = ()


Measurement = Evidence | StandTable | Run | Path | str
Measurements = Measurement | Sequence[Measurement]


def together(parts: Sequence[Evidence]) -> Evidence:
    """Concatenate the points of several files and runs."""
    names = [field.name for field in fields(Evidence) if field.name != "points"]
    lists: dict[str, Any] = {name: tuple(item for part in parts for item in getattr(part, name)) for name in names}
    return Evidence(points=joined(*(part.points for part in parts)), **lists)


def evidence_of(measurements: Measurements, stand: Stand | None = None, rotors: Rotors | None = None) -> Evidence:
    """Return the steady points of all runs and tables. Raises ConfigError where none is given."""
    several = [measurements] if isinstance(measurements, Measurement) else list(measurements)
    if not several:
        raise ConfigError("nothing to fit: give at least one run or table.")
    return together([_evidence_in(measurement, stand or Stand(), rotors) for measurement in several])


def _evidence_in(
    measurement: Measurement, stand: Stand, rotors: Rotors | None, *, gravity_mps2: float = USUAL_GRAVITY_MPS2
) -> Evidence:
    if isinstance(measurement, Evidence):
        return measurement
    if isinstance(measurement, StandTable):
        return of_table(measurement, stand, gravity_mps2=gravity_mps2)
    path = measurement.folder if isinstance(measurement, Run) else Path(measurement)
    run = run_at(path)
    if run is not None and not holds_stand(path):
        return of_run(run, stand, rotors=rotors, gravity_mps2=gravity_mps2)
    if stand.window_s is not None or stand.flip_fz is not None:
        raise ConfigError(
            f"a window and `flip_fz` are for a load cell's recording, and {path} is a thrust stand's table."
        )
    how = How(motors=stand.motors)
    return of_table(stand_of(read_stand(path, how), how, gravity_mps2=gravity_mps2), stand, gravity_mps2=gravity_mps2)


# From the arguments of a command


def read_evidence(
    words: Sequence[str],
    workplace: Workplace,
    *,
    known: Stand,
    table: Path | None,
    kind: str,
    method: str,
    rotors: Rotors | None = None,
) -> Evidence:
    """Read COMMAND=FILE arguments, runs and tables, and put all their points together.

    Without any of them, the campaign's complete runs of a `kind` are taken. With `rotors`, missing speeds are estimated
    from vibration. A run that gives nothing is left out with a warning where others give something.

    Raises ConfigError when there is nothing to read, DataError and FitError that name the file.
    """
    stand, gravity_mps2 = replace(known, facts=workplace.facts), workplace.rig.site.gravity_mps2
    faults: list[DataError | FitError] = []
    parts = [] if table is None else [_evidence_in(table, stand, rotors, gravity_mps2=gravity_mps2)]
    for word in _chosen(words, workplace, kind, tables=len(parts)):
        command, file = split_label(word, workplace)
        if command:
            at = _command(command, word)
            if (run := run_holding(Path(file))) is not None:
                refuse_contradiction(word, {"command": at}, {"command": run.header.requested.get("steps")})
            parts.append(of_file(at, Path(file), stand.where(stand.facts), method=method, rotors=rotors))
            continue
        path = find_recording(word, workplace, _of_kinds(*_MEASURED_BY[kind], STAND))
        is_run = run_at(path) is not None and not holds_stand(path)
        if not is_run and not holds_stand(path) and kind_at(path) == "wrench":
            raise DataError(f"{path}: a load cell's file needs its command: write COMMAND={path}.")
        try:
            parts.append(_evidence_in(path, stand, rotors, gravity_mps2=gravity_mps2))
        except (DataError, FitError) as error:
            if not is_run:
                raise
            faults.append(error)  # one part of a resumed staircase does not condemn the others
    if not parts:
        nothing = "nothing to fit: give a thrust stand's CSV file, COMMAND=FILE ..., or a RUN of `cfid log thrust` or "
        raise next(iter(faults), ConfigError(f"{nothing}speed."))
    if not any(len(part.points) for part in parts):
        raise explained(FitError("no step settles."), [part.findings[-1] for part in parts if part.findings])
    left_out = tuple(warning("run-left-out", f"{error} It is left out.") for error in faults)
    evidence = together(parts)
    return replace(evidence, findings=(*left_out, *evidence.findings))


def _chosen(words: Sequence[str], workplace: Workplace, kind: str, *, tables: int) -> Sequence[str]:
    if workplace.campaign is None or (tables and not words):
        return words
    recorded = {run.header.kind for run in workplace.campaign.runs()}
    first = next((each for each in _MEASURED_BY[kind] if each in recorded), _MEASURED_BY[kind][0])
    # A stand, and scales beside a load cell, are taken where they are named.
    suits = _of_kinds(*_MEASURED_BY[kind], STAND) if words else labelled(first)
    taken = chosen(words, workplace.campaign, suits=suits, wanted=f"runs of cfid log {first}")
    if words or (kind, first) != ("thrust", "thrust") or "speed" not in recorded:
        return taken
    # Rotors' speeds, besides the load cell's forces, give the thrust over speed.
    return [*taken, *chosen((), workplace.campaign, suits=labelled("speed"), wanted="runs of cfid log speed")]


def _of_kinds(*kinds: str) -> Matches:
    return lambda run: run.header.kind in kinds


def _command(text: str, word: str) -> int:
    if not text.isdecimal() or int(text) > FULL_COMMAND:
        raise ConfigError(f"'{word}': '{text}' is no command from 0 to {FULL_COMMAND}: write COMMAND=FILE.")
    return int(text)


# From a load cell


def of_file(command: int, path: Path, stand: Stand, *, method: str, rotors: Rotors | None = None) -> Evidence:
    """Reduce a load cell's file of one command between two pauses, as the thesis recorded them."""
    record = wrench_of(read_recording(path), gain=stand.facts.loadcell.gain)
    if command == 0:  # motors at rest give no thrust, whatever the cell's bias is
        return _plain(record, frame(np.zeros(1), thrust_n=np.zeros(1), torque_nm=np.zeros(1), motors=stand.motors or 1))
    channels = channels_of(record, flip_fz=bool(stand.flip_fz))
    try:
        if method == "thesis" and stand.window_s is not None:
            motors, (from_s, to_s) = stand.motors or 1, stand.window_s
            thrust, torque = (
                reduce_thesis(record.time_s, channels[:, at], from_s=from_s, to_s=to_s) / motors for at in (2, 5)
            )
            return _plain(record, frame([command], thrust_n=[thrust], torque_nm=[torque], motors=motors))
        reduced = reduce_single(
            time_s=record.time_s, channels=channels, command=command, status=record.status, window=stand.window_s
        )
    except NeverRanError as error:
        left_out = warning("file-left-out", f"{error} It is left out.").at(str(path))
        return _plain(record, frame(np.zeros(0)), left_out)
    except CfidError as error:
        raise type(error)(f"{path}: {error}") from None
    staircase = RunStaircase(record=record, reduced=reduced, run=None, began_s=math.nan, sources=(record.source,))
    return _of_staircase(staircase, stand, motors=stand.motors or 1, rotors=rotors)


def reduce_thesis(time_s: Array, channel: Array, *, from_s: float, to_s: float) -> float:
    """Return the mean of a channel (n,) in a window set by hand less its bias, as prepare_data of C.2.3 takes it.

    The bias is Fz_raw(10:60), 51 samples from the tenth on. The window, in seconds since the first sample, begins with
    the last sample not after `from_s` and ends with the last not after `to_s`.

    Raises DataError where C.2.3 would find no index: for a window that is not within the record.
    """
    since_s = time_s - time_s[0]
    if len(since_s) < _BIAS.stop:
        raise DataError(f"the thesis' bias is that of samples 10 to 60; there are {len(since_s)}.")
    if not 0 <= from_s <= to_s < since_s[-1]:
        raise DataError(f"the window from {from_s:g} to {to_s:g} s is not within the record of {since_s[-1]:.4g} s.")
    first, end = np.searchsorted(since_s, (from_s, to_s), side="right")
    return float(channel[first - 1 : end].mean()) - float(channel[_BIAS].mean())


def _plain(record: WrenchRecord, points: Points, *findings: Finding) -> Evidence:
    """Return points of a file that needs no reduction, or none."""
    return Evidence(points=points, findings=(*record.findings, *findings), sources=(record.source,))


def of_run(
    run: Run, stand: Stand, *, rotors: Rotors | None = None, gravity_mps2: float = USUAL_GRAVITY_MPS2
) -> Evidence:
    """Return what a run measured of a motor: steps on the load cell or scales, typed readings, or reported speeds."""
    if stand.window_s is not None:
        raise ConfigError(
            f"{run.folder.name}: it states when commands were held: a window is for files of one command."
        )
    ran = run.header.requested.get("motors")
    refuse_contradiction(run.folder.name, {"`motors`": stand.motors}, {"`motors`": ran and len(ran)})
    stand = stand.where(run.header.rig)
    typed = run.header.devices[READINGS].columns if READINGS in run.header.devices else ()
    if holds(run, LOADCELL):
        return of_record(wrench_of(read_recording(run.folder)), run, stand, rotors)
    if (holds(run, READINGS) and "rpm" in typed) or holds(run, TACHOMETER):
        return _of_tachometer(run, stand)
    if (holds(run, READINGS) and "grams" in typed) or holds(run, SCALES):
        weighed = weighed_thrusts(run, gravity_mps2=gravity_mps2)
        return Evidence(
            points=weighed.points,
            findings=weighed.findings,
            sources=(weighed.source,),
            expected=tuple(step for step in _requested(run) if step > DEAD_COMMAND),
            scales=(stand.facts,),
        )
    if typed:
        raise DataError(f"{run.folder}: no reading was typed in it.")
    if holds(run, VEHICLE_LOG):
        return _of_reported_speeds(run)
    raise DataError(f"{run.folder}: a run of {run.header.kind}, in which no motor was measured.")


def of_record(record: WrenchRecord, run: Run, stand: Stand, rotors: Rotors | None = None) -> Evidence:
    """Return the steps of a run on the load cell."""
    staircase = reduce_run(record, flip_fz=bool(stand.flip_fz))
    return replace(_of_staircase(staircase, stand, motors=None, rotors=rotors), expected=_requested(run))


def _requested(run: Run) -> tuple[int, ...]:
    return tuple(int(step) for step in run.header.requested.get("steps", ()) if step)


def of_completed(run: Run) -> dict[str, Evidence]:
    """Return the runs that a run completes, by name and as its fit takes them, without those that give nothing.

    Raises DataError where the run.toml of one is invalid.
    """
    completed: dict[str, Evidence] = {}
    for part in with_completed(run)[:-1]:
        with suppress(DataError, FitError):
            completed[part.folder.resolve().name] = of_run(part, counted_in(part))
    return {name: evidence for name, evidence in completed.items() if len(evidence.points)}


def counted_in(run: Run) -> Stand:
    """Return the facts by which a run is judged as soon as it is recorded: one marker where none is stated."""
    return Stand(markers=run.header.rig.tachometer.markers or 1)


def _of_staircase(
    staircase: RunStaircase, stand: Stand, *, motors: int | None, rotors: Rotors | None = None
) -> Evidence:
    """Return a reduced record's settled points, per motor; speeds are from vibration where none were reported."""
    record, settled = staircase.record, [point for point in staircase.reduced.points if point.settled]
    points, drifts = frame(np.zeros(0)), tuple[Cause, ...]()
    about_speed, about_drift = tuple[Finding, ...](), tuple[Finding, ...]()
    if settled:
        points = points_of(settled, motors=motors, source=str(record.path))
        speed, std = staircase.reported_speeds(settled), None
        if speed is None and rotors is not None:
            rest_s = staircase.reduced.rest_s
            speed, std, about_speed = speeds_from_vibration(settled, record, rotors, motors=motors, rest_s=rest_s)
        more = {"speed_rad_s": speed, "speed_std_rad_s": std, "vbat_v": staircase.volts(settled)}
        points = points.assign(**{name: value for name, value in more.items() if value is not None})
        middle_s = np.array([(point.begin_s + point.end_s) / 2 for point in settled])
        drifts, about_drift = warm_up(points, middle_s, record.name)
    thrust_n = record.force_n[:, FZ] * (-1 if stand.flip_fz else 1)
    return Evidence(
        points=points,
        lines=_lines(staircase.reduced.points, record.name),
        findings=(*record.findings, *staircase.findings, *staircase.dead, *about_speed, *about_drift),
        sources=staircase.sources,
        reduced=(Reduced(record.name, record.time_s, thrust_n, staircase.reduced),),
        loadcells=(stand.facts,),
        drifts=drifts,
    )


def _lines(points: Sequence[Point], name: str) -> tuple[str, ...]:
    """Return a line for each step on where it was averaged, or why it was not."""
    lines = []
    for point in points:
        how = f"{point.effective_samples.min():.0f} independent samples" if point.settled else point.reason
        step = "a step of unknown command" if point.command is None else f"command {point.command}"
        lines.append(f"{name}: {step}: {point.begin_s:7.2f} to {point.end_s:7.2f} s, {how}")
    return tuple(lines)


def warm_up(points: Points, time_s: Array, name: str) -> tuple[tuple[Cause, ...], tuple[Finding, ...]]:
    """Return the drift of a run's load cell as a cause of error, with findings; no cause where noise explains it.

    Points (n,) were recorded at times (n,). Each command that was held again gives a relative change over the time
    between. The weighted mean rate of these changes, times the run's duration, is the drift. What noise adds to its
    square is subtracted. The rest is the standard uncertainty, since the last thrust need not be the right one either:
    a drift that has not ended may go on for as much again.
    """
    command, thrust, std, volts = (column(points, name) for name in ("command", "thrust_n", "thrust_std_n", "vbat_v"))
    if command is None or thrust is None or std is None:
        return (), ()
    running, rates, rate_stds = command > DEAD_COMMAND, [], []
    for held in np.unique(command[running]):
        first, last = np.flatnonzero(command == held)[[0, -1]].tolist()
        sagged = volts is not None and abs(volts[last] / volts[first] - 1) > _SAGGED
        if first < last and thrust[first] > 0 and not sagged:
            scale = thrust[first] * (time_s[last] - time_s[first])
            rates.append((thrust[last] - thrust[first]) / scale)
            rate_stds.append(math.hypot(std[first], std[last]) / scale)
    if not rates:
        return (), ()
    mean = weighted_mean(np.array(rates), std=np.array(rate_stds))
    freedom, duration_s = mean.degrees_of_freedom, float(np.ptp(time_s[running]))
    drift, drift_std = duration_s * float(mean.values[0]), duration_s * float(mean.std[0])
    if freedom:  # by the scatter of the rates, where that is larger
        scatter = math.sqrt(float(np.sum((mean.residual / rate_stds) ** 2)) / freedom)
        drift_std = widened(drift_std * max(scatter, 1.0), freedom)
    beyond = math.sqrt(max(drift**2 - drift_std**2, 0.0))
    causes = (Cause(f"drift of the load cell in {name}", beyond),) if beyond else ()
    whose, least = f"{name}: {counted(len(rates), 'command')} held again", _LARGEST_IN_STD * drift_std
    if abs(drift) > least:
        text = (
            f"{whose} gave {100 * drift:+.1f} % more thrust within {duration_s:.0f} s, "
            f"{abs(drift) / drift_std:.0f} standard uncertainties (limit {_LARGEST_IN_STD:g}): did the load cell warm "
            "up? The uncertainties contain that. Switch the load cell on half an hour before the first step."
        )
        return causes, (warning("load-cell-drifted", text, *_OF_FORCES),)
    if least > _NOTABLE:
        text = (
            f"{whose} would show a drift of the load cell only beyond {100 * least:.1f} % of the thrust "
            f"within {duration_s:.0f} s. A cell that warms up by less is not found: switch it on half an hour before "
            "the first step, or hold each command longer."
        )
        return causes, (note("load-cell-drift-unseen", text, *_OF_FORCES),)
    return causes, ()


# From tachometers and the vehicle


def _of_tachometer(run: Run, stand: Stand) -> Evidence:
    """Return readings that the operator typed, or what a tachometer sent at each command.

    What it sent in the pauses does not count: some keep showing the last speed.
    """
    if holds(run, READINGS):
        rows = read_rows(run, READINGS)
        command, rpm = rows.columns["command"], rows.columns["rpm"]
    else:
        rows, command, rpm, _ = shown_at_commands(run, TACHOMETER, "rpm")
        if not np.any(command > 0):
            raise DataError(f"{run.folder}: no command was held to its end.")
        command, rpm = command[command > 0], rpm[command > 0]
    return Evidence(
        points=frame(command, speed_rad_s=stand.divided(rotor_speed_rad_s(rpm, markers=1), run.folder)),
        findings=rows.findings,
        sources=(rows.source,),
        tachometers=(stand.facts,),
    )


def _of_reported_speeds(run: Run) -> Evidence:
    """Reduce the speeds that the vehicle reported, as a staircase, to the mean of the motors that ran."""
    rows, (log, commands) = read_rows(run, VEHICLE_LOG), read_commands(run)
    speeds, name = reported_speeds_rad_s(rows), run.folder.name
    ran, dead = without_dead([motor for motor in MOTORS if commands[:, motor - 1].any()], speeds, name)
    if not ran or not all(motor in speeds for motor in ran):
        raise DataError(f"{run.folder}: the vehicle's log has no speeds: an RPM deck or brushless motors report them.")
    try:
        begin_s, turning = rows.time_s[0], np.column_stack([speeds[motor] for motor in ran])
        reduced = reduce_speeds(rows.time_s - begin_s, turning, log.time_s - begin_s, commands)
        settled = reduced.steady()
    except CfidError as error:
        raise type(error)(f"{run.folder}: {error}") from None
    return Evidence(
        points=frame(
            [float(point.command or 0) for point in settled],
            speed_rad_s=[point.mean.mean() for point in settled],
            speed_std_rad_s=[np.sqrt((point.std_of_mean**2).sum()) / len(ran) for point in settled],
        ),
        lines=_lines(reduced.points, name),
        findings=(*rows.findings, *log.findings, *dead, *_about_speeds(reduced, name)),
        sources=(rows.source, log.source),
        expected=_requested(run),
    )


def _about_speeds(reduced: Staircase, name: str) -> tuple[Finding, ...]:
    """Return findings about the means of a staircase of speeds, which needs no baseline."""
    return tuple(finding.at(name) for finding in reduced.findings if finding.code != "no-baseline-after")


# From tables of stands


def of_table(table: StandTable, stand: Stand, *, gravity_mps2: float = USUAL_GRAVITY_MPS2) -> Evidence:
    """Return a table's points, or reduce its record over time.

    Raises ConfigError where the speeds are those of another number of rotors than the thrust, and no number is stated,
    and for readings of scales without it.
    """
    if table.grams is not None and table.thrust_n is None and table.time_s is None:
        return _of_scales(table, table.grams, stand, gravity_mps2)
    _ask_motors(table, stand.motors)
    tachometer = table.speeds == "series"  # it counts markers; a thrust stand reports rotors' speeds
    stand = stand.where(stand.facts) if tachometer else replace(stand, markers=stand.markers or 1)
    evidence = _of_points(table, stand) if table.time_s is None else _of_record(table, table.time_s, stand)
    if stand.motors is not None and table.thrust_n is None and table.torque_nm is None:
        unused = of_recording(table.path.name, ["`motors` is not used: the table has no thrust and no torque."])
        evidence = replace(evidence, findings=(*evidence.findings, *unused))
    return replace(
        evidence,
        points=evidence.points.assign(motors=float(table.motors or stand.motors or 1)),
        sources=(table.source,),
        tachometers=(stand.facts,) if tachometer else (),
    )


def _of_scales(table: StandTable, grams: Array, stand: Stand, gravity_mps2: float) -> Evidence:
    motors = table.motors if table.are_stated else stand.motors
    if motors is None:
        raise ConfigError(f"{table.path}: scales show the thrust of all motors that ran: give `motors`, their number.")
    weighing = Weighing(command=table.command, grams=grams, motors=motors, facts=stand.facts)
    points = thrust_points(
        weighing,
        last=len(grams),
        shown_g=digit_g(grams),
        gravity_mps2=gravity_mps2,
        volts=table.vbat_v,
        source=str(table.path),
    )
    return Evidence(points=points, findings=table.findings, sources=(table.source,), scales=(stand.facts,))


def _ask_motors(table: StandTable, motors: int | None) -> None:
    """Raise ConfigError where the number of motors of thrust and torque is not known, or was stated too late."""
    if table.thrust_n is None and table.torque_nm is None:
        return
    quantity = "torque" if table.thrust_n is None else "thrust"
    head = next(table.columns[name] for name in ("thrust_n", "weight_g", "torque_nm") if name in table.columns)
    named, usual = f"{table.path}: '{head}'", table.motors or 1
    if motors is None and not table.are_stated and table.rotors not in (None, usual):
        raise ConfigError(
            f"{named} is usually the {quantity} of {counted(usual, 'motor')}, but the file has the speed of "
            f"{counted(table.rotors, 'rotor')}. Give `motors`, the number of motors whose {quantity} it is."
        )
    if motors is not None and table.motors not in (None, motors):
        raise ConfigError(
            f"{named} was read as the {quantity} of {table.motors} motors: read the table with `motors` {motors}."
        )


def _share(table: StandTable, stand: Stand) -> int:
    """Return the number of motors by which thrust and torque are still to be divided."""
    return 1 if table.motors is not None else stand.motors or 1


def _of_points(table: StandTable, stand: Stand) -> Evidence:
    """Return a table's settled points; several series of one rotor give as many points."""
    share = _share(table, stand)
    thrust, torque = (None if total is None else total / share for total in (table.thrust_n, table.torque_nm))
    points = frame(table.command, thrust_n=thrust, torque_nm=torque, vbat_v=table.vbat_v)
    mean_speed = table.square_mean_speed_rad_s
    if table.speeds_rad_s is not None and mean_speed is not None:
        series = list(table.speeds_rad_s.T) if table.speeds == "series" else [mean_speed]
        divided = [stand.divided(speed, table.path) for speed in series]
        if thrust is not None and len(series) == 1:
            points = points.assign(speed_rad_s=divided[0])
        else:
            speeds = [frame(table.command, speed_rad_s=speed, vbat_v=table.vbat_v) for speed in divided]
            points = joined(*([] if thrust is None else [points]), *speeds)
    return Evidence(points=points, findings=table.findings)


def _of_record(table: StandTable, time_s: Array, stand: Stand) -> Evidence:
    """Reduce a thrust stand's record over time: thrust, torque, speed and battery where each command is steady."""
    command_time_s, commands = _commands(table, time_s)
    speeds, name = table.square_mean_speed_rad_s, table.path.name
    try:
        if table.thrust_n is not None:
            channels, known = _forces(table)
            reduced = reduce_staircase(
                time_s=chosen_rows(time_s, known),
                channels=chosen_rows(channels, known),
                command_time_s=command_time_s,
                commands=commands,
                thrust=0,
            )
        elif speeds is None:
            raise DataError("a record over time without a thrust or a speed cannot be reduced.")
        elif command_time_s is None or commands is None:
            raise DataError("speeds alone without commands give no map.")
        else:
            reduced = reduce_speeds(time_s, speeds[:, np.newaxis], command_time_s, commands)
        settled = reduced.steady()
    except NoBaselineError as error:
        raise DataError(f"{table.path}: {error}{_longer_rest(table)}") from None
    except CfidError as error:
        raise type(error)(f"{table.path}: {error}") from None
    if table.thrust_n is None:
        speed = stand.divided(np.array([point.mean[0] for point in settled]), table.path)
        return Evidence(
            points=frame([float(point.command or 0) for point in settled], speed_rad_s=speed),
            lines=_lines(reduced.points, name),
            findings=(*table.findings, *_merged(_about_speeds(reduced, name), len(reduced.points))),
        )
    points = points_of(settled, thrust=0, torque=1, source=str(table.path))
    forces = [held for held in points.columns if held.startswith(("thrust", "torque"))]
    points[forces] /= _share(table, stand)
    if commands is None:
        points["command"] = np.nan
    if speeds is not None:
        points["speed_rad_s"] = stand.divided(_mean_of_known(settled, time_s, speeds), table.path)
    if table.vbat_v is not None:
        points["vbat_v"] = _mean_of_known(settled, time_s, table.vbat_v)
    about_steps = tuple(finding.at(name) for finding in reduced.findings)
    return Evidence(
        points=points,
        lines=_lines(settled, name),
        findings=(*table.findings, *_merged(about_steps, len(reduced.points))),
        reduced=(
            Reduced(table.path.stem, chosen_rows(time_s, known), chosen_rows(table.thrust_n, known), reduced, thrust=0),
        ),
    )


def _longer_rest(table: StandTable) -> str:
    """Return a sentence for a table whose range of pulse widths was assumed, and that has no motor at rest."""
    if not any(finding.code == "esc-range-assumed" for finding in table.findings) or not np.nanmin(table.command) > 0:
        return ""
    low, high = USUAL_ESC_US
    least_us = low + np.nanmin(table.command) / FULL_COMMAND * (high - low)
    stands = f" If motors stand at its shortest pulses, of {least_us:.0f} us, give their range"
    return f"{stands}: `esc_us` {least_us:.0f},{high:g}."


def _forces(table: StandTable) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return thrust, with torque where both were recorded (n, 1 or 2), and the rows (n,) in which they are known.

    A stand may read its load cells less often than the rest.
    """
    assert table.thrust_n is not None
    known = np.isfinite(table.thrust_n)
    if table.torque_nm is None:
        return table.thrust_n[:, np.newaxis], known
    both = known & np.isfinite(table.torque_nm)
    if both.sum() < _TOGETHER * known.sum():
        return table.thrust_n[:, np.newaxis], known
    return side_by_side([table.thrust_n, table.torque_nm]), both


def _commands(table: StandTable, time_s: Array) -> tuple[Array | None, Array | None]:
    """Return when commands begin (m,) and the commands (m, 4), both None where the table has none.

    Raises FitError for a recording in which no command is held, which is motion and has no steps.
    """
    if np.isnan(table.command).all():
        return None, None
    changes = np.flatnonzero(np.diff(table.command, prepend=np.nan))
    begin_s, command = time_s[changes], table.command[changes]
    held_s = np.diff(begin_s, append=time_s[-1])[command > DEAD_COMMAND]
    if len(held_s) and held_s.max() < _LEAST_HELD_S:
        raise FitError(
            f"{table.path}: unsteady: of {len(held_s)} commands none is held for longer than {held_s.max():.2g} s, and "
            f"a rotor settles in no less than {_LEAST_HELD_S:g} s. Hold each command for some seconds."
        )
    return begin_s, np.outer(command, (1, 0, 0, 0))  # the table states how many motors ran


def _mean_of_known(settled: Sequence[Point], time_s: Array, value: Array) -> Array:
    """Return the means (p,) of the known values (n,) in the windows of points."""
    known = np.isfinite(value)
    return mean_in_windows(settled, chosen_rows(time_s, known), chosen_rows(value, known))


def _merged(findings: Sequence[Finding], steps: int) -> tuple[Finding, ...]:
    """Return the findings, with many left-out steps merged into one."""
    left_out = [finding for finding in findings if finding.code == "step-left-out"]
    if len(left_out) <= _MOST_NAMED:
        return tuple(findings)
    others = [finding for finding in findings if finding.code != "step-left-out"]
    text = f"{len(left_out)} of {counted(steps, 'step')} left out. The first: {left_out[0].text}"
    return (*others, replace(left_out[0], sentence=text, where=()))
