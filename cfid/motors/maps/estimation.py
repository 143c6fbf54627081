"""Maps of one motor from its points: fits, what a controller needs of them, and thrust over motor voltage."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import brentq

from cfid.errors import FitError
from cfid.estimate.linear import fit_linear
from cfid.estimate.monotone_cubic import constrain
from cfid.estimate.polynomials import PolynomialFit, fit_polynomial, fit_power, scattered_std
from cfid.findings import Finding, note, rejection, warning
from cfid.motors.points import Pairs, Points, column, measured, shared, weighable
from cfid.motors.weighing import STANDING_N
from cfid.units import DEAD_COMMAND, FULL_COMMAND, NEAR_FULL, ROTORS

Array = npt.NDArray[np.float64]
Method = Literal["default", "thesis"]
Quantity = Literal["thrust", "speed", "torque"]

GIVEN_BY = {  # the quantities that each map gives
    "thrust": ("motor.thrust_poly", "motor.command_of_thrust", "motor.max_thrust_n", "motor.hover_mass_kg"),
    "speed": ("motor.speed_poly",),
    "torque": ("motor.torque_poly",),
}
OVER_SPEED = ("motor.thrust_per_speed_squared_n_s2", "motor.thrust_speed_poly")
OVER_VOLTAGE = "motor.thrust_voltage_poly"
THRUST_ORDER = 3  # over motor voltage, as in the firmware's compensation of the battery
OUTLIER_WEIGHT = 0.34  # of Huber's loss: four standard uncertainties off

_AXES = {"thrust": ("thrust_n", "command"), "speed": ("speed_rad_s", "command"), "torque": ("torque_nm", "thrust_n")}
_USUAL_ORDER = {"thrust": 2, "speed": 1, "torque": 1}  # those of the thesis
_DROPPED = 2000  # the command that C.2.3 leaves out
_STANDING_RAD_S = 10.0
_APART, _ALIKE = 0.2, 0.02  # of the largest: commands that are far apart, and speeds that count as one
_MISFIT = 0.05  # rms of the residuals relative to the largest value; the thesis' worse line (eq. 3.4) has 0.037
_NOTABLE_SCATTER = 2.0  # times the stated standard uncertainties: from there on it is reported
_OPEN = 0.25  # of an extrapolated thrust at full command: the largest accepted standard uncertainty
_MAXIMUM = ("motor.max_thrust_n", "motor.hover_mass_kg")
_FURTHER = 2.0
_BELOW, _BEYOND = 0.5, 1.2  # times the lowest and the highest voltage that a battery had: in between under any load
_NEAR = 0.1  # of full command: where nothing lower was measured, the inverse is extrapolated downwards
_TELLING = 1.05  # ratio of prediction errors from which on one form is the better one
_SAGS, _FALLS = 0.01, -0.8  # a voltage sags by more than this share, and with a correlation with the command below this


@dataclass(frozen=True, kw_only=True)
class MotorMap:
    """A polynomial `fit` to y over x (n,), which were measured at `command` (n,), for one motor in SI units.

    `windows` (n, N) are those of `Pairs`. `left_out` are commands whose points were not used. A rejection among the
    `findings` states why the polynomial does not describe the points.
    """

    quantity: Quantity
    method: Method
    fit: PolynomialFit
    command: Array
    x: Array
    y: Array
    windows: Array
    left_out: tuple[float, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True)
class SpeedThrustMap:
    """Thrust over speed, f = k w^2 as `square` (eq. 3.1) and with all three coefficients as `quadratic`.

    `windows` (n, N) are those of `Pairs`. `difference_n` is the largest between the two at the speeds measured.
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


