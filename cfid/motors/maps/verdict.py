"""Judges a staircase as soon as it is recorded, by what the fits will say of it."""

from collections.abc import Mapping
from contextlib import suppress

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError, FitError
from cfid.findings import joined, texts
from cfid.motors.maps.data import Evidence, Stand, counted_in, of_completed, of_record, together
from cfid.motors.maps.result import fit_speed, fit_thrust, fit_torque
from cfid.motors.plan import FEWEST_COMMANDS, StaircasePlan, expected_of
from cfid.motors.points import column
from cfid.motors.weighing import weighing_of
from cfid.quantities.registry import range_of
from cfid.recordings.read import read_recording
from cfid.recordings.vehicle import (
    READINGS,
    SCALES,
    TACHOMETER,
    VEHICLE_LOG,
    holds,
    read_rows,
    reported_speeds_rad_s,
    shown_at_commands,
)
from cfid.recordings.wrench import AXES, LOADCELL, wrench_of
from cfid.records.campaign import find_campaign
from cfid.records.plausibility import Given, implausible_inputs, judged, platform_of
from cfid.records.rig_file import Rig
from cfid.records.run import Run
from cfid.units import DEAD_COMMAND, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

_SHARE = 0.5  # of the steps that must be there
_RISES = 0.02  # of the largest: how much more an instrument has to show at the highest command than at the lowest
_LARGEST_N = "motor.max_thrust_n"
_SHOWN = {  # for each instrument: the column, its unit, and how a sentence on it begins
    TACHOMETER: ("rpm", "rpm", "the tachometer shows"),
    SCALES: ("grams", "g", "the scales show"),
}
_MARKERS = "If only markers in rig.toml is wrong, correct it: `cfid fit speed` with `markers` takes these readings."


def of_forces(run: Run) -> str:
    """Return how many steps of a load cell's staircase are steady, and why the fit of torque rejects it, if it does.

    The run is taken with those that it completes, as the fits take it. Raises DataError or FitError where few steps are
    steady, or where the platform's motors cannot have such a thrust.
    """
    steps = sum(command > 0 for command in StaircasePlan.of_run(run).steps)  # a step at 0 is the tare
    record = wrench_of(read_recording(run.folder))
    evidence = of_record(record, run, Stand().where(run.header.rig))
    axis, reduced = record.main_axis, evidence.reduced[0].staircase
    points = reduced.steady()
    if len(points) < _SHARE * steps:
        raise FitError(f"only {len(points)} of {steps} steps are steady: hold them longer, or let the rig settle.")
    unit = "mN" if axis.startswith("F") else "mNm"
    values = [1e3 * float(point.mean[AXES.index(axis)]) for point in points]
    steady = f"{len(points)} of {steps} steps are steady, {axis} from {min(values):.0f} to {max(values):.0f} {unit}"
    left_out = [f"command {point.command} is not: {point.reason}" for point in reduced.points if not point.settled]
    summary = "; ".join([steady, *left_out[:1]]) + "."
    before = of_completed(run)
    whole = together([*before.values(), evidence])
    commands = np.array([point.command or 0 for point in points], dtype=np.float64)
    lacking = _too_few(commands, before, "thrust")
    _check_thrust(run, whole, steady, fitted=not lacking)
    if lacking:
        return summary + lacking
    return summary + _in_parts(before) + (_about_torque(run, whole) if {"Fz", "Tz"} <= set(record.axes) else "")


