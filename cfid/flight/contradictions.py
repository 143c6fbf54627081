"""Find what contradicts the stated axes, units, motors and channels of a flight: each protects numbers of its fit.

Sensors are compared with each other, with motion capture in the same log, and with what every quadrocopter has. What is
wrong is named, with the numbers; what caused it is for the reader to find.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls
from scipy.signal import lfilter

from cfid.estimate.signals import block_means
from cfid.findings import Finding, rejection, warning
from cfid.flight.data import FlownLog
from cfid.flight.estimation import (
    CROSSED,
    EXPLAINED,
    FlightFit,
    crossing_of,
    explained_of,
    fit_alone,
    is_crossed,
    roughly_fitted,
)
from cfid.flight.model import DELAYS, SAG_S, TURNS, filtering_s
from cfid.flight.rows import AXES, LEVER, ROW_S, STEP_S, Flight, delayed, segments, turned_back
from cfid.flight.values import MOMENTS, TIMES
from cfid.recordings.crazyflie import Timed
from cfid.units import MOTORS, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

# Of means over 0.1 s, since an attitude's rows are noisy and may come at 30 Hz: the correlation from which two rates
# are alike (public logs have 0.7 to 0.9), its excess over that with the axis of the same name, and the ratio of rates.
_SMOOTHED_ROWS, _FEWEST_ROWS = 10, 500
_ALIKE, _MORE_ALIKE, _FASTER = 0.5, 0.2, 2.0
# Over half a second, the velocity changes by the integral of the specific force, turned to the world's axes, plus
# gravity. Public logs agree within 1.1 %, simulated flights that hover within 7 %. Smaller motion than this root mean
# square may be noise of the accelerometer.
_OVER_ROWS, _LARGEST, _MOVES_MPS = 50, 1.2, 0.3
_STUCK = 0.1  # of the gyro's rotation: an attitude that turns less is stuck
# Limits on the mean force of a flight, in g: less does not carry it, more means steep flight; public logs have 1.01 to
# 1.05.
_LIGHTEST, _HEAVIEST = 0.9, 1.3
_TILTED_DEG = 6.0  # public logs: 0.2 to 1.0
_OF_ARM = 0.08, 0.9  # the moment over mass times arm squared: published quadrocopters have 0.2 to 0.4
# The limit on the unexplained part with one common thrust, relative to that with a thrust for each log, and the least
# unexplained part. Logs of one vehicle have 1.0 to 1.3; two thrusts that differ by 7 % have 2.7.
_WORSE, _UNEXPLAINED = 2.5, 0.05
# Limits of a sensor's delay: time stamps err by some ms, and the fit searches up to 50 ms.
_FIRST_S, _LAST_S = -0.005, 0.045

_VOLTS_APART_S = 0.02  # the largest time between values of the voltage
_SMOOTHED_S = (0.0, *np.geomspace(0.003, 1.0, 30).tolist())  # first-order low-passes that its record may have
_LEAST_SHOWN = 0.5  # of its variance within 5 s: what the load has to explain
# Of what remains unexplained without smoothing: a motor's current that leads its speed is much like one.
_CLEARLY = 0.85
_LATE_S = 0.01  # the largest time constant of a low-pass: moments then err by 0.3 % at most
_RELAXING_S = 1.5  # the time in which a cell sags further
_MEAN_S = 0.02  # over which values are averaged: otherwise, noise of 20 mV in rows of 2 ms hides the load


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
    """Judge specific forces in the air: their mean has to carry the vehicle, and point along z where it hovers."""
    force = flown.flight.force[flown.flight.airborne]
    if not len(force):
        return []
    size = float(np.mean(np.linalg.norm(force, axis=1))) / USUAL_GRAVITY_MPS2
    mean = np.mean(force, axis=0)
    tilt_deg = math.degrees(math.atan2(math.hypot(mean[0], mean[1]), mean[2]))
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
    if tilt_deg > _TILTED_DEG:
        text = (
            f"the specific force is {tilt_deg:.0f} degrees off z in the mean (limit {_TILTED_DEG:g}): fast flight one "
            "way, wind, or a tilted accelerometer, which makes thrust and moments wrong."
        )
        findings.append(warning("flight-force-tilted", text, *keys))
    return [each.at(flown.flight.name) for each in findings]


def turning_fault(flight: Flight) -> str | None:
    """Return how the gyro turns unlike the attitude in the same log, which needs no motors; None if it does not."""
    gyro, shown = _rates_of_both(flight)
    sizes = [np.maximum(np.linalg.norm(rates, axis=0), 1e-12) for rates in (gyro, shown)]
    alike = gyro.T @ shown / np.outer(*sizes)
    faults = []
    for place, axis in enumerate(AXES):
        other = int(np.argmax(np.abs(alike[place])))
        if abs(alike[place, other]) > _ALIKE and abs(alike[place, other]) > alike[place, place] + _MORE_ALIKE:
            way = "as" if alike[place, other] > 0 else "against"
            faults.append(f"about {axis} {way} the attitude about {AXES[other]}")
        ratio = float(sizes[0][place] / sizes[1][place])
        if alike[place, place] > _ALIKE and not 1 / _FASTER < ratio < _FASTER:
            faults.append(f"about {axis} {ratio:.3g} times as fast as the attitude")
    return f"the gyro turns {', '.join(faults)}: see the axes and units of both." if faults else None


def turning_findings(flight: Flight) -> list[Finding]:
    """Reject a flight whose gyro and attitude turn about different axes, opposite ways, or not as fast."""
    fault = turning_fault(flight)
    return [] if fault is None else [rejection("flight-gyro-unlike-attitude", fault).at(flight.name)]


def velocity_findings(flight: Flight, *concerned: str) -> list[Finding]:
    """Reject quantities if velocities of motion capture do not change as accelerations, turned to the world, add up to.

    They are of another unit, or along other axes than the attitude's world, or the attitude is stuck.
    """
    parts = segments(flight.airborne)
    if flight.velocity is None or flight.attitude is None or not parts:
        return []
    to_world = flight.attitude * [1, -1, -1, -1]
    added = ROW_S * turned_back(to_world, flight.force)
    expected = _changes([np.cumsum(added[part], axis=0) for part in parts])
    velocity = turned_back(to_world, flight.velocity)
    shown = _changes([velocity[part] for part in parts])
    moved_mps = float(np.linalg.norm(expected)) / math.sqrt(len(expected))
    share = float(np.sum(shown * expected)) / max(float(np.sum(expected**2)), 1e-300)
    gyro, turned = (float(np.linalg.norm(rates)) for rates in _rates_of_both(flight))
    if share < _LARGEST and (share > 1 / _LARGEST or moved_mps < _MOVES_MPS) and turned >= _STUCK * gyro:
        return []
    text = (
        f"velocities show {share:.3g} of what accelerations, turned to the world by the attitude, add up to over 0.5 s "
        f"(limits {1 / _LARGEST:.2g} and {_LARGEST:g}), and the attitude turns {turned / max(gyro, 1e-300):.2g} times "
        f"as much as the gyro (at least {_STUCK:g}), and drag is wrong: give vx, vy and vz in m/s along the world's "
        "axes of the attitude, z up, and check that the attitude is tracked."
    )
    return [rejection("flight-velocity-unlike-force", text, *concerned).at(flight.name)]


def crossing_findings(fit: FlightFit) -> list[Finding]:
    """Reject everything that depends on torques where these turn the vehicle about other axes than their own."""
    if not is_crossed(*crossing_of(fit.blocks, fit.values)):
        return []
    return [rejection("flight-axes-crossed", CROSSED, *TIMES, *MOMENTS.values())]


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
    separate = [roughly_fitted([flight]) for flight in flown]
    apart, together = (explained_of(each, None) for each in (sum(map(tuple, separate), ()), roughly_fitted(flown)))
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


def with_usable_voltages(flights: Sequence[FlownLog], fit: FlightFit) -> Sequence[FlownLog]:
    """Return the flights; if a voltage lacks the sag under load, all of them by commands alone, with findings on it.

    A battery's voltage drops within milliseconds of its rotors' load, and by up to as much again within 1.5 s. Drives
    from a record that lacks this sag make moments 4 to 10 % too small; those of commands alone have an uncertainty that
    contains it (`values.LOAD_SAG_STD`). `fit` is a fit to these flights, which gives the rotors' lag.
    """
    faults = [_voltage_fault(flown, flown.voltmeter, fit) if flown.voltmeter else None for flown in flights]
    if not (fit.in_volts and any(faults)):
        return flights
    usable = []
    for flown, fault in zip(flights, faults, strict=True):
        findings = flown.findings
        if fault is not None:
            text = (
                f"the battery's voltage {fault}: it is not used, thrust is that of the commands, and moments come out "
                "up to 15 % small, which their uncertainty contains. Log pm.vbat at 100 Hz or more, not smoothed."
            )
            findings = *findings, warning("flight-voltage-unknown", text, *MOMENTS.values()).at(flown.flight.name)
        usable.append(replace(flown, flight=flown.by_command, findings=findings))
    return usable


def with_usable_voltage(flown: FlownLog) -> FlownLog:
    """Return a flight as `with_usable_voltages` does, unchanged if it cannot be fitted.

    Raises CrossedError for motors in another order.
    """
    fit = fit_alone(flown.flight) if flown.flight.in_volts else None
    return flown if fit is None else with_usable_voltages([flown], fit)[0]


def _voltage_fault(flown: FlownLog, voltmeter: Timed, fit: FlightFit) -> str | None:
    """Return how a record of the battery's voltage lacks sag under load, None if it does not.

    The record is what changes within 5 s and slower, minus the load behind a first-order low-pass. The load is a sum,
    with non-negative factors, of the squares of the commands (a motor's current leads its speed), the squares of the
    drives that follow them, and the latter with the cell's slow relaxation.
    """
    flight = flown.by_command
    in_air = np.interp(voltmeter.time_s, flight.time_s, flight.airborne.astype(float), left=0.0, right=0.0) == 1.0
    time_s, volts = voltmeter.time_s[in_air], voltmeter.value[in_air]
    apart_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else math.inf
    if not apart_s <= _VOLTS_APART_S:
        return f"has values {1e3 * apart_s:.0f} ms apart (limit {1e3 * _VOLTS_APART_S:.0f} ms)"
    delay_s = max(float(fit.values[DELAYS][1]) - filtering_s(flight.low_pass_hz[1]), 0.0)
    command = delayed(flight.drive, delay_s)
    loads = np.column_stack([np.sum(drive**2, axis=1) for drive in (command, fit.lag.follow(command))])
    loads = np.column_stack([loads, loads[:, 1:] + _low_passed(loads[:, 1:], _RELAXING_S)])
    at_s = STEP_S * (np.arange(len(loads)) + 0.5)

    length = max(round(_MEAN_S / apart_s), 1)
    phase = np.linspace(0, np.pi, len(block_means(volts, length=length)))
    slow = [np.cos(count * phase) for count in range(1 + max(round(length * apart_s * len(phase) / SAG_S), 1))]
    basis = np.linalg.qr(np.column_stack(slow))[0]

    def quick(columns: Array) -> Array:
        means = np.column_stack([block_means(column, length=length) for column in columns.T])
        return np.asarray(means - basis @ (basis.T @ means))

    shown = quick(volts[:, np.newaxis])[:, 0]
    unexplained = []
    for smoothed_s in _SMOOTHED_S:
        smoothed = _low_passed(loads, smoothed_s)
        _, error = nnls(quick(np.column_stack([np.interp(time_s, at_s, load) for load in smoothed.T])), -shown)
        unexplained.append(error**2 / max(float(shown @ shown), 1e-300))
    best = int(np.argmin(unexplained))
    if unexplained[best] > 1 - _LEAST_SHOWN:
        explained = 100 * (1 - unexplained[best])
        return f"does not show what rotors draw, which explains {explained:.0f} % of how it changes within 5 s"
    if unexplained[best] < _CLEARLY * unexplained[0] and _SMOOTHED_S[best] > _LATE_S:
        return f"is late, as if smoothed by {1e3 * _SMOOTHED_S[best]:.0f} ms (limit {1e3 * _LATE_S:.0f} ms)"
    return None


def _low_passed(loads: Array, for_s: float) -> Array:
    share = 1 - math.exp(-STEP_S / for_s) if for_s else 1.0
    return np.asarray(loads[0] + lfilter([share], [1.0, share - 1], loads - loads[0], axis=0))


def _rates_of_both(flight: Flight) -> tuple[Array, Array]:
    """Return smoothed rates (k, 3) of gyro and attitude in the air without their means, no rows for less than 5 s."""
    known = flight.airborne[1:] & flight.airborne[:-1]
    if flight.attitude is None or np.count_nonzero(known) < _FEWEST_ROWS:
        return np.zeros((0, 3)), np.zeros((0, 3))
    attitude = flight.attitude
    turned = attitude[1:] - attitude[:-1]
    w, vector = attitude[:-1, :1], attitude[:-1, 1:]
    # Twice the vector part of the quaternion's conjugate times its change is the rotation vector.
    of_attitude = 2 / ROW_S * (w * turned[:, 1:] - turned[:, :1] * vector - np.cross(vector, turned[:, 1:]))
    smooth = (
        uniform_filter1d(rates, _SMOOTHED_ROWS, axis=0)[known]
        for rates in ((flight.rates[1:] + flight.rates[:-1]) / 2, of_attitude)
    )
    gyro, shown = (rates - rates.mean(axis=0) for rates in smooth)
    return gyro, shown


def _changes(parts: Sequence[Array]) -> Array:
    """Return the changes (k, 3) of the columns of parts (n, 3) over half a second, without their mean."""
    changes = np.concatenate([part[_OVER_ROWS:] - part[:-_OVER_ROWS] for part in parts])
    return np.asarray(changes - changes.mean(axis=0))
