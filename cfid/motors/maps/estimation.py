"""Maps of one motor, from steady points: command to thrust and to speed, thrust to torque, speed to thrust."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from cfid.counted import counted
from cfid.errors import FitError
from cfid.estimate.polynomials import ORDERS, PolynomialFit, fit_best_order, fit_polynomial, fit_power, scattered_std
from cfid.findings import Finding, note, warning
from cfid.motors.maps.checks import (
    MISFIT_LIMIT,
    check_speed,
    check_thrust,
    exchange_findings,
    falling_findings,
    half_findings,
    listed,
    marker_findings,
    misfit_findings,
    missing_commands,
    scatter_findings,
)
from cfid.motors.points import Array, MotorPoints, PairedPoints, measured
from cfid.units import DEAD_COMMAND

Method = Literal["default", "thesis"]
Order = int | Literal["auto"]

GIVEN_BY = {  # the quantities that each map gives
    "thrust": ("motor.thrust_poly", "motor.command_of_thrust", "motor.max_thrust_n", "motor.hover_mass_kg"),
    "speed": ("motor.speed_poly",),
    "torque": ("motor.torque_poly",),
}
OVER_SPEED = ("motor.thrust_per_speed_squared_n_s2", "motor.thrust_speed_poly")

_MISCOUNTED = 0.5  # of k w^2: a speed that is twice or half as large puts it 0.75 or 3 apart
_DROPPED = 2000  # the command that C.2.3 leaves out


@dataclass(frozen=True, kw_only=True)
class MotorMap:
    """A polynomial `fit` to y over x (n,), which were measured at `command` (n,), for one motor in SI units.

    `windows` (n, N) are those of `PairedPoints`. `left_out` are commands whose points were not used. `aicc` is the
    corrected AIC of each order that was tried, empty where the order was given. A rejection among the `findings` states
    why the polynomial does not describe the points.
    """

    quantity: Literal["thrust", "speed", "torque"]
    method: Method
    fit: PolynomialFit
    command: Array
    x: Array
    y: Array
    windows: Array
    left_out: tuple[float, ...]
    aicc: Mapping[int, float]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True)
class SpeedThrustMap:
    """Thrust over speed, f = k w^2 as `square` (eq. 3.1) and with all three coefficients as `quadratic`.

    `windows` (n, N) are those of `PairedPoints`. `difference_n` is the largest between the two at the speeds measured.
    `square_suffices` states that the corrected AIC prefers k alone.
    """

    square: PolynomialFit
    quadratic: PolynomialFit
    speed_rad_s: Array
    thrust_n: Array
    windows: Array
    difference_n: float
    square_suffices: bool
    findings: tuple[Finding, ...]

    @property
    def k_n_s2(self) -> float:
        """Thrust per speed squared, N/(rad/s)^2."""
        return float(self.square.coefficients[0])

    @property
    def k_std_n_s2(self) -> float:
        """The standard uncertainty of k; nan without degrees of freedom."""
        return float(self.square.std[0])


def fit_thrust(
    points: MotorPoints,
    *,
    method: Method = "default",
    order: Order = 2,
    robust: bool = True,
    expected: Iterable[int] | None = None,
) -> MotorMap:
    """Fit thrust in N over command (eq. 3.3); `expected` are the commands that should be there.

    By default, the dead zone is left out, since the motor is at rest there; points are weighted by their uncertainties
    where these are known; and Huber's loss limits outliers. "thesis" is C.2.3: MATLAB's polyfit of all commands but
    2000, with zero at command 0. Order "auto" takes the order with the smallest corrected AIC.

    Raises FitError when the motors never ran, when Fz points down, or when there are too few points.
    """
    found = measured(points, "thrust_n")
    check_thrust(found.x, found.y)
    return _map("thrust", found, method, order, robust=robust, expected=expected)


def fit_speed(
    points: MotorPoints,
    *,
    method: Method = "default",
    order: Order = 1,
    robust: bool = True,
    expected: Iterable[int] | None = None,
) -> MotorMap:
    """Fit speed in rad/s over command (eq. 3.4) as `fit_thrust` does; a rejection names markers counted double.

    Raises FitError when the motors never ran, or when there are too few points.
    """
    found = measured(points, "speed_rad_s")
    check_speed(found.x, found.y)
    return _map(
        "speed",
        found,
        method,
        order,
        robust=robust,
        expected=expected,
        findings=marker_findings(found.x, found.y, _thrust_of_speeds(points), quantities=GIVEN_BY["speed"]),
    )


def fit_torque(
    points: MotorPoints,
    *,
    method: Method = "default",
    order: Order = 1,
    robust: bool = True,
    expected: Iterable[int] | None = None,
) -> MotorMap:
    """Fit torque in Nm over thrust in N (eq. 3.5) as `fit_thrust` does, but keep the points of a motor at rest.

    The torque's magnitude is fitted, since its sign is that of the direction in which the rotors turn.

    Raises FitError when the motors never ran, when Fz points down, or when there are too few points.
    """
    if points.torque_nm is not None and np.isnan(points.torque_nm).all():
        raise FitError(
            "no torque is left of motors that turn against each other: it cancels. Run one, or two that turn alike: "
            "1 and 3, or 2 and 4."
        )
    found = measured(points, "torque_nm", over="thrust_n")
    check_thrust(found.command, found.x)
    findings: tuple[Finding, ...] = ()
    if float(found.x @ found.y) < 0:
        found = found._replace(y=-found.y)
        text = "the torque is negative: these rotors turn counter-clockwise, seen from above. Its magnitude is fitted."
        findings = (note("torque-sign-turned", text, *GIVEN_BY["torque"]),)
    return _map("torque", found, method, order, robust=robust, expected=expected, findings=findings)


def fit_thrust_of_speed(points: MotorPoints, *, method: Method = "default", robust: bool = True) -> SpeedThrustMap:
    """Fit thrust over speed as k w^2 and as a full quadratic; "thesis" uses neither weights nor loss.

    Where no point has both, they are joined by command first, as the thesis has thrust and speed from different runs.
    (C.2.3 minimises f - k w although it states w^2; here k is that of w^2.)

    Raises FitError when the motors never ran or too few commands have both.
    """
    found = measured(points, "thrust_n", over="speed_rad_s")
    check_thrust(found.command, found.y)
    check_speed(found.command, found.x)
    speed, thrust, huber = found.x, found.y, robust and method == "default"
    std, shared = (None, None) if method == "thesis" else found.total_errors(order=2)
    wide = None if std is None else scattered_std(speed, thrust, std, order=2, robust=huber)
    square = fit_power(speed, thrust, power=2, std=wide, shared=shared, robust=huber)
    quadratic = _stated(fit_polynomial(speed, thrust, order=2, std=wide, shared=shared, robust=huber), std, wide)
    difference = float(np.max(np.abs(square.at(speed) - quadratic.at(speed))))
    suffices = square.aicc <= quadratic.aicc
    agree = bool(np.all(np.abs(thrust - square.at(speed)) <= _MISCOUNTED * np.abs(square.at(speed))))
    miscounted = marker_findings(found.command, speed, thrust, quantities=OVER_SPEED, single=not agree)
    text = (
        f"k w^2 differs from the full quadratic by up to {1e3 * difference:.2g} mN, which describes the points better."
    )
    return SpeedThrustMap(
        square=square,
        quadratic=quadratic,
        speed_rad_s=speed,
        thrust_n=thrust,
        windows=found.windows,
        difference_n=difference,
        square_suffices=suffices,
        findings=(
            *(() if suffices else (warning("thrust-not-square-of-speed", text, OVER_SPEED[0]),)),
            *misfit_findings(square, thrust, OVER_SPEED, command=found.command),
            *miscounted,
        ),
    )


def _thrust_of_speeds(points: MotorPoints) -> Array | None:
    """Return the thrusts of the points that have a speed, if all of these have a thrust."""
    if points.thrust_n is None or points.speed_rad_s is None:
        return None
    thrust = points.thrust_n[np.isfinite(points.speed_rad_s)]
    return thrust if np.all(np.isfinite(thrust)) else None


def _map(
    quantity: Literal["thrust", "speed", "torque"],
    measured: PairedPoints,
    method: Method,
    order: Order,
    *,
    robust: bool,
    expected: Iterable[int] | None,
    findings: Sequence[Finding] = (),
) -> MotorMap:
    own, keys = GIVEN_BY[quantity][0], GIVEN_BY[quantity]
    missing = missing_commands(measured.command, expected=expected)
    if method == "thesis":
        used, left = _thesis_points(measured, own)
    elif quantity == "torque":
        used, left = measured, ()
    else:
        used, left = _running(measured, own)
    std, shared = (None, None) if method == "thesis" else used.total_errors(order=2 if order == "auto" else order)
    huber = robust and method == "default"
    aicc: Mapping[int, float] = {}
    if order == "auto":
        choice = fit_best_order(used.x, used.y, orders=ORDERS, std=std, shared=shared, robust=huber)
        order, aicc = choice.fit.order, choice.aicc
    wide = None if std is None else scattered_std(used.x, used.y, std, order=order, robust=huber)
    if wide is not None and len(used.x) == order + 1:  # nothing shows how far the points are off
        std = wide = np.hypot(wide, MISFIT_LIMIT * float(np.max(np.abs(used.y))))
    fit = _stated(fit_polynomial(used.x, used.y, order=order, std=wide, shared=shared, robust=huber), std, wide)
    swaps: tuple[Finding, ...] = ()
    if quantity != "torque" and method == "default":
        resting = (*keys, "motor.thrust_voltage_poly") if quantity == "thrust" else keys
        swaps = exchange_findings(used.command, used.y, order=fit.order, quantities=resting)
    gaps = (warning("commands-missing", f"command {listed(missing)} is missing.", own),) if missing else ()
    return MotorMap(
        quantity=quantity,
        method=method,
        fit=fit,
        command=used.command,
        x=used.x,
        y=used.y,
        windows=used.windows,
        left_out=tuple(np.setdiff1d(measured.command, used.command).tolist()),
        aicc=aicc,
        findings=(
            *findings,
            *swaps,
            *gaps,
            *left,
            *scatter_findings(fit, used.command, own),
            *(() if std is None else half_findings(used.x, used.y, std, order=order, quantities=keys)),
            *misfit_findings(fit, used.y, keys, command=used.command),
            *falling_findings(fit, used.x, keys),
        ),
    )


def _stated(fit: PolynomialFit, std: Array | None, wide: Array | None) -> PolynomialFit:
    """Return a fit whose inflation is relative to the stated uncertainties, not to those it was weighted with."""
    if std is None or wide is None or fit.inflation is None:
        return fit
    return replace(fit, inflation=fit.inflation * float(np.sqrt(np.mean((wide / std) ** 2))))


def _running(measured: PairedPoints, key: str) -> tuple[PairedPoints, tuple[Finding, ...]]:
    running = measured.command > DEAD_COMMAND
    standing = int(np.count_nonzero(measured.command <= DEAD_COMMAND))
    if not standing:
        return measured.kept(running), ()
    text = (
        f"up to command {DEAD_COMMAND} the motor stands (dead zone): {counted(standing, 'point')} there "
        f"{'is' if standing == 1 else 'are'} left out, and the map ends there."
    )
    return measured.kept(running), (note("dead-zone-left-out", text, key),)


def _thesis_points(measured: PairedPoints, key: str) -> tuple[PairedPoints, tuple[Finding, ...]]:
    """Leave out command 2000 and add a zero at command 0, as C.2.3 does."""
    kept = measured.kept((measured.command != _DROPPED) & (measured.command != 0))
    command, x, y = (np.concatenate([[0.0], column]) for column in (kept.command, kept.x, kept.y))
    used = PairedPoints(command, x, y, np.vstack([np.zeros(kept.windows.shape[1]), kept.windows]))
    # x is the command itself, or the thrust of a motor at rest: zero in both cases.
    text = f"as in the thesis, command {_DROPPED} is left out and command 0 is a point at zero."
    return used, (note("thesis-points", text, key),)