def fit_map(
    quantity: Quantity,
    points: Points,
    *,
    method: Method = "default",
    order: int | None = None,
    robust: bool = True,
    expected: Iterable[int] = (),
) -> MotorMap:
    """Fit thrust in N (eq. 3.3) or speed in rad/s (eq. 3.4) over command, or torque in N m over thrust in N (eq. 3.5).

    By default, the dead zone is left out of maps over the command, since the motor is at rest there; points are
    weighted by their uncertainties where these are known; and Huber's loss limits outliers. "thesis" is C.2.3: MATLAB's
    polyfit of all commands but 2000, with zero at command 0. `order` is by default that of the thesis. `expected` are
    the commands that should be there. A torque's magnitude is fitted, since its sign is that of the direction in which
    the rotors turn.

    Raises FitError when the motors never ran, when Fz points down, or when there are too few points.
    """
    name, over = _AXES[quantity]
    if quantity == "torque" and name in points and points[name].isna().all():
        raise FitError(
            "no torque is left of motors that turn against each other: it cancels. Run one, or two that turn alike: "
            "1 and 3, or 2 and 4."
        )
    pairs = measured(points, name, over=over)
    _check(pairs)
    if quantity == "torque" and float(pairs.x @ pairs.y) < 0:
        pairs = pairs._replace(points=pairs.points.assign(torque_nm=-pairs.y))
    keys, order = GIVEN_BY[quantity], order or _USUAL_ORDER[quantity]
    missing = sorted(set(expected) - set(pairs.command.tolist()))
    gaps = (warning("commands-missing", f"command {listed(missing)} is missing.", keys[0]),) if missing else ()
    used = pairs if quantity == "torque" else pairs.kept(pairs.command > DEAD_COMMAND)
    if method == "thesis":
        used = _thesis_points(pairs)
    std, common = (None, None) if method == "thesis" else used.errors(order=order)
    huber = robust and method == "default"
    wide = None if std is None else scattered_std(used.x, used.y, std, order=order, robust=huber)
    if wide is not None and len(used.x) == order + 1:  # nothing shows how far the points are off
        std = wide = np.hypot(wide, _MISFIT * float(np.max(np.abs(used.y))))
    fit = _stated(fit_polynomial(used.x, used.y, order=order, std=wide, shared=common, robust=huber), std, wide)
    return MotorMap(
        quantity=quantity,
        method=method,
        fit=fit,
        command=used.command,
        x=used.x,
        y=used.y,
        windows=used.windows,
        left_out=tuple(np.setdiff1d(pairs.command, used.command).tolist()),
        findings=(*gaps, *_scatter(fit, keys[0]), *_misfit(fit, used, keys), *_falling(fit, keys)),
    )


def fit_thrust_of_speed(points: Points, *, method: Method = "default", robust: bool = True) -> SpeedThrustMap:
    """Fit thrust over speed as k w^2 and as a full quadratic; "thesis" uses neither weights nor loss.

    Where no point has both, they are joined by command first, as the thesis has thrust and speed from different runs.
    (C.2.3 minimises f - k w although it states w^2; here k is that of w^2.)

    Raises FitError when the motors never ran or too few commands have both.
    """
    pairs = measured(points, "thrust_n", over="speed_rad_s")
    _check(pairs)
    speed, thrust, huber = pairs.x, pairs.y, robust and method == "default"
    std, common = (None, None) if method == "thesis" else pairs.errors(order=2)
    wide = None if std is None else scattered_std(speed, thrust, std, order=2, robust=huber)
    square = fit_power(speed, thrust, power=2, std=wide, shared=common, robust=huber)
    quadratic = _stated(fit_polynomial(speed, thrust, order=2, std=wide, shared=common, robust=huber), std, wide)
    difference = float(np.max(np.abs(square.at(speed) - quadratic.at(speed))))
    suffices = square.aicc <= quadratic.aicc
    text = (
        f"k w^2 differs from the full quadratic by up to {1e3 * difference:.2g} mN, which describes the points better."
    )
    return SpeedThrustMap(
        square=square,
        quadratic=quadratic,
        speed_rad_s=speed,
        thrust_n=thrust,
        windows=pairs.windows,
        difference_n=difference,
        square_suffices=suffices,
        findings=(
            *(() if suffices else (warning("thrust-not-square-of-speed", text, OVER_SPEED[0]),)),
            *_misfit(square, pairs, OVER_SPEED),
        ),
    )


