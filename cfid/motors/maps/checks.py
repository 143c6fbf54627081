"""Checks of a motor's points before anything is fitted to them, and of what was fitted."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.polynomials import PolynomialFit, fit_polynomial, fit_power, scattered_std
from cfid.findings import Finding, rejection, warning
from cfid.motors.points import Array
from cfid.units import COVERAGE_95, DEAD_COMMAND

THESIS_SPEED = (0.04076521, 380.8359)  # rad/s of a command, eq. 3.4, second series
USUAL_SQUARE_N_S2 = 2.0e-8  # thrust per speed squared of 45 mm propellers: 1.8e-8 to 2.2e-8 in all public data
MISFIT_LIMIT = 0.05  # rms of the residuals relative to the largest value; the thesis' worse line (eq. 3.4) has 0.037
NOTABLE_SCATTER = 2.0  # times the stated standard uncertainties: from there on it is reported
OUTLIER_WEIGHT = 0.34  # of Huber's loss: four standard uncertainties off

_STANDING_N = 1e-3  # less than any motor that turns gives: 0.1 g
_APART, _ALIKE = 0.2, 0.02  # of the largest: commands that are far apart, and speeds that count as one
_STANDING_RAD_S = 10.0
_TWICE, _HALF = (1.7, 2.3), (0.43, 0.59)  # ratios of speeds that a wrong count of markers explains
_OTHER_MOTORS = 1.33  # ratio of speeds at one command that other motors and propellers explain
_FEWEST = 5  # points that show what is usual among them
_FAR = 0.25  # of the largest command: from there on, speeds lie close to a line
_EXCHANGED = 0.25  # share of the sum of squares that remains once two commands are exchanged
_MORE = 3  # different values beyond the order, in each half of the points, to compare them
_LARGEST_IN_STD = 3.0  # between halves, of the standard uncertainties of both
_SAME_STEP = 0.8  # share of a staircase's steps that make it one

_MARKERS = "check the number of its reflective markers, and that each speed had settled."


def check_thrust(command: Array, thrust_n: Array) -> None:
    """Check thrusts (n,) in N, per motor, of commands above the dead zone.

    Raises FitError when there are none, when no motor ran, or when thrust points down throughout.
    """
    running = thrust_n[_running(command)]
    if running.min() < -_STANDING_N and running.max() < _STANDING_N:
        raise FitError(
            f"the thrust is negative throughout, down to {running.min():.3g} N: Fz counts downwards here. Was the "
            "vehicle mounted upside down, or the load cell? Turn the sign of Fz, or leave it where it was turned."
        )
    if running.max() < _STANDING_N:
        raise FitError(
            f"the motors never ran: above command {DEAD_COMMAND} the largest thrust is {running.max():.2g} N, and a "
            f"motor that turns gives {_STANDING_N:g} N. Check battery, arming and propellers."
        )


def check_speed(command: Array, speed_rad_s: Array) -> None:
    """Check speeds (n,) in rad/s of commands above the dead zone.

    Raises FitError when there are none, when no motor ran, or when the speed is the same at commands far apart.
    """
    at, running = command[_running(command)], speed_rad_s[_running(command)]
    if running.max() < _STANDING_RAD_S:
        raise FitError(
            f"the motors never ran: above command {DEAD_COMMAND} the largest speed is {running.max():.2g} rad/s. Does "
            "the tachometer see its marker, and were the motors armed?"
        )
    if np.ptp(at) > _APART * at.max() and np.ptp(running) < _ALIKE * running.max():
        raise FitError(
            f"the speed is {running.mean():.4g} rad/s at every command from {at.min():.0f} to {at.max():.0f}: the "
            "instrument's display stands still, or it counts something else than the rotor."
        )


def marker_findings(
    command: Array,
    speed_rad_s: Array,
    thrust_n: Array | None = None,
    *,
    quantities: Sequence[str],
    single: bool = True,
) -> tuple[Finding, ...]:
    """Reject quantities calculated from speeds (n,) that were counted double, or divided twice.

    Single wrong points show by comparison with the others, unless `single` is false. Where all points are wrong, they
    show by comparison with the thesis' motors and, where thrust (n,) was measured, with that too: both must agree,
    since another propeller differs in one of them. A rig that states another platform withdraws the latter rejection.
    """
    running = command > DEAD_COMMAND
    thrust = None if thrust_n is None else thrust_n[running]
    odd = _odd_ones(command[running], speed_rad_s[running]) if single else ()
    wrong = _all_wrong(command[running], speed_rad_s[running], thrust)
    return (
        *(rejection("speed-marker-count", text, *quantities) for text in odd),
        *(rejection("speed-unusual", text, *quantities) for text in wrong),
    )


def exchange_findings(command: Array, value: Array, *, order: int, quantities: Sequence[str]) -> tuple[Finding, ...]:
    """Reject a map of values (n,) of which two commands seem exchanged: the lower one has the larger value.

    The commands must outnumber the polynomial's coefficients by three, and fit it much better once exchanged.
    """
    commands = np.unique(command)
    if len(commands) < order + 4:
        return ()
    means = np.array([value[command == one].mean() for one in commands])
    before = _squares(commands, means, order)
    best, pair = before, (0, 0)
    for low, high in zip(*np.triu_indices(len(commands), 1), strict=True):
        if means[low] > means[high]:
            exchanged = means.copy()
            exchanged[[low, high]] = means[[high, low]]
            best, pair = min((best, pair), (_squares(commands, exchanged, order), (int(low), int(high))))
    if best >= _EXCHANGED * before:
        return ()
    first, second = pair
    text = (
        f"command {commands[first]:.0f} has {means[first]:.4g} and command {commands[second]:.0f} only "
        f"{means[second]:.4g}: were their files exchanged? The points describe one curve once they are."
    )
    return (rejection("commands-exchanged", text, *quantities),)


def half_findings(x: Array, y: Array, std: Array, *, order: int, quantities: Sequence[str]) -> tuple[Finding, ...]:
    """Warn where the first half of points (n,), in the order of recording, gives another curve than the second.

    The curves are compared at the largest value that both reach.
    """
    middle = len(x) // 2
    halves = [(x[part], y[part], std[part]) for part in (slice(middle), slice(middle, None))]
    at = min((float(own.max()) for own, *_ in halves if len(own)), default=0.0)
    if any(len(np.unique(own)) < order + _MORE or own.min() >= at for own, *_ in halves):
        return ()
    found = []
    for own, value, noise in halves:
        wide = scattered_std(own, value, noise, order=order, robust=True)
        fit = fit_polynomial(own, value, order=order, std=wide, robust=True)
        found.append((float(fit.at(at)), float(fit.confidence([at])[0]) / COVERAGE_95))
    (first, first_std), (second, second_std) = found
    apart = abs(first - second) / math.hypot(first_std, second_std)
    if not apart > _LARGEST_IN_STD:
        return ()
    text = (
        f"the first half of the points gives {first:.4g} at {at:.4g}, the second {second:.4g}: {apart:.1f} standard "
        f"uncertainties apart (limit {_LARGEST_IN_STD:g}). Did the battery sag, or the load cell drift?"
    )
    return (warning("map-halves-differ", text, *quantities),)


def _squares(x: Array, y: Array, order: int) -> float:
    return float(np.sum(fit_polynomial(x, y, order=order).residual ** 2))


def missing_commands(command: Array, *, expected: Iterable[int] | None = None) -> tuple[int, ...]:
    """Return the commands that were requested, or that an even staircase would have, but that no point has."""
    there = np.unique(command)
    if expected is not None:
        return tuple(sorted(set(expected) - set(there.tolist())))
    if len(there) < _FEWEST:
        return ()
    steps = np.diff(there)
    usual = float(np.median(steps))
    if np.mean(np.isclose(steps, usual)) < _SAME_STEP:
        return ()
    even = np.arange(there[0], there[-1], usual)
    apart = np.abs(np.subtract.outer(even, there)).min(axis=1)
    return tuple(int(value) for value in even[apart > usual / 2])


def listed(commands: Sequence[float]) -> str:
    """Return commands as text for a sentence, only the first few of many."""
    shown = ", ".join(f"{value:.0f}" for value in commands[:6])
    return shown if len(commands) <= 6 else f"{shown} and {len(commands) - 6} more"


def _running(command: Array) -> npt.NDArray[np.bool_]:
    running = ~(command <= DEAD_COMMAND)  # nan: thrust and speed are known, the command is not
    if not running.any():
        raise FitError(
            f"no command above {DEAD_COMMAND} was measured: up to there a motor stands, nothing can be fitted."
        )
    return running


def _odd_ones(command: Array, speed: Array) -> Iterable[str]:
    """Compare points with the line through most of them, which tolerates up to half of them being wrong."""
    if len(np.unique(command)) < _FEWEST:
        return
    slope, level = _repeated_median_line(command, speed)
    usual = np.maximum(slope * command + level, _STANDING_RAD_S)
    ratio = speed / usual
    # At small commands a motor's speed departs from the line anyway.
    far = command > _FAR * command.max()
    for odd, word in ((_within(ratio, _TWICE), "twice"), (_within(ratio, _HALF) & far, "half")):
        if odd.any():
            at = listed(np.unique(command[odd]).tolist())
            yield f"at command {at} the speed is about {word} what the others say: {_MARKERS}"


def _all_wrong(command: Array, speed: Array, thrust: Array | None) -> Iterable[str]:
    """Compare all speeds together with those of the thesis' motors, and with those that the thrust needs."""
    if not len(speed):
        return
    ratio = float(np.median(speed / np.polyval(THESIS_SPEED, command)))
    found = f"the speeds are {ratio:.2f} times those of the thesis' motors (eq. 3.4)"
    if thrust is not None:
        square = fit_power(speed, thrust, power=2).coefficients[0]
        by_thrust = math.sqrt(USUAL_SQUARE_N_S2 / square) if square > 0 else 1.0
        if (by_thrust > 1) != (ratio > 1) or 1 / _OTHER_MOTORS < ratio < _OTHER_MOTORS:
            return
        ratio = by_thrust
        found += f", thrust over speed squared is {square:.2g} N s^2 (usual: {USUAL_SQUARE_N_S2:.1g})"
    if _within(ratio, _TWICE) or _within(ratio, _HALF):
        yield f'{found}: {_MARKERS} For other propellers write platform = "other" under [vehicle] in rig.toml.'


