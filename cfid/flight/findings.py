"""Judge what a flight cannot determine, and what contradicts the stated axes, motors and times."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from cfid.findings import Finding, note, rejection, warning
from cfid.flight.agreement import agreement_findings
from cfid.flight.braking import AxisDrag
from cfid.flight.channels import unit_of_rates
from cfid.flight.crossing import crossing_of
from cfid.flight.data import FlownLog
from cfid.flight.equations import DELAYS, THRUST, TURNS
from cfid.flight.estimation import EXPLAINED, FlightFit
from cfid.flight.excitation import CLEAR, CLIMB, LEAST_LIFT_MPS2, LEAST_TURN_RAD_PER_S2, LOOSE, lifted, turnings
from cfid.flight.gyro_unit import OF_ARM, unlike_arm
from cfid.flight.logged import spacing_findings, square_findings, weight_findings
from cfid.flight.moving import moving_findings
from cfid.flight.rows import ROW_S, Flight
from cfid.flight.turning import turning_findings
from cfid.flight.values import DELAY, MOMENTS, SINGLE, TIMES, Body, lever_m, thrust_key, times_of
from cfid.records.parameters import Parameter, plain

_LEAST_SPEED_MPS = 0.3  # root mean square along an axis
_EXPLAINED_DRAG = 0.8  # of the horizontal specific force: else wind or a tilted sensor decides
# Limits of a sensor's delay: time stamps err by some ms, and the fit searches up to 50 ms.
_FIRST_S, _LAST_S = -0.005, 0.045
_FED_BACK = 0.03  # of a moment: above it, a warning states how much older torques would change it
# The least change of a rate by torques: with less, older torques show noise alone. A smoothed gyro has 1.4 to 2.2.
_STILL_RAD_PER_S2 = 0.5
_DRAG = "flight.drag_over_mass_per_s.*", "flight.drag_kg_per_s.*"
_MANOEUVRES = {
    "roll": "tilt quickly to the right and left, several times a second, for 20 s",
    "pitch": "tilt quickly forward and back, several times a second, for 20 s",
    "yaw": "turn quickly left and right about the vertical for 20 s",
}


def contradictions(flown: FlownLog, found: FlightFit | None, arms_m: Sequence[float] = ()) -> tuple[Finding, ...]:
    """Return findings where a flight contradicts the stated axes, motors and times, or every one of some arms.

    `found` is a fit to it, None where there is none. Where rotors did not move the vehicle, sensors show no delay.
    """
    unlike = turning_findings(flown.flight)
    otherwise = (*unlike, *square_findings(flown), *([] if unlike else moving_findings(flown.flight)))
    if found is None:
        return otherwise
    # Rates about axes other than the torques' own show no delay.
    of_unit = [_other_unit(found, arm_m, unit_of_rates(flown.log)) for arm_m in arms_m]
    of_torques = (
        of_unit[0]
        if of_unit and all(of_unit)
        else _crossed(found) or _wrong_ways(found, props_out=flown.flight.props_out)
    )
    return (*otherwise, *([] if unlike else _delay_findings(found, ())), *of_torques)


def findings_of(
    flights: Sequence[FlownLog],
    found: FlightFit,
    drags: Mapping[str, AxisDrag | None],
    quantities: Mapping[str, Parameter],
    body: Body,
) -> tuple[Finding, ...]:
    """Judge a fit to flights, by what these excited and by what contradicts every quadrocopter."""
    unlike = [finding for one in flights for finding in turning_findings(one.flight)]
    of_motion = [] if unlike else [finding for one in flights for finding in moving_findings(one.flight, *_DRAG)]
    read = unit_of_rates(flights[0].log)
    of_unit = [] if body.arm_m is None else _other_unit(found, body.arm_m, read)
    of_torques = (
        unlike
        or _crossed(found)
        or of_unit
        or [*_moment_findings(found, body, flights[0]), *_unlike_arm(quantities, body)]
    )
    return (
        *(
            finding
            for one in flights
            for finding in (*spacing_findings(one), *square_findings(one), *weight_findings(one))
        ),
        *_supply_findings(found, body),
        *_thrust_findings(found, [one.flight for one in flights]),
        *of_torques,
        *of_motion,
        # With wrong axes, velocities explain little of the force, however much the vehicle moved.
        *([] if unlike or of_motion else _drag_findings(drags)),
    )


def _supply_findings(found: FlightFit, body: Body) -> list[Finding]:
    if found.in_volts or not body.load_sag_std:
        return []
    text = (
        "thrust is of commands, without the battery's voltage: a battery gives way under all rotors together, and "
        f"moments come out up to 15 % small. Their uncertainty contains {100 * body.load_sag_std:g} % for it: log "
        "pm.vbat."
    )
    return [warning("flight-voltage-unknown", text, *MOMENTS.values())]


def _crossed(found: FlightFit) -> list[Finding]:
    """Reject everything that depends on torques where these turn the vehicle about other axes than their own."""
    fault = crossing_of([block for block, _ in found.blocks], found.values).fault() if lifted(found) else None
    if fault is None:
        return []
    text = f"commanded torques turn the vehicle about other axes than their own: {fault}."
    return [rejection("flight-axes-crossed", text, *TIMES, *MOMENTS.values())]


def _thrust_findings(found: FlightFit, flights: Sequence[Flight]) -> list[Finding]:
    concerned = (thrust_key(found), *TIMES, *MOMENTS.values())
    lift = found.excitation["vertical"]
    unlike = agreement_findings(flights, found, concerned)
    if any(one.severity == "rejection" for one in unlike):
        return unlike
    if not lifted(found):
        text = (
            f"thrust is not excited: the rotors moved the vertical force by {lift:.2g} m/s^2 rms (at least "
            f"{LEAST_LIFT_MPS2:g}) and explain {100 * max(found.explained, 0):.0f} % of it (at least "
            f"{100 * EXPLAINED:.0f} %): {CLIMB}. Moments need the thrust."
        )
        return [rejection("flight-thrust-not-excited", text, *concerned)]
    result = [*unlike, *_delay_findings(found, concerned), *_lag_findings(found)]
    slope = np.array([0.0, 1.0, 2 * found.drive])
    gain, std = float(slope @ found.thrust), math.sqrt(float(slope @ found.covariance[THRUST, THRUST] @ slope))
    if not (gain > 0 and std < LOOSE * gain):
        text = (
            f"the slope of thrust over the drive at hovering is {gain:.3g} +- {std:.2g} m/s^2 (limit "
            f"{100 * LOOSE:.0f} %): {CLIMB}. Moments need it."
        )
        result.append(rejection("flight-thrust-not-excited", text, thrust_key(found), *MOMENTS.values()))
    return result


def _lag_findings(found: FlightFit) -> list[Finding]:
    """Reject each time constant that is too uncertain, and the moments if the sum of lag and delay is."""
    result = []
    for key, (tau_s, std_s) in times_of(found).items():
        if key != DELAY and not std_s < LOOSE * tau_s:
            text = (
                f"{key.removeprefix('flight.').removesuffix('_s').replace('_', ' ')}, {1e3 * tau_s:.0f} ms, is open by "
                f"{100 * std_s / tau_s:.0f} % (limit {100 * LOOSE:.0f} %): {CLIMB}."
            )
            result.append(rejection("flight-lag-not-excited", text, key, *(MOMENTS.values() if key == SINGLE else ())))
    return result


def _delay_findings(found: FlightFit, concerned: Sequence[str]) -> list[Finding]:
    """Reject everything where a sensor shows the rotors' effect before their command, or much later."""
    climbed = lifted(found)
    moved = climbed, climbed or any(one.tells for one in turnings(found))
    sensors = zip(("accelerometer", "gyro"), moved, found.values[DELAYS], found.std[DELAYS], strict=True)
    for sensor, moves, delay_s, std_s in sensors:
        if moves and not (delay_s + 3 * std_s > _FIRST_S and delay_s < _LAST_S):
            slow = delay_s > 0 and sensor == "accelerometer"
            text = (
                f"the {sensor} shows what rotors do {1e3 * abs(delay_s):.0f} ms "
                f"{'before' if delay_s < 0 else 'after'} their command: its times and those of the commands do not "
                "belong together"
                f"{', or its low-pass filter is slow (acc_lpf_hz, IMU_ACCEL_CUTOFF): set 50 Hz.' if slow else '.'}"
            )
            return [rejection("flight-delay-implausible", text, *concerned)]
    return []