def _check(pairs: Pairs) -> None:
    """Check thrusts and speeds of commands above the dead zone.

    Raises FitError when there are none, when no motor ran, when thrust points down throughout, or when the speed is the
    same at commands far apart.
    """
    running = ~(pairs.command <= DEAD_COMMAND)  # nan: thrust and speed are known, the command is not
    if not running.any():
        raise FitError(
            f"no command above {DEAD_COMMAND} was measured: up to there a motor stands, nothing can be fitted."
        )
    command = pairs.command[running]
    values = {pairs.x_name: pairs.x[running], pairs.y_name: pairs.y[running]}
    if (thrust := values.get("thrust_n")) is not None:
        least, most = float(thrust.min()), float(thrust.max())
        if least < -STANDING_N and most < STANDING_N:
            raise FitError(
                f"the thrust is negative throughout, down to {least:.3g} N: Fz counts downwards here. Was the "
                "vehicle mounted upside down, or the load cell? Turn the sign of Fz, or leave it where it was turned."
            )
        if most < STANDING_N:
            raise FitError(
                f"the motors never ran: above command {DEAD_COMMAND} the largest thrust is {most:.2g} N, and a "
                f"motor that turns gives {STANDING_N:g} N. Check battery, arming and propellers."
            )
    if (speed := values.get("speed_rad_s")) is not None:
        if speed.max() < _STANDING_RAD_S:
            raise FitError(
                f"the motors never ran: above command {DEAD_COMMAND} the largest speed is {speed.max():.2g} rad/s. "
                "Does the tachometer see its marker, and were the motors armed?"
            )
        if np.ptp(command) > _APART * command.max() and np.ptp(speed) < _ALIKE * speed.max():
            raise FitError(
                f"the speed is {speed.mean():.4g} rad/s at every command from {command.min():.0f} to "
                f"{command.max():.0f}: the instrument's display stands still, or it counts something else than the "
                "rotor."
            )


def _thesis_points(pairs: Pairs) -> Pairs:
    """Leave out command 2000 and add a zero at command 0, as C.2.3 does."""
    kept = pairs.kept((pairs.command != _DROPPED) & (pairs.command != 0))
    zero = pd.DataFrame({name: [0.0] for name in {"command", pairs.x_name, pairs.y_name}})
    windows = np.vstack([np.zeros(kept.windows.shape[1]), kept.windows])
    return kept._replace(points=pd.concat([zero, kept.points], ignore_index=True), windows=windows)


def _stated(fit: PolynomialFit, std: Array | None, wide: Array | None) -> PolynomialFit:
    """Return a fit whose inflation is relative to the stated uncertainties, not to those it was weighted with."""
    if std is None or wide is None or fit.inflation is None:
        return fit
    return replace(fit, inflation=fit.inflation * float(np.sqrt(np.mean((wide / std) ** 2))))


def listed(commands: Sequence[float]) -> str:
    """Return commands as text for a sentence, only the first few of many."""
    few = ", ".join(f"{value:.0f}" for value in commands[:6])
    return few if len(commands) <= 6 else f"{few} and {len(commands) - 6} more"


def _scatter(fit: PolynomialFit, key: str) -> Iterable[Finding]:
    """Report how well the points agree with each other."""
    if fit.degrees_of_freedom == 0:
        text = f"{len(fit.x)} points determine all coefficients and leave nothing to judge them by."
        taken = f" Each is taken as off by {100 * _MISFIT:.0f} % of the largest, as far as a map may miss its points."
        yield warning("map-without-freedom", text + taken * bool(np.isfinite(fit.std).all()), key)
    if fit.inflation is not None and fit.inflation > _NOTABLE_SCATTER:
        yield warning(
            "map-points-scatter",
            f"the points scatter {fit.inflation:.1f} times as far about the curve as within their windows (drift, a "
            "sagging battery, or another shape): standard uncertainties are widened by that.",
            key,
        )


def _misfit(fit: PolynomialFit, pairs: Pairs, quantities: Sequence[str]) -> Iterable[Finding]:
    """Reject a polynomial that misses its points."""
    misfit = fit.residual_norm / np.sqrt(len(pairs.y)) / float(np.max(np.abs(pairs.y)))
    if misfit > _MISFIT:
        furthest = pairs.command[np.argmax(np.abs(fit.residual))]
        at = f", most at command {furthest:.0f}" if np.isfinite(furthest) else ""
        yield rejection(
            "map-misfit",
            f"the polynomial misses the points by {100 * misfit:.2g} % of the largest (rms, limit "
            f"{100 * _MISFIT:.0f} %){at}: the points are not steady, or another order describes them.",
            *quantities,
        )


