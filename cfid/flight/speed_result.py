"""Collect what flights with rotor speeds show of a vehicle: quantities, the causes they share, and findings."""

from collections.abc import Mapping, Sequence

import numpy as np
from uncertainties import UFloat, ufloat

from cfid.estimate.common_causes import Cause, power_law, with_common_causes
from cfid.findings import Finding, rejection, warning
from cfid.flight.braking import AxisDrag
from cfid.flight.data import FlownLog
from cfid.flight.estimation import EXPLAINED
from cfid.flight.findings import LOOSE, MANOEUVRES, determined, drag_findings, square_findings, weight_findings
from cfid.flight.rows import AXES
from cfid.flight.speeds import LATEST_S, MEAN_S, SpeedFit, fit_speeds
from cfid.flight.values import MOMENTS, RESTS_ON, Body, drag_quantities, given
from cfid.recordings.read import description
from cfid.records.parameters import Parameter
from cfid.records.result import Dependent, Figures, Result

_THRUST, _POLYNOMIAL = "motor.thrust_per_speed_squared_n_s2", "motor.thrust_speed_poly"
_TORQUE, _SPIN, _DELAY = "motor.torque_poly", "rotor_inertia_kg_m2", "flight.speed_delay_s"
_AIR = {axis: f"flight.moment_per_velocity_ns.{axis}" for axis in AXES[:2]}
_WHILE_TURNING = "tilt quickly left and right, forward and back, while the vehicle turns at about 200 deg/s, for 20 s"
# Of the moment about yaw by gyroscopic effects: the largest uncertainty that counts. Simulated flights that turn have 1
# %; those that tilt and turn one after the other state 6 %, and miss by 11 %.
_CLEAR = 0.03
_LATE = 0.9  # of the latest delay that is tried: beyond, the best one may be later still
# A step of telemetry is 0.2 to 0.4 % of a speed, which lies somewhere in it, and rotors share what comes of that.
_THRUST_STD = 0.002
# Noise of an estimated velocity makes the moment of air small: by 2 to 3 % in simulated flights.
_VELOCITY_STD = 0.025
# Of the moment about yaw by gyroscopic effects: in gusts, or with slow telemetry, simulated flights make it 1 to 5 %
# small.
_TURN_STD = 0.025
# Of the rotors' inertia over that moment: with speeds every 4 ms, simulated flights make it 2 to 2.5 % small.
_SPIN_STD = 0.03
_DELAY_STD_S = 5e-4  # of telemetry and sensors, which take turns: what their delay scatters by
# The powers with which quantities depend on the units of the causes.
_OF_ARM = {"kg": 1.0, "m": 1.0, "slope": 1.0}
_OF_TURNS = {**_OF_ARM, "turn": 1.0}
_OF_TORQUE = {"kg": 1.0, "N m/N": 1.0, "slope": 1.0}
_POWERS = {
    _THRUST: {"kg": 1.0, "level": 1.0, "rad/s": 1.0},
    MOMENTS["roll"]: _OF_ARM,
    MOMENTS["pitch"]: _OF_ARM,
    "flight.moment_per_velocity_ns.*": {**_OF_ARM, "m/s": 1.0},
    "flight.drag_kg_per_s.*": {"kg": 1.0, "m/s^2": 1.0},
    "flight.drag_over_mass_per_s.*": {"m/s^2": 1.0},
}


def of_speeds(flights: Sequence[FlownLog], drags: Mapping[str, AxisDrag | None], body: Body) -> Result:
    """Fit flights whose logs have rotor speeds: thrust, moments, rotor inertia, torque, and the moments of air.

    Raises FitError for less than 5 s in the air, and CrossedError where moments turn the vehicle about other axes.
    """
    fit = fit_speeds([flown.flight for flown in flights], scale_std=body.rescaled_std)
    measured = _quantities(fit, body) | drag_quantities(drags, body)
    findings = (
        *(
            finding
            for flown in flights
            for finding in (*flown.findings, *square_findings(flown), *weight_findings(flown))
        ),
        *_findings(fit, body),
        *drag_findings(drags),
    )
    quantities = measured | given(body)
    name = flights[0].flight.name

    def drawings() -> Figures:
        from cfid.flight.figures import flight_figure

        title = ", ".join(flown.flight.name for flown in flights)
        blocks = [*fit.vertical.blocks, *(block for axis in fit.axes for block in axis.blocks)]
        return {f"fit_flight_{name}": flight_figure(blocks, drags, findings, title=title, row_s=MEAN_S)}

    result = Result(
        command="fit flight",
        method="default",
        quantities=quantities,
        findings=findings,
        wanted=determined(measured, findings),
        merits={
            "seconds": fit.seconds,
            "explained_vertical": fit.vertical.explained,
            "explained": {axis: each.explained for axis, each in zip(AXES, fit.axes, strict=True)},
        },
        sources=tuple(flown.log.source for flown in flights),
        rests_on=RESTS_ON,
        lines=tuple(_lines(flights, fit)),
        drawings=drawings,
    )
    by = _OF_TURNS if body.torque_m is None else _OF_TORQUE
    of_yaw = {MOMENTS["yaw"]: by, _SPIN: {**by, "spin": 1.0}}
    scales = power_law(quantities, _causes(fit, body, flights), _POWERS | of_yaw)
    bent = 2 * body.mass_kg * fit.thrust.n * np.array([1.0, -fit.hover_rad_s, 0.0])
    slope = {_slope(fit): {_POLYNOMIAL: fit.half_slope.s * bent}}
    return with_common_causes(result, scales, slope)