def _moment_findings(found: FlightFit, body: Body, flown: FlownLog) -> list[Finding]:
    """Judge moments by the torques' effect about each axis; `flown` is the first flight."""
    result = _wrong_ways(found, props_out=flown.flight.props_out)
    question = " Is the gyro in rad/s?" if any(one.code == "log-units-by-names" for one in flown.findings) else ""
    within, lost_s = "", flown.in_air_s - flown.driven_s
    if lost_s > LOOSE * flown.in_air_s:
        within = f", so that no motor reaches idle or full command ({lost_s:.0f} s at and after these are left out)"
    for place, motion in enumerate(turnings(found)):
        axis = motion.name
        if lever_m(axis, body) is None:
            what = "the torque of a rotor over its thrust (`torque_m`)" if axis == "yaw" else "the arm (`arm_mm`)"
            result.append(note("flight-lever-unknown", f"no moment about {axis}: it needs {what}."))
            continue
        gain, std = float(found.values[TURNS][place]), float(found.std[TURNS][place])
        if gain == 0:
            text = f"the gyro shows no turning about {axis} at all: does it work, is it in the log?"
            result.append(rejection("flight-moment-not-excited", text, MOMENTS[axis]))
        elif motion.explained <= 0 and (gain < 0 or not std < LOOSE * gain):
            text = (
                f"rotors' torques explain nothing of how the rate about {axis} changed in the {ROW_S * found.rows:.0f} "
                f"s with every motor within its range: {_MANOEUVRES[axis]}{within}."
            )
            result.append(rejection("flight-moment-not-excited", text, MOMENTS[axis]))
        elif gain < 0 and -gain > 3 * std:
            continue
        elif (
            not std < LOOSE * abs(gain) and found.feedback[place] > LOOSE and found.excitation[axis] > _STILL_RAD_PER_S2
        ):
            text = (
                f"torques of 20 ms before would change the moment about {axis} by "
                f"{100 * found.feedback[place]:.0f} % more than noise explains (limit {100 * LOOSE:.0f} %): the "
                "gyro's rows are smoothed or interpolated, commands between rows are missing, or the rotors are no "
                "first-order lag. Lags rest on the same torques."
            )
            result.append(rejection("flight-torques-contradict", text, *TIMES, MOMENTS[axis]))
        elif not std < LOOSE * abs(gain):
            text = (
                f"the moment about {axis} is open by {100 * std / abs(gain):.0f} % (limit {100 * LOOSE:.0f} %): "
                f"{_MANOEUVRES[axis]}{within}."
            )
            result.append(rejection("flight-moment-not-excited", text, MOMENTS[axis]))
        elif not motion.is_large:
            text = (
                f"rotors' torques moved the rate about {axis} by {motion.moved:.2g} rad/s^2 rms, explain "
                f"{100 * max(motion.explained, 0):.0f} % of its changes, and leave its moment open by "
                f"{100 * motion.unclear:.2g} % for 20 s (at least {LEAST_TURN_RAD_PER_S2:g} rad/s^2, or "
                f"{100 * EXPLAINED:.0f} % and at most {100 * CLEAR:g} %): {_MANOEUVRES[axis]}{within}.{question}"
            )
            result.append(rejection("flight-moment-not-excited", text, MOMENTS[axis]))
        elif found.feedback[place] > _FED_BACK:
            change = 100 * found.feedback[place]
            text = (
                f"torques of 20 ms before would change the moment about {axis} by {change:.0f} % more than noise "
                "explains: the autopilot answers to the gyro's noise, or the rotors are no first-order lag. "
                "The standard uncertainty contains it."
            )
            result.append(warning("flight-older-torques-differ", text, MOMENTS[axis]))
    return result