def _falling(fit: PolynomialFit, quantities: Sequence[str]) -> Iterable[Finding]:
    """Reject a polynomial that does not rise throughout the range of its points."""
    if np.any(fit.slope_at(np.linspace(fit.x.min(), fit.x.max(), 200)) <= 0):
        text = "the polynomial does not rise throughout: one value belongs to two commands."
        yield rejection("map-not-monotone", text, *quantities)


# Thrust over motor voltage


@dataclass(frozen=True, kw_only=True)
class VoltageComparison:
    """Polynomials of equal order over motor voltage and over command, judged on commands left out of the fit.

    `command`, `motor_volts` and `value` (n,) are those of all points that `used` (N,) marks. `voltage_rms` and
    `command_rms` are the errors of prediction, in the value's unit, for the points at `judged` commands, with each form
    fitted by plain least squares.

    Thrust over voltage is the cubic that rises over all voltages, as the firmware needs it, and departs from the plain
    one by `departure` of the largest thrust; where the points contradict every such cubic, a rejection states why, and
    `by_voltage` is the plain one.
    """

    by_voltage: PolynomialFit
    by_command: PolynomialFit
    command: Array
    motor_volts: Array
    value: Array
    used: npt.NDArray[np.bool_]
    voltage_rms: float
    command_rms: float
    judged: int
    findings: tuple[Finding, ...]
    departure: float = 0.0

    @property
    def lowest_first(self) -> Array:
        """Coefficients over motor voltage, lowest power first, as in the firmware."""
        return self.by_voltage.coefficients[::-1]

    @property
    def ratio(self) -> float:
        """Ratio of the command's prediction error to the voltage's."""
        return self.command_rms / self.voltage_rms if self.voltage_rms > 0 else np.inf

    @property
    def better(self) -> Literal["voltage", "command", "neither"]:
        """The better form; "neither" where their errors differ by less than 5 %."""
        if self.ratio > _TELLING:
            return "voltage"
        return "command" if self.ratio < 1 / _TELLING else "neither"

    @property
    def lines(self) -> tuple[str, ...]:
        """Sentences on which form predicts better, and by how much, and on the cubic for the firmware."""
        how = f"cross-validated over {self.judged} commands"
        if self.better == "neither":
            text = f"motor voltage and command predict equally well, {how}: this battery cannot distinguish them."
        else:
            other = "command" if self.better == "voltage" else "voltage"
            times = f"{max(self.ratio, 1 / self.ratio):.2g} times"
            text = f"motor {self.better} predicts {times} better than {other}, {how}."
        rising = (
            "thrust of motor voltage is the cubic nearest to the points that rises over all voltages, as the firmware's"
            f" inverse needs it: it departs by up to {100 * self.departure:.1f} % of the largest thrust."
        )
        return (text, rising) if self.departure else (text,)

    @property
    def rejected(self) -> bool:
        """Whether the firmware cannot use this cubic."""
        return any(finding.severity == "rejection" for finding in self.findings)


def motor_volts(*, command: npt.ArrayLike, vbat_v: npt.ArrayLike) -> Array:
    """Return the mean voltage at a motor: the command chops the battery's voltage."""
    return np.asarray(np.asarray(command, dtype=np.float64) / FULL_COMMAND * np.asarray(vbat_v, dtype=np.float64))


def compare_thrust(points: Points, *, max_thrust_n: float | None = None) -> VoltageComparison:
    """Fit thrust as a cubic of motor voltage, and of the command alone; see `compare`.

    The cubic of motor voltage is one that rises over all voltages, and that the firmware can invert up to
    `max_thrust_n`: see `constrain`.

    Raises FitError when there are too few commands, or when thrust does not rise with the voltage.
    """
    compared = compare(points, order=THRUST_ORDER)
    std, common = _weights(points[compared.used])
    rising = constrain(
        compared.by_voltage, thrust_n=compared.value, std_n=std, shared_n=common, max_thrust_n=max_thrust_n
    )
    if rising.refusal:
        refused = rejection("voltage-cubic-refused", rising.refusal, OVER_VOLTAGE)
        return replace(compared, findings=(*compared.findings, refused))
    return replace(compared, by_voltage=rising.fit, departure=rising.departure)


