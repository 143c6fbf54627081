"""What flights tell of a vehicle: quantities, findings, and lines on what was assumed and excited."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.estimate.common_causes import Cause, power_law, with_common_causes
from cfid.estimate.linear import std_of
from cfid.findings import Finding, note, rejection, warning
from cfid.flight.braking import DragFit, fit_drag
from cfid.flight.data import FlownLog
from cfid.flight.estimation import DELAYS, LAGS, THRUST, TURNS, FlightFit, fit_flights
from cfid.flight.figures import flight_figure
from cfid.flight.model import AXES, LEVER
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result
from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]

_DRAG_AXES = ("forward", "left")
_MOMENTS = {axis: f"flight.inertia_kg_m2.{axis}" for axis in AXES}
_RISING, _FALLING, _MEAN = "flight.rising_s", "flight.falling_s", "flight.time_constant_s"
_DELAY, _SINGLE = "flight.delay_s", "flight.single_lag_s"
_LAGS = (_RISING, _FALLING, _MEAN, _DELAY, _SINGLE)
# What these are of the time constants and the delays of accelerometer and gyro.
_TIMES = {
    _RISING: (1.0, 0.0, 0.0, 0.0),
    _FALLING: (0.0, 1.0, 0.0, 0.0),
    _MEAN: (0.5, 0.5, 0.0, 0.0),
    _DELAY: (0.0, 0.0, 0.0, 1.0),
    _SINGLE: (0.5, 0.5, 1.0, 0.0),
}

_LEAST_LIFT_MPS2 = 1.0  # root mean square of what rotors did vertically; see docs/decisions/0022
_EXPLAINED = 0.6  # of the vertical force, as `fit dynamics` asks of a thrust
_LOOSE_LAG, _LOOSE = 0.1, 0.1  # of a value: the largest accepted standard uncertainty
_LEAST_SPEED_MPS = 0.3  # root mean square along an axis
_EXPLAINED_DRAG = 0.8  # of the horizontal specific force: else wind or a tilted sensor decides
_LEAST_TURN_RAD_PER_S2 = 5.0  # root mean square; with 0.6 about yaw a public log gave 8e-5 kg m^2, others publish 3e-5
_FED_BACK = 0.03  # of a moment, from where a warning names what older torques would change
_MANOEUVRES = {
    "roll": "tilt quickly to the right and left, several times a second, for 20 s",
    "pitch": "tilt quickly forward and back, several times a second, for 20 s",
    "yaw": "turn quickly left and right about the vertical for 20 s",
}


@dataclass(frozen=True, kw_only=True)
class Body:
    """What a flight cannot tell: mass, arm from the centre to a motor's axis, torque of a rotor over its thrust.

    Each has its standard uncertainty; None is unknown.
    """

    mass_kg: float
    mass_std_kg: float
    arm_m: float | None = None
    arm_std_m: float | None = None
    torque_m: float | None = None
    torque_std_m: float | None = None


def fit(flights: Sequence[FlownLog], *, body: Body) -> Result:
    """Fit thrust, lag, moments of inertia and drag of one vehicle to its flights, as far as these determine them.

    Raises ConfigError for no flight, DataError for one given twice or with drives in other units, FitError where
    nothing flew for long enough.
    """
    _check(flights)
    found = fit_flights([one.flight for one in flights])
    drags = {name: fit_drag([one.flight for one in flights], axis=axis) for axis, name in enumerate(_DRAG_AXES)}
    measured = {**_quantities(found, body), **_drag_quantities(drags, body)}
    quantities = {**measured, **_given(body)}
    findings = (
        *(finding for one in flights for finding in one.findings),
        *_thrust_findings(found),
        *_moment_findings(found, body),
        *_drag_findings(drags),
    )
    name = flights[0].flight.name

    def drawings() -> Figures:
        return {f"fit_flight_{name}": flight_figure(found, drags, findings, title=", ".join(map(_name, flights)))}

    result = Result(
        command="fit flight",
        method="default",
        quantities=quantities,
        wanted=_wanted(measured, findings),
        findings=findings,
        merits={
            "rows": found.rows,
            "explained_vertical": found.explained,
            "excitation": dict(found.excitation),
            "drag_explained": {axis: one.explained for axis, one in drags.items() if one is not None},
        },
        sources=tuple(one.log.source for one in flights),
        covariances=_covariances(found, body),
        lines=(*_lines(flights, found, drags), *_assumptions(body)),
        drawings=drawings,
        folder=flights[0].log.path.parent,
    )
    return with_common_causes(result, power_law(quantities, *_causes(body)))


def _check(flights: Sequence[FlownLog]) -> None:
    if not flights:
        raise ConfigError("nothing to fit: give a LOG of a flight.")
    for place, one in enumerate(flights):
        if any(one.log.source.sha256 == before.log.source.sha256 for before in flights[:place]):
            raise DataError(f"{one.log.path}: the same log as before: name each once.")
        if one.flight.in_volts != flights[0].flight.in_volts:
            raise DataError(f"{one.log.path}: only some of the logs have the battery's voltage: fit them apart.")


def _name(one: FlownLog) -> str:
    return one.flight.name


def _thrust_key(found: FlightFit) -> str:
    return "flight.thrust_voltage_poly" if found.in_volts else "flight.thrust_poly"


def _quantities(found: FlightFit, body: Body) -> dict[str, Parameter]:
    value, covariance = _of_thrust(found, body)
    std = found.std
    times = np.array(list(_TIMES.values()))
    times_std = std_of(times @ found.covariance[: DELAYS.stop, : DELAYS.stop] @ times.T)
    quantities = {
        _thrust_key(found): Parameter(value=value.tolist(), std=std_of(covariance).tolist()),
        **{
            key: Parameter(value=float(each), std=float(wide))
            for key, each, wide in zip(_TIMES, times @ found.values[: DELAYS.stop], times_std, strict=True)
        },
    }
    for place, axis in enumerate(AXES):
        lever = _lever_m(axis, body)
        gain, gain_std = float(found.values[TURNS][place]), float(std[TURNS][place])
        if lever is not None:
            moment = lever * body.mass_kg / gain
            quantities[_MOMENTS[axis]] = Parameter(value=moment, std=abs(moment * gain_std / gain))
    return quantities


def _lever_m(axis: str, body: Body) -> float | None:
    if axis == "yaw":
        return body.torque_m
    return None if body.arm_m is None else LEVER * body.arm_m


def _of_thrust(found: FlightFit, body: Body) -> tuple[Array, Array]:
    """Return one rotor's thrust polynomial (3,) in its key's order and units, with its covariance (3, 3)."""
    over = 1.0 if found.in_volts else FULL_COMMAND
    outward = np.diag(body.mass_kg / over ** np.arange(3.0))
    if not found.in_volts:
        outward = outward[::-1]
    return outward @ found.thrust, outward @ found.covariance[THRUST, THRUST] @ outward.T


def _covariances(found: FlightFit, body: Body) -> tuple[Covariance, ...]:
    value, covariance = _of_thrust(found, body)
    return (
        *covariance_between({_thrust_key(found): value.tolist()}, covariance),
        *covariance_between({_RISING: found.lag.rising_s, _FALLING: found.lag.falling_s}, found.covariance[LAGS, LAGS]),
    )


def _causes(body: Body) -> tuple[dict[str, dict[Cause, float]], dict[str, dict[str, float]]]:
    mass = Cause("mass", body.mass_std_kg / body.mass_kg)
    arm = Cause("arm", None if not body.arm_m or body.arm_std_m is None else body.arm_std_m / body.arm_m)
    torque_std = None if not body.torque_m or body.torque_std_m is None else body.torque_std_m / body.torque_m
    torque = Cause("torque over thrust", torque_std)
    measured: dict[str, dict[Cause, float]] = {"kg": {mass: 1.0}, "N": {mass: 1.0}}
    if body.arm_m is not None:
        measured["m"] = {arm: 1.0}
    if body.torque_m is not None:
        measured["N m/N"] = {torque: 1.0}
    powers = {
        **{_MOMENTS[axis]: {"kg": 1.0, "m": 1.0} for axis in ("roll", "pitch")},
        _MOMENTS["yaw"]: {"kg": 1.0, "N m/N": 1.0},
        "flight.drag_kg_per_s.*": {"kg": 1.0},
    }
    return measured, powers


def _drag_quantities(drags: Mapping[str, DragFit | None], body: Body) -> dict[str, Parameter]:
    found = {axis: one for axis, one in drags.items() if one is not None}
    rates = {
        f"flight.drag_over_mass_per_s.{axis}": Parameter(value=one.rate, std=one.std) for axis, one in found.items()
    }
    mass = body.mass_kg
    forces = {
        f"flight.drag_kg_per_s.{axis}": Parameter(value=-mass * one.rate, std=mass * one.std)
        for axis, one in found.items()
    }
    return rates | forces


def _given(body: Body) -> dict[str, Parameter]:
    """Return the mass and the arm that the rest was scaled by: they belong to it."""
    given = {"flight.mass_kg": Parameter(value=body.mass_kg, std=body.mass_std_kg)}
    if body.arm_m is not None:
        given["flight.arm_m"] = Parameter(value=body.arm_m, std=body.arm_std_m)
    return given


def _wanted(quantities: Mapping[str, Parameter], findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the keys that the flights determine, all where they determine none."""
    lost = [key for one in findings if one.severity == "rejection" for key in one.quantities]
    return tuple(key for key in quantities if not any(fnmatchcase(key, one) for one in lost)) or tuple(quantities)