def _unlike_arm(quantities: Mapping[str, Parameter], body: Body) -> list[Finding]:
    """Reject moments that no quadrocopter with such an arm has: its mass lies between its centre and its motors."""
    if body.arm_m is None:
        return []
    result = []
    for axis in ("roll", "pitch"):
        one = quantities.get(MOMENTS[axis])
        share = 0.0 if one is None else plain(one.value) / (body.mass_kg * body.arm_m**2)
        if share > 0 and not OF_ARM[0] < share < OF_ARM[1]:
            text = (
                f"the moment about {axis} is {share:.2g} times mass times arm squared, and quadrocopters have 0.2 to "
                f"0.4 (limits {OF_ARM[0]:g} and {OF_ARM[1]:g}): is the arm of {1e3 * body.arm_m:g} mm right?"
            )
            result.append(rejection("flight-moment-unlike-arm", text, MOMENTS[axis]))
    return result


def _other_unit(found: FlightFit, arm_m: float, read: str) -> list[Finding]:
    """Reject moments if they match the arm only with the gyro in another unit than the one in which it was `read`."""
    closed = bool(np.all(found.std[TURNS][:2] < LOOSE * np.abs(found.values[TURNS][:2])))
    text = unlike_arm(found, arm_m, read) if closed and lifted(found) else None
    return [] if text is None else [rejection("flight-gyro-unit", text, *MOMENTS.values())]