def _check_thrust(run: Run, evidence: Evidence, steady: str, *, fitted: bool) -> None:
    """Raise FitError where no motor of the platform has the thrust, measured or fitted."""
    rig, thrust_n, faults = _rig_around(run), column(evidence.points, "thrust_n"), list[str]()
    expected = range_of(_LARGEST_N, platform_of(rig))
    if thrust_n is None or np.isnan(thrust_n).all() or expected is None:
        return
    if (largest_n := float(np.nanmax(thrust_n))) > expected.largest:
        given = Given("largest thrust of a motor", largest_n, expected, "N")
        faults += [finding.text for finding in implausible_inputs([given], rig)]
    elif fitted:
        with suppress(FitError):
            findings = judged(fit_thrust(evidence), rig).findings
            faults += [one.text for one in findings if one.code == "implausible" and one.concerns(_LARGEST_N)]
    if faults:
        lines = (run.header.devices[LOADCELL].model_extra or {}).get("asked") == "lines"
        unit = "unit and scale of devices.loadcell in rig.toml" if lines else "the load cell's configuration"
        raise FitError(f"{steady}, but {faults[0]} Check {unit}, and which motors ran.")


def _about_torque(run: Run, evidence: Evidence) -> str:
    """Return why the fit of torque rejects a staircase; "" where it does not, or where rotors' torques cancel."""
    torque_nm = column(evidence.points, "torque_nm")
    if torque_nm is None or np.isnan(torque_nm).all():
        return ""
    try:
        result = judged(fit_torque(evidence), _rig_around(run))
        against = () if result.accepted else texts(result.findings, "rejection")
    except FitError as error:
        against = (str(error),)
    return f" Torque: `cfid fit torque` rejects it: {joined(against)}" if against else ""


def of_readings(run: Run) -> str:
    """Return how many steps have a reading, or what an instrument showed, and what their fit lacks.

    Raises DataError or FitError where the readings are rejected: where few steps have one, where one is implausible,
    where they follow no command, or because of the line through speeds.
    """
    plan = StaircasePlan.of_run(run)
    if not holds(run, READINGS):
        return _of_instrument(run, plan)
    columns = read_rows(run, READINGS).columns
    ((name, value),) = ((name, values) for name, values in columns.items() if name != "command")
    command, read, steps = columns["command"], int(np.count_nonzero(np.isfinite(value))), len(plan.steps)
    if read < _SHARE * steps:
        raise DataError(f"only {read} of {steps} steps have a reading.")
    markers, platform = run.header.rig.tachometer.markers, platform_of(_rig_around(run))
    if (expected := expected_of(name, motors=len(plan.motors), markers=markers, platform=platform)) is not None:
        # Readings of motors at rest, and the one furthest from the others.
        for place in (*np.flatnonzero(command == 0).tolist(), int(np.argmax(np.abs(value - np.median(value))))):
            others = np.delete(value, place).tolist()
            if fault := expected.fault(float(value[place]), others, command=float(command[place])):
                raise DataError(f"command {command[place]:.0f}: {fault}")
    summary = f"{counted(read, 'reading')} at {counted(steps, 'step')}, from {value.min():g} to {value.max():g}."
    return summary + (_about_speeds(run, command) if name == "rpm" else _about_weights(run))


def _of_instrument(run: Run, plan: StaircasePlan) -> str:
    """Return what a tachometer, scales or the vehicle's log showed, and what their fit lacks."""
    for device, (name, unit, shows) in _SHOWN.items():
        if not holds(run, device):
            continue
        _, command, value, _ = shown_at_commands(run, device, name)
        driven, readings = command[command > 0], value[command > 0]
        if not len(driven):
            raise DataError("no command was held to its end.")
        if not np.any(readings):
            raise DataError(f"{shows} 0 {unit} at every command: check the instrument and where it stands.")
        (low, first), (high, last) = ((driven[at], readings[at]) for at in (np.argmin(driven), np.argmax(driven)))
        summary = f"{shows} {first:.4g} {unit} at command {low:.0f} and {last:.4g} at command {high:.0f}"
        if high > low and abs(last - first) < _RISES * np.abs(readings).max():
            raise DataError(f"{summary}.")
        if device == SCALES:
            return f"{summary}.{_about_weights(run)}"
        markers = run.header.rig.tachometer.markers or 1
        turns = f"divided by {markers}, these are speeds of the rotor"
        return f"{summary} and counts {counted(markers, 'marker')} a turn: {turns}.{_about_speeds(run, driven)}"
    speeds = reported_speeds_rad_s(read_rows(run, VEHICLE_LOG)) if holds(run, VEHICLE_LOG) else {}
    if not any(np.any(speed > 0) for speed in speeds.values()):
        raise DataError("the vehicle's log has no speed above 0.")
    return f"the vehicle's log has the speeds.{_about_speeds(run, np.array(plan.steps))}"