def _slope(fit: SpeedFit) -> Cause:
    return Cause("thrust's slope over speed", fit.half_slope.s)


def _causes(fit: SpeedFit, body: Body, flights: Sequence[FlownLog]) -> dict[str, dict[Cause, float]]:
    """Return the causes by the unit that they scale.

    The level of thrust is gravity's where a firmware took the accelerometer's scale at rest; else its zero counts.
    """
    mass = Cause("mass", body.mass_std_kg / body.mass_kg or None)
    turn = Cause("gyroscopic effects of turns", _TURN_STD)
    causes = {"kg": {mass: 1.0}, "N": {mass: 1.0}, "turn": {turn: 1.0}, "slope": {_slope(fit): 1.0}}
    causes["spin"] = {Cause("speeds that come late", _SPIN_STD): 1.0}
    if body.arm_m is not None:
        arm = Cause("arm", None if body.arm_std_m is None else body.arm_std_m / body.arm_m)
        causes["m"], causes["N m"] = {arm: 1.0}, {mass: 1.0, arm: 1.0, turn: 1.0}
    if body.torque_m is not None:
        share = None if body.torque_std_m is None else body.torque_std_m / body.torque_m
        causes["N m/N"] = {Cause("torque over thrust", share): 1.0}
    causes["rad/s"] = {Cause("steps of the speeds", _THRUST_STD): 1.0}
    causes["m/s"] = {Cause("noise of the velocity", _VELOCITY_STD): 1.0}
    scale = Cause("the accelerometer's scale", body.rescaled_std)
    causes["m/s^2"] = {scale: 1.0}
    if not all(flown.flight.rescaled for flown in flights):
        causes["level"] = {scale: 1.0}
    return causes


def _quantities(fit: SpeedFit, body: Body) -> dict[str, Parameter]:
    """Return what the flights show, for a mass, an arm and a slope of thrust over speed that are taken as exact."""
    thrust, slope = body.mass_kg * fit.thrust, 2 * fit.half_slope.n
    shape = np.array([1 + slope, -slope * fit.hover_rad_s, 0.0])
    quantities = {_THRUST: thrust}
    polynomials = {_POLYNOMIAL: (thrust, shape)}
    if body.arm_m is not None:
        size = body.mass_kg * body.arm_m
        quantities |= {MOMENTS[axis]: size * inertia for axis, inertia in zip(AXES, fit.inertia_m, strict=False)}
        quantities |= {key: size * air for key, air in zip(_AIR.values(), fit.air_m, strict=False)}
    if (yaw := _yaw(fit, body)) is not None:
        quantities |= {MOMENTS["yaw"]: yaw, _SPIN: fit.spin_per_inertia * yaw}
        if body.torque_m is None:
            polynomials[_TORQUE] = (fit.torque_per_inertia * yaw / body.mass_kg, np.array([1.0, 0.0]))
    quantities[_DELAY] = fit.delay_s + ufloat(0.0, _DELAY_STD_S)
    return {key: Parameter(value=value.n, std=value.s) for key, value in quantities.items()} | {
        key: Parameter(value=(value.n * each).tolist(), std=np.abs(value.s * each).tolist())
        for key, (value, each) in polynomials.items()
    }


def _yaw(fit: SpeedFit, body: Body) -> UFloat | None:
    """Return the moment about yaw: by the known torque over thrust, else by gyroscopic effects, None without an arm."""
    if body.torque_m is not None:
        return body.torque_m * body.mass_kg / fit.torque_per_inertia
    return None if body.arm_m is None else body.mass_kg * body.arm_m * fit.yaw_inertia_m


