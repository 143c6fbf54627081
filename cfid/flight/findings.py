"""Judge flights: what they cannot determine, and what contradicts the stated axes, units, motors and times.

Rotors have to move a flight enough to show thrust and moments: else its autopilot only responds to the air. Sensors are
compared with each other, with motion capture in the same log, and with what every quadrocopter has. What is wrong is
named, with the numbers; what caused it is for the reader to find.
"""

import math
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, note, rejection, warning
from cfid.flight.braking import LEAST_EXPLAINED, LEAST_SPEED_MPS, AxisDrag
from cfid.flight.data import FlownLog
from cfid.flight.estimation import (
    CLIMB,
    EXPLAINED,
    FlightFit,
    explained_of,
    roughly_fitted,
)
from cfid.flight.model import DELAYS, THRUST, TURNS
from cfid.flight.rows import AXES, LEVER, ROW_S, Flight, segments
from cfid.flight.values import DELAY, MOMENTS, SINGLE, TIMES, Body, lever_m, thrust_key, times_of
from cfid.records.parameters import Parameter
from cfid.units import MOTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

LOOSE = 0.1  # of a value: the largest accepted standard uncertainty
LEAST_LIFT_MPS2 = 1.0  # root mean square of the rotors' vertical effect; see decision 22
LEAST_TURN_RAD_PER_S2 = 5.0  # root mean square; at 0.6 about yaw a public log gave 8e-5 kg m^2, others publish 3e-5
# Of a value: the largest uncertainty, scaled to 20 s, that is accepted with less motion; flights that hover have 0.09
# and more.
CLEAR, _CLEAR_S = 0.06, 20.0
# The part of the sensor's variance from which air matters little, however small the rotors' effect is. Simulated
# flights with gentle tilts, 1 to 5 rad/s^2, have 0.99 for rates and 0.95 for the force, those that hover 0.8 at most.
CALM = 0.9
_FED_BACK = 0.03  # of a moment: above it, a warning states how much older torques would change it
# The least change of a rate by torques: with less, older torques show noise alone. A smoothed gyro has 1.4 to 2.2.
_STILL_RAD_PER_S2 = 0.5
MANOEUVRES = {
    "roll": "tilt quickly to the right and left, several times a second, for 20 s",
    "pitch": "tilt quickly forward and back, several times a second, for 20 s",
    "yaw": "turn quickly left and right about the vertical for 20 s",
}

# Limits on the mean force of a flight, in g: less does not carry it, more means steep flight; public logs have 1.01 to
# 1.05.
_LIGHTEST, _HEAVIEST = 0.9, 1.3
_OF_ARM = 0.08, 0.9  # the moment over mass times arm squared: published quadrocopters have 0.2 to 0.4
# The limit on the unexplained part with one common thrust, relative to that with a thrust for each log, and the least
# unexplained part. Logs of one vehicle have 1.0 to 1.3; two thrusts that differ by 7 % have 2.7.
_WORSE, _UNEXPLAINED = 2.5, 0.05
# Limits of a sensor's delay: time stamps err by some ms, and the fit searches up to 50 ms.
_FIRST_S, _LAST_S = -0.005, 0.045


class Motion(NamedTuple):
    """The rotors' effect along the vertical, in m/s^2, or about an axis, in rad/s^2, and its part of the whole motion.

    `moved` is a root mean square, `explained` a part of the variance of means over 0.1 s, `open` the relative standard
    uncertainty of a rotor's effect per drive, and `unclear` the same uncertainty scaled to 20 s of such flight.
    """

    name: str
    moved: float
    least: float
    explained: float
    open: float
    unclear: float

    @property
    def is_large(self) -> bool:
        """Whether rotors moved the vehicle more than an autopilot's responses to air do, or air and noise are small."""
        calm = self.explained >= CALM or (self.explained >= EXPLAINED and self.unclear < CLEAR)
        return self.moved >= self.least or calm

    @property
    def tells(self) -> bool:
        """Whether the sensor shows the effect of a rotor's drive."""
        return self.is_large and self.explained >= EXPLAINED and self.open < LOOSE


def lifted(fit: FlightFit) -> bool:
    """Return whether rotors moved the vehicle up and down enough to fit their thrust."""
    return fit.excitation["vertical"] >= LEAST_LIFT_MPS2 and fit.explained >= EXPLAINED