def compare(points: Points, *, order: int) -> VoltageComparison:
    """Fit thrust to points above the dead zone in both forms, and let each predict the commands left out of its fit.

    A command is left out with all its points, else a point would be predicted from another one at the same voltage. The
    lowest and the highest stay in, as a cubic must not be extrapolated. Errors of prediction are not weighted.

    Raises FitError when there are too few commands.
    """
    used = ((points["command"] > DEAD_COMMAND) & points["vbat_v"].notna() & points["thrust_n"].notna()).to_numpy()
    kept = points[used]
    std, common = _weights(kept)
    command, vbat_v, value = (kept[name].to_numpy(dtype=np.float64) for name in ("command", "vbat_v", "thrust_n"))
    volts = motor_volts(command=command, vbat_v=vbat_v)
    inner = np.unique(command)[1:-1]
    if len(inner) <= order:
        raise FitError(
            f"{len(np.unique(command))} commands above {DEAD_COMMAND} are too few to judge forms of order {order} on "
            f"commands left out of the fit: {order + 3} are needed. Steps that never settled do not "
            "count: hold each longer."
        )

    def predicted_rms(x: Array) -> float:
        errors = []
        for held in inner:
            other = command != held
            fit = fit_polynomial(x[other], value[other], order=order, std=None if std is None else std[other])
            errors.append(value[~other] - fit.at(x[~other]))
        return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))

    return VoltageComparison(
        by_voltage=fit_polynomial(volts, value, order=order, std=std, shared=common),
        by_command=fit_polynomial(command, value, order=order, std=std, shared=common),
        command=command,
        motor_volts=volts,
        value=value,
        used=used,
        voltage_rms=predicted_rms(volts),
        command_rms=predicted_rms(command),
        judged=len(inner),
        findings=_follows_command(command, vbat_v),
    )


def _weights(points: Points) -> tuple[Array | None, Array]:
    """Return standard uncertainties of thrust as weights, None where unknown, and their shared parts."""
    return weighable(column(points, "thrust_std_n")), shared(points, "thrust_n")


def _follows_command(command: Array, vbat_v: Array) -> tuple[Finding, ...]:
    """Warn when the voltage (n,) fell as the command (n,) rose and no command was held at two voltages."""
    low, high = float(vbat_v.min()), float(vbat_v.max())
    if len(np.unique(command)) < len(command) or high - low <= _SAGS * high:
        return ()
    if float(np.corrcoef(command, vbat_v)[0, 1]) >= _FALLS:
        return ()
    text = (
        f"every command was held once: voltage fell as the command rose, from {high:.3g} to {low:.3g} V, so this run "
        "cannot separate the two. Record the way down too, or repeat on another charge."
    )
    return (warning("voltage-follows-command", text, OVER_VOLTAGE),)


# For a controller


@dataclass(frozen=True, kw_only=True)
class InverseMap:
    """The inverse of one motor's thrust map: the command is the rising root of `coefficients` (3,), eq. 3.3 solved.

    It is valid within `command_range` and `thrust_range_n`, both ends included. `round_trip_command` is how far a
    command may change on its way to thrust and back in the single precision of the firmware, and `round_trip_n` how far
    the thrust of the rounded command is from the wanted thrust.
    """

    coefficients: Array
    command_range: tuple[float, float]
    thrust_range_n: tuple[float, float]
    round_trip_command: float
    round_trip_n: float
    findings: tuple[Finding, ...]

    def command(self, thrust_n: npt.ArrayLike) -> Array:
        """Return the commands for thrusts of any shape, nan outside of the range."""
        thrust = np.asarray(thrust_n, dtype=np.float64)
        low, high = self.thrust_range_n
        inside = (thrust >= low) & (thrust <= high)
        return np.where(inside, _root(self.coefficients, np.clip(thrust, low, high)), np.nan)


