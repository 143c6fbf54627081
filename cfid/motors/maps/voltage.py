"""Thrust over motor voltage, command / 65535 * battery, compared with thrust over the command alone.

The input is steady points: a rotor that changes its speed follows neither.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from cfid.errors import FitError
from cfid.estimate.monotone_cubic import constrain
from cfid.estimate.polynomials import PolynomialFit, fit_polynomial
from cfid.findings import Finding, note, rejection, warning
from cfid.motors.points import Array, weighable
from cfid.units import DEAD_COMMAND, FULL_COMMAND

KEY = "motor.thrust_voltage_poly"
THRUST_ORDER = 3  # as in the firmware's compensation of the battery

_TELLING = 1.05  # ratio of prediction errors from which on one form is the better one
_SAGS, _FALLS = 0.01, -0.8  # a voltage sags by more than this share, and with a correlation with the command below this


@dataclass(frozen=True, kw_only=True)
class VoltageComparison:
    """Polynomials of equal order over motor voltage and over command, judged on commands left out of the fit.

    `command`, `motor_volts` and `value` (n,) are those of all points that `used` (N,) marks. `voltage_rms` and
    `command_rms` are the errors of prediction, in the value's unit, for the points at `judged` commands, with each form
    fitted by plain least squares.

    Thrust over voltage is the cubic that rises over all voltages, as the firmware needs it; where the points contradict
    every such cubic, a rejection states why, and `by_voltage` is the plain one.
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
    def verdict(self) -> Finding:
        """A finding on which form predicts better, and by how much."""
        how = f"cross-validated over {self.judged} commands"
        if self.better == "neither":
            text = f"motor voltage and command predict equally well, {how}: this battery cannot distinguish them."
            return note("voltage-or-command", text, KEY)
        other = "command" if self.better == "voltage" else "voltage"
        times = f"{max(self.ratio, 1 / self.ratio):.2g} times"
        text = f"motor {self.better} predicts {times} better than {other}, {how}."
        return note("voltage-or-command", text, KEY)

    @property
    def rejected(self) -> bool:
        """Whether the firmware cannot use this cubic."""
        return any(finding.severity == "rejection" for finding in self.findings)


def motor_volts(*, command: npt.ArrayLike, vbat_v: npt.ArrayLike) -> Array:
    """Return the mean voltage at a motor: the command chops the battery's voltage."""
    return np.asarray(np.asarray(command, dtype=np.float64) / FULL_COMMAND * np.asarray(vbat_v, dtype=np.float64))


def compare_thrust(
    *,
    command: Array,
    vbat_v: Array,
    thrust_n: Array,
    std_n: Array | None = None,
    shared_n: Array | None = None,
    folds: int | None = None,
    max_thrust_n: float | None = None,
) -> VoltageComparison:
    """Fit thrust (n,) as a cubic of motor voltage, and of the command alone; see `compare`.

    The cubic of motor voltage is one that rises over all voltages, and that the firmware can invert up to
    `max_thrust_n`: see `constrain`.

    Raises FitError when there are too few commands, or when thrust does not rise with the voltage.
    """
    found = compare(
        command=command,
        vbat_v=vbat_v,
        value=thrust_n,
        order=THRUST_ORDER,
        std=std_n,
        shared=shared_n,
        folds=folds,
    )
    std, shared = _used(found.used, std_n, shared_n)
    rising = constrain(found.by_voltage, thrust_n=found.value, std_n=std, shared_n=shared, max_thrust_n=max_thrust_n)
    if rising.refusal:
        return replace(found, findings=(*found.findings, rejection("voltage-cubic-refused", rising.refusal, KEY)))
    text = (
        f"thrust of motor voltage is the cubic nearest to the points that rises over all voltages, as the firmware's "
        f"inverse needs it: it departs by up to {100 * rising.departure:.1f} % of the largest thrust."
    )
    held = (note("voltage-cubic-held", text, KEY),) if rising.bound else ()
    return replace(found, by_voltage=rising.fit, findings=(*found.findings, *held))


def compare(
    *,
    command: Array,
    vbat_v: Array,
    value: Array,
    order: int,
    std: Array | None = None,
    shared: Array | None = None,
    folds: int | None = None,
) -> VoltageComparison:
    """Fit both forms to points (n,) above the dead zone, and let each predict the commands left out of its fit.

    A command is left out with all its points, else a point would be predicted from another one at the same voltage.
    Commands are left out one after another, or in `folds` groups in turn. The lowest and the highest stay in, as a
    cubic must not be extrapolated. `std` (n,) weights the points, and `shared` (n, m) are the parts of it that points
    have in common, as in `fit_polynomial`; the errors of prediction are not weighted.

    Raises FitError when there are too few commands.
    """
    used = np.asarray((command > DEAD_COMMAND) & np.isfinite(vbat_v) & np.isfinite(value))
    std, shared = _used(used, std, shared)
    command, value = command[used], value[used]
    volts = motor_volts(command=command, vbat_v=vbat_v[used])
    inner = np.unique(command)[1:-1]
    if len(inner) <= order:
        raise FitError(
            f"{len(np.unique(command))} commands above {DEAD_COMMAND} are too few to judge forms of order {order} on "
            f"commands left out of the fit: {order + 3} are needed. Steps that never settled do not "
            "count: hold each longer."
        )
    groups = [inner[i :: folds or len(inner)] for i in range(min(folds or len(inner), len(inner)))]
    errors = [
        np.concatenate([_unseen(x, value, np.isin(command, group), order, std) for group in groups])
        for x in (volts, command)
    ]
    voltage_rms, command_rms = (float(np.sqrt(np.mean(error**2))) for error in errors)
    return VoltageComparison(
        by_voltage=fit_polynomial(volts, value, order=order, std=std, shared=shared),
        by_command=fit_polynomial(command, value, order=order, std=std, shared=shared),
        command=command,
        motor_volts=volts,
        value=value,
        used=used,
        voltage_rms=voltage_rms,
        command_rms=command_rms,
        judged=len(inner),
        findings=_visited_once(command, vbat_v[used]),
    )


def _used(used: npt.NDArray[np.bool_], std: Array | None, shared: Array | None) -> tuple[Array | None, Array | None]:
    """Return standard uncertainties of the used points, as weights, and their shared parts; None where unknown."""
    return None if std is None else weighable(std[used]), None if shared is None else shared[used]


def _unseen(x: Array, value: Array, left_out: npt.NDArray[np.bool_], order: int, std: Array | None) -> Array:
    """Return by how much a fit to the other points misses the points left out."""
    fit = fit_polynomial(x[~left_out], value[~left_out], order=order, std=None if std is None else std[~left_out])
    return value[left_out] - fit.at(x[left_out])


def _visited_once(command: Array, vbat_v: Array) -> tuple[Finding, ...]:
    """Warn when no command (n,) was held at two voltages (n,): the run cannot distinguish the two forms."""
    if len(np.unique(command)) < len(command):
        return ()
    low, high = float(vbat_v.min()), float(vbat_v.max())
    ends = dict.fromkeys(f"{volts:.4g}" for volts in (low, high))
    where, remedy = f", at {' to '.join(ends)} V", "Repeat it at another voltage: another charge, or supply voltage."
    if high - low > _SAGS * high and float(np.corrcoef(command, vbat_v)[0, 1]) < _FALLS:
        where = f": voltage fell as the command rose, from {high:.3g} to {low:.3g} V"
        remedy = "Record the way down too, or repeat on another charge."
    text = f"every command was held once{where}, so this run cannot separate the two. {remedy}"
    return (warning("voltage-follows-command", text, KEY),)