def climbing(fit: FlightFit) -> Motion:
    """Return the rotors' effect along the vertical."""
    return _motion(fit, "vertical", None, LEAST_LIFT_MPS2, fit.explained)


def turnings(fit: FlightFit) -> list[Motion]:
    """Return the rotors' effect about each axis."""
    return [
        _motion(fit, axis, place, LEAST_TURN_RAD_PER_S2, explained_of(fit.blocks, place))
        for place, axis in enumerate(AXES)
    ]


def _motion(fit: FlightFit, name: str, place: int | None, least: float, explained: float) -> Motion:
    """Return the effect of a drive: thrust's slope, times the gain about an axis."""
    slope = np.array([0.0, 1.0, 2 * fit.drive])
    lift, gain = float(slope @ fit.thrust), 1.0 if place is None else float(fit.values[TURNS][place])
    is_open = math.inf
    if lift != 0 and gain != 0:
        shares = np.zeros(len(fit.values))
        shares[THRUST] = slope / lift
        if place is not None:
            shares[TURNS.start + place] = 1 / gain
        is_open = math.sqrt(float(shares @ fit.covariance @ shares))
    unclear = is_open * math.sqrt(fit.rows * ROW_S / _CLEAR_S)
    return Motion(name, fit.excitation[name], least, explained, is_open, unclear)


def contradictions(flown: FlownLog, fit: FlightFit | None, arms_m: Sequence[float] = ()) -> tuple[Finding, ...]:
    """Return findings where a flight contradicts the stated axes, motors and times, or every one of some arms.

    `fit` is a fit to it, None where there is none.
    """
    if fit is None:
        return tuple(square_findings(flown))
    of_torques = _torque_faults(fit, arms_m, props_out=flown.flight.props_out)
    return (*square_findings(flown), *delay_findings(fit, _moved(fit), ()), *of_torques)


def findings_of(
    flights: Sequence[FlownLog], fit: FlightFit, drags: Mapping[str, AxisDrag | None], body: Body
) -> tuple[Finding, ...]:
    """Judge a fit to flights, by what these excited and by what contradicts every quadrocopter."""
    arms_m = [] if body.arm_m is None else [body.arm_m]
    moved_unlike = any(one.code == "flight-velocity-unlike-force" for flown in flights for one in flown.findings)
    return (
        *(finding for flown in flights for finding in (*square_findings(flown), *weight_findings(flown))),
        *_supply_findings(flights, fit, body),
        *_thrust_findings(flights, fit),
        *_torque_faults(fit, arms_m, props_out=flights[0].flight.props_out),
        *_moment_findings(fit, body, flights[0]),
        # With wrong axes, velocities explain little of the force, however much the vehicle moved.
        *([] if moved_unlike else drag_findings(drags)),
    )


def _moved(fit: FlightFit) -> tuple[bool, bool]:
    """Return whether rotors moved the vehicle enough to show a delay of the accelerometer and of the gyro."""
    return lifted(fit), lifted(fit) or any(motion.tells for motion in turnings(fit))


def _torque_faults(fit: FlightFit, arms_m: Sequence[float], *, props_out: bool) -> list[Finding]:
    """Return what commanded torques contradict: an arm that no quadrocopter has, or their direction."""
    if not lifted(fit):
        return _wrong_ways(fit, props_out=props_out)
    return [*arm_findings(fit, arms_m), *_wrong_ways(fit, props_out=props_out)]


def _supply_findings(flights: Sequence[FlownLog], fit: FlightFit, body: Body) -> list[Finding]:
    """Warn of logs without a voltage, unless it is already stated that theirs is not used."""
    stated = any(finding.code == "flight-voltage-unknown" for flown in flights for finding in flown.findings)
    if fit.in_volts or stated or not body.load_sag_std:
        return []
    text = (
        "thrust is of commands, without the battery's voltage: a battery gives way under all rotors together, and "
        f"moments come out up to 15 % small. Their uncertainty contains {100 * body.load_sag_std:g} % for it: log "
        "pm.vbat."
    )
    return [warning("flight-voltage-unknown", text, *MOMENTS.values())]