@dataclass(frozen=True, kw_only=True)
class MaximumThrust:
    """One motor's thrust at full command of all four, the largest measured thrust, and the mass with which four hover.

    `beyond_std_n` is the part of the standard uncertainty that is not the polynomial's own: what it may miss beyond the
    points. `volts` is the battery's voltage for which the thrust is stated, by the polynomial `by_volts` of motor
    voltage; both are None where the thrust follows from the command.
    """

    thrust_n: float
    std_n: float
    beyond_std_n: float
    volts: float | None
    by_volts: PolynomialFit | None
    measured_n: float
    measured_command: float
    gravity_mps2: float
    findings: tuple[Finding, ...]

    @property
    def hover_mass_kg(self) -> float:
        """The mass that four motors of this thrust hold in hover: 0.15 N gives 61.16 g (section 3.3.1)."""
        return ROTORS * self.thrust_n / self.gravity_mps2

    @property
    def hover_mass_std_kg(self) -> float:
        """The standard uncertainty of that mass."""
        return ROTORS * self.std_n / self.gravity_mps2


def invert(thrust_map: MotorMap) -> InverseMap:
    """Solve a thrust map of order 1 or 2 for the command, where it rises between the dead zone and full command.

    Raises FitError for another order, which has no such root, and for a map that nowhere rises above zero.
    """
    fit = thrust_map.fit
    if fit.order > 2:
        raise FitError(f"a thrust map of order {fit.order} has no inverse in closed form: fit it with order 2 too.")
    low, high = _rising(fit)
    coefficients = np.concatenate([np.zeros(2 - fit.order), fit.coefficients])
    first, last = fit.at([low, high]).tolist()
    commands = np.arange(low, high + 1, dtype=np.float32)
    single = coefficients.astype(np.float32)
    between = np.clip(fit.at(commands[:-1] + 0.5), first, last)  # rounding is worst half-way between two commands
    rounded = np.rint(_root(coefficients, between))
    lowest = float(thrust_map.command[thrust_map.command > DEAD_COMMAND].min())
    text = f"the command of a thrust is extrapolated below {lowest:.0f}, the smallest command that was measured."
    below = note("inverse-extrapolated-below", text, "motor.command_of_thrust")
    return InverseMap(
        coefficients=coefficients,
        command_range=(low, high),
        thrust_range_n=(first, last),
        round_trip_command=float(np.max(np.abs(_root(single, np.polyval(single, commands)) - commands))),
        round_trip_n=float(np.max(np.abs(fit.at(rounded) - between))),
        findings=(below,) if lowest > max(low, _NEAR * FULL_COMMAND) else (),
    )


def maximum_thrust(thrust_map: MotorMap, *, gravity_mps2: float) -> MaximumThrust:
    """Return the thrust at full command and the mass that four motors hover with (section 3.3.1)."""
    fit = thrust_map.fit
    largest, highest = int(np.argmax(thrust_map.y)), float(thrust_map.command.max())
    far = highest < NEAR_FULL * FULL_COMMAND
    text = f"the thrust at command {FULL_COMMAND} is extrapolated: {highest:.0f} is the largest that was measured."
    beyond = warning("maximum-extrapolated", text, *_MAXIMUM)
    thrust, beyond_std = float(fit.at(FULL_COMMAND)), missed(fit, FULL_COMMAND) if far else 0.0
    std = math.hypot(float(fit.std_at(FULL_COMMAND)[0]), beyond_std)
    if far and not std < _OPEN * thrust:  # also where nothing shows how far it is off
        open_by = (
            f"open by {100 * std / thrust:.0f} % (limit {100 * _OPEN:.0f} %)" if std > 0 else "of unknown uncertainty"
        )
        beyond = rejection("maximum-open", f"{text.removesuffix('.')}, and {open_by}.", *_MAXIMUM)
    return MaximumThrust(
        thrust_n=thrust,
        std_n=std,
        beyond_std_n=beyond_std,
        volts=None,
        by_volts=None,
        measured_n=float(thrust_map.y[largest]),
        measured_command=float(thrust_map.command[largest]),
        gravity_mps2=gravity_mps2,
        findings=(beyond,) if far else (),
    )