def _findings(fit: SpeedFit, body: Body) -> list[Finding]:
    """Judge each quantity alone: reject it where the flights do not show it, with what would."""
    findings = []
    if body.arm_m is None:
        findings.append(
            warning("flight-lever-unknown", "no moment about roll and pitch: they need the arm (`arm_mm`).")
        )
    of_yaw = ("rotor_inertia_kg_m2", "motor.torque_poly", MOMENTS["yaw"])
    if not fit.thrust.s < LOOSE * fit.thrust.n:
        text = (
            f"thrust over speed squared is known to {100 * fit.thrust.s / fit.thrust.n:.0f} % (limit "
            f"{100 * LOOSE:.0f} %): the logs contradict each other, and are of other vehicles, masses or units."
        )
        findings.append(
            rejection("flight-logs-contradict", text, "motor.thrust*", *MOMENTS.values(), *of_yaw, *_AIR.values())
        )
    if abs(fit.delay_s.n) > _LATE * LATEST_S:
        text = (
            f"speeds are shown {1e3 * fit.delay_s.n:.0f} ms after the rates that they cause (limit "
            f"{1e3 * LATEST_S:.0f} ms, later or earlier): their times do not belong together."
        )
        keys = (MOMENTS["roll"], MOMENTS["pitch"], *of_yaw, *_AIR.values(), _DELAY)
        findings.append(rejection("flight-delay-implausible", text, *keys))
    without_air = "" if fit.with_velocity else ", and log velocity and attitude, whose moment of air is unknown without"
    for axis, each in zip(AXES, fit.axes, strict=True):
        lost = of_yaw if axis == "yaw" else (MOMENTS[axis], _AIR[axis], *of_yaw)
        gain = each.coefficients[0]
        if gain.n < -3 * gain.s:
            text = (
                f"rotors' speeds turn the vehicle the wrong way about {axis}: axes are not forward, left, up, motors "
                "are not front right, rear right, rear left, front left, or rotors turn the other way (`props_out`)."
            )
            findings.append(rejection("flight-wrong-way", text, *lost))
        elif not (each.explained >= EXPLAINED and gain.s < LOOSE * gain.n):
            text = (
                f"rotors explain {100 * max(each.explained, 0):.0f} % of how the rate about {axis} changes (at least "
                f"{100 * EXPLAINED:.0f} %), and their effect is known to {100 * gain.s / abs(gain.n):.0f} % "
                f"(limit {100 * LOOSE:.0f} %): {MANOEUVRES[axis]}{without_air}."
            )
            findings.append(rejection("flight-moment-not-excited", text, *lost))
    if body.torque_m is None and body.arm_m is not None:
        yaw = fit.yaw_inertia_m
        if not 0 < yaw.s < _CLEAR * yaw.n:
            text = (
                f"the moment about yaw is known to {100 * yaw.s / abs(yaw.n):.0f} % (limit {100 * _CLEAR:.0f} %), "
                f"and with it the rotors' inertia and torque: {_WHILE_TURNING}, or measure the torque over thrust."
            )
            findings.append(rejection("flight-moment-not-excited", text, *of_yaw))
    spin = fit.spin_per_inertia
    if not spin.s < LOOSE * spin.n:
        text = f"the rotors' inertia is known to {100 * spin.s / abs(spin.n):.0f} %: {MANOEUVRES['yaw']}."
        findings.append(rejection("flight-moment-not-excited", text, _SPIN))
    for axis, air in zip(AXES, fit.air_m, strict=False):
        if not air.s < LOOSE * abs(air.n):
            text = (
                f"the moment of air about {axis}, over mass, arm and velocity, is {air.n:.2g} +- {air.s:.2g} 1/s "
                f"(limit {100 * LOOSE:.0f} %): fly back and forth at 1 m/s."
            )
            findings.append(rejection("flight-air-not-excited", text, _AIR[axis]))
    return findings


def _lines(flights: Sequence[FlownLog], fit: SpeedFit) -> list[str | Dependent]:
    spin, torque = fit.spin_per_inertia, fit.torque_per_inertia
    return [
        *(description(flown.log) for flown in flights),
        f"{fit.seconds:.1f} s in the air with rotor speeds, {fit.hover_rad_s:.0f} rad/s as it hovers",
        f"a rotor's inertia over the moment about yaw: {spin.n:.4g} +- {spin.s:.2g}; its torque over thrust, "
        f"over that moment, times the mass: {torque.n:.4g} +- {torque.s:.2g} 1/m",
        f"thrust's slope over speed, half of its relative change: {fit.half_slope.n:.3f} +- "
        f"{fit.half_slope.s:.3f}, from the accelerometer and from what published propellers have",
    ]