def _thrust_findings(found: FlightFit) -> list[Finding]:
    concerned = (_thrust_key(found), *_LAGS, *_MOMENTS.values())
    lift = found.excitation["vertical"]
    climb = "climb and drop quickly, once or twice a second, for 20 s"
    if lift < _LEAST_LIFT_MPS2 or found.explained < _EXPLAINED:
        text = (
            f"thrust is not excited: the rotors moved the vertical force by {lift:.2g} m/s^2 rms (at least "
            f"{_LEAST_LIFT_MPS2:g}) and explain {100 * max(found.explained, 0):.0f} % of it (at least "
            f"{100 * _EXPLAINED:.0f} %): {climb}. Moments need the thrust."
        )
        return [rejection("flight-thrust-not-excited", text, *concerned)]
    share, name, tau_s = max(
        (float(found.std[place]) / float(found.values[place]), name, float(found.values[place]))
        for place, name in enumerate(("rising", "falling"))
    )
    result = []
    if not share < _LOOSE_LAG:
        text = (
            f"the time constant of {name} thrust, {1e3 * tau_s:.0f} ms, is open by {100 * share:.0f} % (limit "
            f"{100 * _LOOSE_LAG:.0f} %): {climb}."
        )
        result.append(rejection("flight-lag-not-excited", text, *_LAGS, *_MOMENTS.values()))
    slope = np.array([0.0, 1.0, 2 * found.drive])
    gain, std = float(slope @ found.thrust), math.sqrt(float(slope @ found.covariance[THRUST, THRUST] @ slope))
    if not (gain > 0 and std < _LOOSE * gain):
        text = (
            f"the slope of thrust over the drive at hovering is {gain:.3g} +- {std:.2g} m/s^2 (limit "
            f"{100 * _LOOSE:.0f} %): {climb}. Moments need it."
        )
        result.append(rejection("flight-thrust-not-excited", text, _thrust_key(found), *_MOMENTS.values()))
    return result