def on_battery(
    most: MaximumThrust, voltage: VoltageComparison, *, order: int, motors: Array | float
) -> MaximumThrust | None:
    """Return the largest thrust by motor voltage, at the voltage to which the battery sags under four motors.

    It is None where the command predicts better, or as well and four motors ran, and where voltage and thrust rise
    together without end, as on a supply that was set to other voltages. The battery falls in proportion to its current:
    that of the `motors` (n,) which ran together, whose power goes with thrust to the power of 1.5. Where voltage and
    command predict equally well, the uncertainty contains that the thrust may follow the command.
    """
    if voltage.better == "command" or (voltage.better == "neither" and np.all(motors == ROTORS)):
        return None
    # The order is the map's: the firmware's cubic has to rise over all voltages, and may miss beyond the points.
    std = voltage.by_command.point_std
    fit = fit_polynomial(voltage.motor_volts, voltage.value, order=order, std=std if np.all(std > 0) else None)
    battery = voltage.motor_volts * FULL_COMMAND / voltage.command

    def row(motors: Array | float, thrust: Array | float, volts: Array | float) -> Array:
        current = np.asarray(motors * np.maximum(thrust, 0.0) ** 1.5 / volts)
        return np.stack([np.ones_like(current), current], axis=-1)

    line = fit_linear(row(motors, voltage.value, battery), battery, noise_known=False)

    def excess(volts: float) -> float:
        return float(row(ROTORS, float(fit.at(volts)), volts) @ line.values) - volts

    lowest_v, highest_v = _BELOW * float(battery.min()), _BEYOND * float(battery.max())
    if not excess(lowest_v) > 0 > excess(highest_v):
        return None
    volts = float(brentq(excess, lowest_v, highest_v))
    thrust = float(fit.at(volts))
    at = row(ROTORS, thrust, volts)
    volts_std = math.sqrt(float(at @ line.covariance @ at) + float(np.mean(line.residual**2)))
    ahead = missed(fit, volts) if voltage.command.max() < NEAR_FULL * FULL_COMMAND else 0.0
    beyond_std = math.hypot(ahead, float(fit.slope_at(np.array([volts]))[0]) * volts_std)
    if voltage.better == "neither":
        beyond_std = math.hypot(beyond_std, (thrust - most.thrust_n) / math.sqrt(3))
    total = math.hypot(float(fit.std_at(volts)[0]), beyond_std)
    return replace(most, thrust_n=thrust, std_n=total, beyond_std_n=beyond_std, volts=volts, by_volts=fit)


def missed(fit: PolynomialFit, at: float) -> float:
    """Return by how much the polynomial may miss at a place ahead of the points, beyond its own uncertainty.

    That is twice by how much it misses the last points when fitted to those that lie as far below them as `at` lies
    ahead: a misfit grows with every step ahead. It is zero where such points are too few, or where `at` is not ahead.
    """
    last = float(fit.x.max())
    below = fit.x <= min(2 * last - at, 0.999 * last)
    if at <= last or len(np.unique(fit.x[below])) <= fit.order + 1:
        return 0.0
    value, end = fit.at(fit.x) + fit.residual, fit.x > 0.999 * last
    std = fit.point_std if np.all(fit.point_std > 0) else None  # nan neither
    shorter = fit_polynomial(fit.x[below], value[below], order=fit.order, std=None if std is None else std[below])
    miss = float(np.mean(value[end])) - float(shorter.at(last))
    own = float(shorter.std_at(last)[0]) ** 2 + (0.0 if std is None else float(np.mean(std[end] ** 2)))
    return _FURTHER * (math.sqrt(max(miss**2 - own, 0.0)) if math.isfinite(own) else abs(miss))


def _rising(fit: PolynomialFit) -> tuple[float, float]:
    """Return the first and last whole command, from the dead zone up, where thrust is above zero and rises."""
    commands = np.arange(DEAD_COMMAND, FULL_COMMAND + 1)
    good = (fit.at(commands) > 0) & (fit.slope_at(commands) > 0)
    edges = np.flatnonzero(np.diff(good, prepend=False, append=False)).reshape(-1, 2)
    if not len(edges):
        raise FitError("the thrust map nowhere rises above zero with the command: it has no inverse.")
    first, end = edges[np.argmax(np.diff(edges, axis=1))]
    return float(commands[first]), float(commands[end - 1])


def _root(coefficients: npt.NDArray[np.floating], thrust: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Return the command c at which a c^2 + b c + d is the thrust and rises, in the precision of the arguments.

    Of the two forms of the root, this is the one that does not subtract nearly equal numbers.
    """
    a, b, d = coefficients
    root = np.sqrt(np.maximum(b * b + 4 * a * (thrust - d), 0))
    if b < 0:
        return np.asarray((root - b) / (2 * a))
    return np.asarray(2 * (thrust - d) / (b + root))