def _wrong_ways(found: FlightFit, *, props_out: bool) -> list[Finding]:
    gains, stds = found.values[TURNS], found.std[TURNS]
    wrong = [
        motion.name
        for gain, std, motion in zip(gains, stds, turnings(found), strict=True)
        if gain < -3 * std and motion.moved > 0 < motion.explained  # else the fitted gain is not an effect of torques
    ]
    if wrong == ["yaw"] and bool(np.all(gains[:2] > 3 * stds[:2])):
        # No other order of motors, and no other axes forward and left, leave roll and pitch as they are.
        stated, way = "than a Crazyflie's, the front right one clockwise", "give `props_out` if they do"
        if props_out:
            stated, way = "than stated, the front right one counterclockwise", "leave `props_out` away if it is given"
        text = (
            "commanded torques turn the vehicle the right way about roll and pitch, and the wrong way about yaw: its "
            f"rotors turn the other way {stated}, seen from above ({way}), or the gyro's z points down."
        )
        return [rejection("flight-rotors-turn-back", text, MOMENTS["yaw"])]
    return [
        rejection(
            "flight-wrong-way",
            f"commanded torques turn the vehicle the wrong way about {axis}: the log's axes are not forward, left "
            "and up, or its motors have other numbers (front right, rear right, rear left, front left).",
            *TIMES,
            MOMENTS[axis],
        )
        for axis in wrong
    ]


def _drag_findings(drags: Mapping[str, AxisDrag | None]) -> list[Finding]:
    if not any(drags.values()):
        text = "no drag: the logs have no velocity and attitude of motion capture (vx, vy, vz, qw, qx, qy, qz)."
        return [note("flight-no-velocity", text)]
    result = []
    for axis, one in drags.items():
        keys = f"flight.drag_over_mass_per_s.{axis}", f"flight.drag_kg_per_s.{axis}"
        if one is not None and (one.speed < _LEAST_SPEED_MPS or one.explained < _EXPLAINED_DRAG):
            text = (
                f"drag along {axis} is not excited: {one.speed:.2g} m/s rms (at least {_LEAST_SPEED_MPS:g}), of which "
                f"it explains {100 * max(one.explained, 0):.0f} % of the specific force (at least "
                f"{100 * _EXPLAINED_DRAG:.0f} %): fly back and forth along it at 1 m/s and more, without wind."
            )
            result.append(rejection("flight-drag-not-excited", text, *keys))
        elif one is not None and one.rate + 3 * one.std < 0:
            text = f"drag along {axis} would drive the vehicle: {one.rate:.3g} +- {one.std:.2g} 1/s. Check the axes."
            result.append(rejection("flight-wrong-way", text, *keys))
        elif one is not None and not one.std < LOOSE * abs(one.rate):
            text = f"drag along {axis} is open by {100 * one.std / abs(one.rate):.0f} %: fly faster, or longer."
            result.append(warning("flight-drag-loose", text, *keys))
    return result