def _thrust_findings(flights: Sequence[FlownLog], fit: FlightFit) -> list[Finding]:
    concerned = (thrust_key(fit), *TIMES, *MOMENTS.values())
    unlike = agreement_findings([flown.flight for flown in flights], fit, concerned)
    if any(finding.severity == "rejection" for finding in unlike):
        return unlike
    if not lifted(fit):
        text = (
            f"thrust is not excited: the rotors moved the vertical force by {fit.excitation['vertical']:.2g} m/s^2 rms "
            f"(at least {LEAST_LIFT_MPS2:g}) and explain {100 * max(fit.explained, 0):.0f} % of it (at least "
            f"{100 * EXPLAINED:.0f} %): {CLIMB}. Moments need the thrust."
        )
        return [rejection("flight-thrust-not-excited", text, *concerned)]
    findings = [*unlike, *delay_findings(fit, _moved(fit), concerned), *_lag_findings(fit)]
    slope = np.array([0.0, 1.0, 2 * fit.drive])
    gain, std = float(slope @ fit.thrust), math.sqrt(float(slope @ fit.covariance[THRUST, THRUST] @ slope))
    if not (gain > 0 and std < LOOSE * gain):
        text = (
            f"the slope of thrust over the drive at hovering is {gain:.3g} +- {std:.2g} m/s^2 (limit "
            f"{100 * LOOSE:.0f} %): {CLIMB}. Moments need it."
        )
        findings.append(rejection("flight-thrust-not-excited", text, thrust_key(fit), *MOMENTS.values()))
    return findings


def _lag_findings(fit: FlightFit) -> list[Finding]:
    """Reject each time constant that is too uncertain, and the moments if the sum of lag and delay is."""
    findings = []
    for key, (tau_s, std_s) in times_of(fit).items():
        if key != DELAY and not std_s < LOOSE * tau_s:
            text = (
                f"{key.removeprefix('flight.').removesuffix('_s').replace('_', ' ')}, {1e3 * tau_s:.0f} ms, is known "
                f"only to {100 * std_s / tau_s:.0f} % (limit {100 * LOOSE:.0f} %): {CLIMB}."
            )
            lost = MOMENTS.values() if key == SINGLE else ()
            findings.append(rejection("flight-lag-not-excited", text, key, *lost))
    return findings


def _moment_findings(fit: FlightFit, body: Body, flown: FlownLog) -> list[Finding]:
    """Judge moments by the torques' effect about each axis; `flown` is the first flight."""
    lost_s, within = flown.in_air_s - flown.driven_s, ""
    if lost_s > LOOSE * flown.in_air_s:
        within = f", so that no motor reaches idle or full command ({lost_s:.0f} s at and after these are left out)"
    findings = []
    for place, motion in enumerate(turnings(fit)):
        axis = motion.name
        if lever_m(axis, body) is None:
            what = "the torque over the thrust (`cfid fit torque`)" if axis == "yaw" else "the arm (`arm_mm`)"
            findings.append(note("flight-lever-unknown", f"no moment about {axis}: it needs {what}."))
            continue
        gain, std, fed_back = (float(values[place]) for values in (fit.values[TURNS], fit.std[TURNS], fit.feedback))
        loose = not std < LOOSE * abs(gain)
        older = (
            f"torques of 20 ms before would change the moment about {axis} by {100 * fed_back:.0f} % more than noise "
            "explains"
        )
        if gain < -3 * std and motion.explained > 0:
            continue  # the torques turn the vehicle the wrong way, which is another finding
        if loose and fed_back > LOOSE and fit.excitation[axis] > _STILL_RAD_PER_S2 and motion.explained > 0:
            text = (
                f"{older} (limit {100 * LOOSE:.0f} %): the gyro's rows are smoothed or interpolated, commands between "
                "rows are missing, or the rotors are no first-order lag. Lags rest on the same torques."
            )
            findings.append(rejection("flight-torques-contradict", text, *TIMES, MOMENTS[axis]))
        elif loose or gain < 0 or not motion.is_large:
            text = (
                f"rotors' torques moved the rate about {axis} by {motion.moved:.2g} rad/s^2 rms and explain "
                f"{100 * max(motion.explained, 0):.0f} % of its changes in {ROW_S * fit.rows:.0f} s; the moment is "
                f"known to {100 * std / max(abs(gain), 1e-300):.0f} % (limit {100 * LOOSE:.0f} %), for 20 s to "
                f"{100 * motion.unclear:.0f} % (at least {LEAST_TURN_RAD_PER_S2:g} rad/s^2, or {100 * EXPLAINED:.0f} % "
                f"and {100 * CLEAR:g} % for 20 s): {MANOEUVRES[axis]}{within}."
            )
            findings.append(rejection("flight-moment-not-excited", text, MOMENTS[axis]))
        elif fed_back > _FED_BACK:
            text = (
                f"{older}: the autopilot answers to the gyro's noise, or the rotors are no first-order lag. The "
                "standard uncertainty contains it."
            )
            findings.append(warning("flight-torques-contradict", text, MOMENTS[axis]))
    return findings