def _too_few(command: Array, before: Mapping[str, Evidence], kind: str) -> str:
    """Return that a map needs points at more commands than these (n,) and earlier runs have; "" if they suffice."""
    needed = FEWEST_COMMANDS[kind]
    driven = np.concatenate([command, *(part.points["command"] for part in before.values())])
    count = len(np.unique(driven[driven > DEAD_COMMAND]))
    if count >= needed:
        return ""
    alone = f"together with {', '.join(before)}, which it completes" if before else "of its own"
    these = "these runs" if before else "this run"
    return (
        f" Too short for a map {alone}: `cfid fit {kind}` takes at least {needed} commands above {DEAD_COMMAND}, from "
        f"{these} and others, and {'here is 1' if count == 1 else f'here are {count}'}."
    )


def _in_parts(before: Mapping[str, Evidence]) -> str:
    """Return together with which completed runs a run gives a map, "" without any."""
    return f" It gives a map together with {', '.join(before)}, which it completes." if before else ""


def _beside(before: Mapping[str, Array]) -> str:
    """Return how a sentence on a run begins that names those before it, with their commands (n,); "" for none."""
    parts = [f"{name} (commands {commands.min():.0f} to {commands.max():.0f})" for name, commands in before.items()]
    return f"together with {', '.join(parts)}, which it completes: " if parts else ""


def _rig_around(run: Run) -> Rig | None:
    """Return the rig of the campaign to which a run belongs; the fit judges by it too."""
    campaign = find_campaign(None, start=run.folder.resolve().parent)
    return None if campaign is None else campaign.rig


def _about_speeds(run: Run, command: Array) -> str:
    """Return what a map of speeds at commands (n,) lacks, or with which runs, which this run completes, they give one.

    Raises FitError where `fit_speed` rejects it, and DataError where the run.toml of one of these runs is invalid.
    """
    before = of_completed(run)
    if lacking := _too_few(command, before, "speed"):
        return lacking
    result = judged(fit_speed([*before.values(), run], stand=counted_in(run)), _rig_around(run))
    if result.accepted:
        return _in_parts(before)
    counts_markers = holds(run, READINGS) or holds(run, TACHOMETER)
    implausible = any(finding.code == "implausible" for finding in result.findings)
    against = joined([*texts(result.findings, "rejection"), *[_MARKERS] * (counts_markers and implausible)])
    raise FitError(_beside({name: part.points["command"].to_numpy() for name, part in before.items()}) + against)


def _about_weights(run: Run) -> str:
    """Return what a run of scales lacks, "" where it verifies a map. Raises FitError where its weights cannot do so.

    The run is taken with those that it completes, as the fit takes it.
    """
    weighing = weighing_of(run)
    standing = weighing.command <= DEAD_COMMAND
    *before, _ = weighing.parts
    if standing.any() and not standing.all():
        try:
            weighing.thrust_n(USUAL_GRAVITY_MPS2)
        except FitError as error:
            raise FitError(f"{_beside({name: weighing.parts[name] for name in before})}{error}") from None
        return f" It gives or verifies a map with {', '.join(before)}, which it completes." if before else ""
    alone = f"Together with {', '.join(before)}, which it completes," if before else "Alone"
    return (
        f" {alone} it verifies no map: `cfid fit thrust` with `verify` takes a change of weight, from a reading at "
        f"command 0 to readings above {DEAD_COMMAND}."
    )