def _repeated_median_line(x: Array, y: Array) -> tuple[float, float]:
    """Return slope and level of a line that up to half of the points cannot move [Sie]."""
    apart = np.subtract.outer(x, x)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.where(apart != 0, np.subtract.outer(y, y) / apart, np.nan)
    slope = float(np.median(np.nanmedian(slopes, axis=1)))
    return slope, float(np.median(y - slope * x))


def _within(ratio: Array | float, limits: tuple[float, float]) -> npt.NDArray[np.bool_]:
    return np.asarray((np.asarray(ratio) > limits[0]) & (np.asarray(ratio) < limits[1]))


def scatter_findings(fit: PolynomialFit, command: Array, key: str) -> Iterable[Finding]:
    """Report how well the points agree with each other, and which are outliers."""
    if fit.degrees_of_freedom == 0:
        text = f"{len(command)} points determine all coefficients and leave nothing to judge them by."
        taken = (
            f" Each is taken as off by {100 * MISFIT_LIMIT:.0f} % of the largest, as far as a map may miss its points."
        )
        yield warning("map-without-freedom", text + taken * bool(np.isfinite(fit.std).all()), key)
    if fit.inflation is not None and fit.inflation > NOTABLE_SCATTER:
        yield warning(
            "map-points-scatter",
            f"the points scatter {fit.inflation:.1f} times as far about the curve as within their windows (drift, a "
            "sagging battery, or another shape): standard uncertainties are widened by that.",
            key,
        )
    apart = np.unique(command[fit.weight < OUTLIER_WEIGHT])
    if len(apart):
        text = f"command {listed(apart.tolist())} is off by more than four standard uncertainties: it counts less."
        yield warning("map-outlier", text, key)


def misfit_findings(fit: PolynomialFit, y: Array, quantities: Sequence[str], *, command: Array) -> Iterable[Finding]:
    """Reject a polynomial that misses its points' values (n,) at commands (n,), nan where none was stated."""
    misfit = fit.residual_norm / np.sqrt(len(y)) / float(np.max(np.abs(y)))
    if misfit > MISFIT_LIMIT:
        furthest = command[np.argmax(np.abs(fit.residual))]
        at = f", most at command {furthest:.0f}" if np.isfinite(furthest) else ""
        yield rejection(
            "map-misfit",
            f"the polynomial misses the points by {100 * misfit:.2g} % of the largest (rms, limit "
            f"{100 * MISFIT_LIMIT:.0f} %){at}: the points are not steady, or another order describes them.",
            *quantities,
        )


def falling_findings(fit: PolynomialFit, x: Array, quantities: Sequence[str]) -> Iterable[Finding]:
    """Reject a polynomial that does not rise throughout the range of its points (n,)."""
    if np.any(fit.slope_at(np.linspace(x.min(), x.max(), 200)) <= 0):
        text = "the polynomial does not rise throughout: one value belongs to two commands."
        yield rejection("map-not-monotone", text, *quantities)