def _wrong_ways(fit: FlightFit, *, props_out: bool) -> list[Finding]:
    """Reject moments and lags where torques turn the vehicle the wrong way; of yaw alone, its moment.

    With roll and pitch right, the reason is the rotors' direction, or the gyro's z: no other order of motors, and no
    other axes forward and left, leave roll and pitch as they are.
    """
    gains, stds = fit.values[TURNS], fit.std[TURNS]
    wrong = [
        motion.name
        for gain, std, motion in zip(gains, stds, turnings(fit), strict=True)
        if gain < -3 * std and motion.moved > 0 < motion.explained  # else the fitted gain is not an effect of torques
    ]
    lost: tuple[str, ...] = TIMES
    reason = "its axes are not forward, left and up, or motors are not front right, rear right, rear left, front left"
    if wrong == ["yaw"] and bool(np.all(gains[:2] > 3 * stds[:2])):
        way = "as a Crazyflie's do (leave `props_out` away)" if props_out else "opposite to a Crazyflie's (`props_out`)"
        lost, reason = (), f"rotors turn {way}, or the gyro's z points down"
    return [
        rejection(
            "flight-wrong-way",
            f"commanded torques turn the vehicle the wrong way about {axis}: {reason}.",
            *lost,
            MOMENTS[axis],
        )
        for axis in wrong
    ]


def drag_findings(drags: Mapping[str, AxisDrag | None]) -> list[Finding]:
    """Judge drag by how much the vehicle moved, and by what drag explains."""
    findings = []
    for axis, drag in drags.items():
        keys = f"flight.drag_over_mass_per_s.{axis}", f"flight.drag_kg_per_s.{axis}"
        if drag is None:
            continue
        text = (
            f"drag along {axis} is {drag.rate:.3g} +- {drag.std:.2g} 1/s (limit {100 * LOOSE:.0f} %), from "
            f"{drag.speed:.2g} m/s rms (at least {LEAST_SPEED_MPS:g}), which explain "
            f"{100 * max(drag.explained, 0):.0f} % of the specific force (at least {100 * LEAST_EXPLAINED:.0f} %): fly "
            "back and forth along it at 1 m/s and more, without wind."
        )
        if not drag.excited:
            findings.append(rejection("flight-drag-not-excited", text, *keys))
        elif drag.rate + 3 * drag.std < 0:
            text = f"drag along {axis} would drive the vehicle: {drag.rate:.3g} +- {drag.std:.2g} 1/s. Check the axes."
            findings.append(rejection("flight-wrong-way", text, *keys))
        elif not drag.std < LOOSE * abs(drag.rate):
            findings.append(warning("flight-drag-not-excited", text, *keys))
    return findings