def _moment_findings(found: FlightFit, body: Body) -> list[Finding]:
    result = []
    for place, axis in enumerate(AXES):
        if _lever_m(axis, body) is None:
            what = "the torque of a rotor over its thrust (`torque_m`)" if axis == "yaw" else "the arm (`arm_mm`)"
            result.append(note("flight-lever-unknown", f"no moment about {axis}: it needs {what}."))
            continue
        gain, std = float(found.values[TURNS][place]), float(found.std[TURNS][place])
        if gain < 0 and -gain > 3 * std:
            text = (
                f"commanded torques turn the vehicle the wrong way about {axis}: the log's axes are not forward, left "
                "and up, or its motors have other numbers (front right, rear right, rear left, front left)."
            )
            result.append(rejection("flight-wrong-way", text, _MOMENTS[axis]))
        elif not std < _LOOSE * abs(gain) or found.excitation[axis] < _LEAST_TURN_RAD_PER_S2:
            text = (
                f"the moment about {axis} is open by {100 * std / abs(gain):.0f} % (limit {100 * _LOOSE:.0f} %), and "
                f"rotors' torques moved the rate by {found.excitation[axis]:.2g} rad/s^2 rms (at least "
                f"{_LEAST_TURN_RAD_PER_S2:g}): {_MANOEUVRES[axis]}."
            )
            result.append(rejection("flight-moment-not-excited", text, _MOMENTS[axis]))
        elif found.feedback[place] > _FED_BACK:
            change = 100 * found.feedback[place]
            text = (
                f"torques of 20 ms before would change the moment about {axis} by {change:.0f} % more than noise "
                "explains: the autopilot answers to the gyro's noise, or the rotors are no first-order lag. "
                "The standard uncertainty contains it."
            )
            result.append(warning("flight-older-torques-differ", text, _MOMENTS[axis]))
    return result


def _drag_findings(drags: Mapping[str, DragFit | None]) -> list[Finding]:
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
        elif one is not None and not one.std < _LOOSE * abs(one.rate):
            text = f"drag along {axis} is open by {100 * one.std / abs(one.rate):.0f} %: fly faster, or longer."
            result.append(warning("flight-drag-loose", text, *keys))
    return result


def _lines(flights: Sequence[FlownLog], found: FlightFit, drags: Mapping[str, DragFit | None]) -> list[str | Dependent]:
    excited = [
        f"{name} {value:.2g} {'m/s^2' if name == 'vertical' else 'rad/s^2'}" for name, value in found.excitation.items()
    ]
    moved = [f"{axis} {one.speed:.2g} m/s" for axis, one in drags.items() if one is not None]
    low, high = found.drive_range
    unit = " V" if found.in_volts else ""
    return [
        *(one.log.understood for one in flights),
        *(
            f"{one.flight.name}: {one.in_air_s:.1f} s in the air, {one.driven_s:.1f} s of it with every motor within "
            "its range"
            for one in flights
        ),
        f"excited, root mean square: {', '.join([*excited, *moved])}",
        f"drives from {low:.3g} to {high:.3g}{unit}, {found.drive:.3g}{unit} in the mean; thrust holds between these",
    ]


def _assumptions(body: Body) -> list[str]:
    arm = "" if body.arm_m is None else f", {1e3 * LEVER * body.arm_m:.4g} mm from the axes forward and left"
    return [
        "assumed: axes forward, left, up; four alike rotors with thrust along z"
        + arm
        + f"; mass {1e3 * body.mass_kg:g} g; "
        "the accelerometer's scale exact; no climb in the mean; sensors show thrust a delay later",
    ]