def determined(quantities: Mapping[str, Parameter], findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the keys that the flights determine; all keys where they determine none."""
    lost = [key for finding in findings if finding.severity == "rejection" for key in finding.quantities]
    return tuple(key for key in quantities if not any(fnmatchcase(key, each) for each in lost)) or tuple(quantities)


# What contradicts the stated axes, units, motors and channels


def square_findings(flown: FlownLog) -> list[Finding]:
    """Reject roll and pitch moments where the log does not place four rotors on a square."""
    facts = flown.log.facts
    if facts.square is not False and facts.motors in (None, len(MOTORS)):
        return []
    text = (
        "the log places no four rotors at the corners of a square: moments about roll and pitch are fitted for these "
        "alone."
    )
    return [rejection("flight-rotors-off-square", text, MOMENTS["roll"], MOMENTS["pitch"]).at(flown.log.path.name)]


def weight_findings(flown: FlownLog) -> list[Finding]:
    """Judge specific forces in the air: their mean has to carry the vehicle."""
    force = flown.flight.force[flown.flight.airborne]
    if not len(force):
        return []
    size = float(np.mean(np.linalg.norm(force, axis=1))) / USUAL_GRAVITY_MPS2
    text = (
        f"the accelerometer shows {size:.2f} g in the mean of the flight, which carries the vehicle with 1 g where it "
        f"hovers (limits {_LIGHTEST:g} and, without steep turns, {_HEAVIEST:g}): see its scale, which thrust and "
        "moments have."
    )
    keys = ("flight.thrust*", *MOMENTS.values())
    findings = []
    if size < _LIGHTEST:
        findings.append(rejection("flight-weight-unlike", text, *keys))
    elif size > _HEAVIEST:
        findings.append(warning("flight-weight-unlike", text, *keys))
    return [each.at(flown.flight.name) for each in findings]


def arm_findings(fit: FlightFit, arms_m: Sequence[float]) -> list[Finding]:
    """Reject moments that no quadrocopter with one of these arms has: its mass lies between its centre and its motors.

    A gyro that was read in another unit makes them 57 times as large, or as small.
    """
    for place, axis in enumerate(AXES[:2]):
        gain, std = float(fit.values[TURNS][place]), float(fit.std[TURNS][place])
        shares = [LEVER / (gain * arm_m) for arm_m in arms_m if gain > 3 * std]
        if shares and not any(_OF_ARM[0] < share < _OF_ARM[1] for share in shares):
            text = (
                f"the moment about {axis} is {shares[0]:.2g} times mass times arm squared, and quadrocopters have 0.2 "
                f"to 0.4 (limits {_OF_ARM[0]:g} and {_OF_ARM[1]:g}): see the arm of {1e3 * arms_m[0]:g} mm, and the "
                "unit of the gyro, which the header of a table states as in gyro.x [deg/s]."
            )
            return [rejection("flight-moment-unlike-arm", text, *MOMENTS.values())]
    return []


def delay_findings(fit: FlightFit, moved: tuple[bool, bool], concerned: Sequence[str]) -> list[Finding]:
    """Reject everything where a sensor shows the rotors' effect before their command, or much later.

    `moved` states whether rotors moved what accelerometer and gyro show: without that, these show no delay.
    """
    sensors = zip(("accelerometer", "gyro"), moved, fit.values[DELAYS], fit.std[DELAYS], strict=True)
    for sensor, moves, delay_s, std_s in sensors:
        if moves and not (delay_s + 3 * std_s > _FIRST_S and delay_s < _LAST_S):
            text = (
                f"the {sensor} shows what rotors do {1e3 * delay_s:.0f} ms after their command (limits "
                f"{1e3 * _FIRST_S:.0f} and {1e3 * _LAST_S:.0f} ms): its times and those of the commands do not belong "
                "together, or its low-pass filter is slow (acc_lpf_hz, IMU_ACCEL_CUTOFF): set 50 Hz."
            )
            return [rejection("flight-delay-implausible", text, *concerned)]
    return []


def agreement_findings(flights: Sequence[Flight], fit: FlightFit, concerned: Sequence[str]) -> list[Finding]:
    """Report logs whose vertical force one common thrust explains far worse than a separate thrust for each log.

    All thrusts are fitted with coarse lags. The `concerned` keys are rejected where the fit to all logs explains too
    little.
    """
    flown = [flight for flight in flights if segments(flight.driven)]
    if len(flown) < 2:
        return []
    separate = [roughly_fitted(flight) for flight in flown]
    apart, together = (explained_of(each, None) for each in (sum(map(tuple, separate), ()), roughly_fitted(*flown)))
    if 1 - together < max(_WORSE * (1 - apart), _UNEXPLAINED):
        return []
    share = ", ".join(
        f"{flight.name} {100 * explained_of(each, None):.0f} %" for flight, each in zip(flown, separate, strict=True)
    )
    text = (
        "the logs contradict each other: rotors explain the vertical force with a thrust of its own in each log "
        f"({share}) and {100 * min(together, fit.explained):.0f} % of it with one thrust in all. Another vehicle, "
        "mass, propeller or battery is in one of them: fit the logs of each apart."
    )
    if fit.explained < EXPLAINED:
        return [rejection("flight-logs-contradict", text, *concerned)]
    return [warning("flight-logs-contradict", text, *concerned)]
