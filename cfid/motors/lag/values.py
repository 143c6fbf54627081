"""Lags and maps of rotors as quantities: means of the rotors with their covariance, and a row for each."""

import math
from collections.abc import Collection, Iterable, Mapping

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, note, rejection
from cfid.motors.lag.estimation import LagFit
from cfid.motors.lag.model import Supply
from cfid.motors.lag.search import SUPPLY_STD
from cfid.recordings.limits import other_scale
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.units import FULL_COMMAND

Array = npt.NDArray[np.float64]

SPEED_POLY = "motor.speed_poly"


def joint_parameters(
    fits: Collection[LagFit], *, at_v: float, volts: float | None
) -> tuple[dict[str, Parameter], tuple[Covariance, ...]]:
    """Return rates, delay and the map of the command, all as means of the rotors, and their covariance.

    A map over command times battery voltage, with drives at `at_v`, becomes a map of the command at `volts`.
    """
    values, covariance, effects = np.zeros(8), np.zeros((8, 8)), []
    for fit in fits:
        ratio = 1.0 if volts is None else volts / at_v
        power, power_std = fit.power or (1.0, 0.0)
        full = FULL_COMMAND / (at_v * ratio**power)
        rising, falling, delay_s = fit.lag
        c0, c1, c2 = fit.map
        values += np.array([1 / rising, 0, 1 / falling, 0, delay_s, c2 / full**2, c1 / full, c0]) / len(fits)
        outward = np.zeros((8, 6))  # of map and lag
        outward[[0, 2, 4], [3, 4, 5]] = -1 / rising**2, -1 / falling**2, 1
        outward[[7, 6, 5], [0, 1, 2]] = 1, 1 / full, 1 / full**2
        covariance += outward @ (fit.covariance - fit.effects @ fit.effects.T) @ outward.T / len(fits) ** 2
        at_ratio = outward[:, 1] * c1 + outward[:, 2] * 2 * c2
        effects.append(np.column_stack([at_ratio * math.log(ratio) * power_std, outward @ fit.effects]))
    most = max(one.shape[1] for one in effects)  # a rotor on which no voltage acts has one more
    mean_effects = np.mean([np.pad(one, ((0, 0), (0, most - one.shape[1]))) for one in effects], axis=0)
    covariance += mean_effects @ mean_effects.T
    covariance[4, 4] += max(fit.late_s for fit in fits) ** 2  # common to all rotors
    std = np.sqrt(np.diag(covariance))
    rates = {"dynamics.rising": slice(0, 2), "dynamics.falling": slice(2, 4)}
    places: dict[str, int | slice] = {**rates, "dynamics.delay_s": 4, SPEED_POLY: slice(5, 8)}
    std[[1, 3]] = np.nan
    found = {key: Parameter(value=values[at].tolist(), std=std[at].tolist()) for key, at in places.items()}
    return found, covariance_between({key: one.value for key, one in found.items()}, covariance)


def speed_map_findings(
    found: Mapping[str, Parameter],
    fits: Mapping[str, LagFit],
    commands: Mapping[str, tuple[float, float]],
    *,
    volts: float | None,
) -> tuple[Finding, ...]:
    """Return at which voltage and for which commands the rotors' mean map holds, or why it does not.

    `commands` are the lowest and the highest of each rotor, `fits` those of the rotors that the map averages.
    """
    names = list(fits)
    low, high = min(commands[name][0] for name in names), max(commands[name][1] for name in names)
    if (scale := other_scale(high)) is not None:
        text = (
            f"no command above {high:.3g}, of {FULL_COMMAND:g}: are they {scale}? Lags are the same on any scale, "
            "a map of speeds is not: scale the motors' columns."
        )
        return (rejection("commands-of-another-scale", text, SPEED_POLY),)
    slope = np.polyval(np.polyder(np.array(found[SPEED_POLY].value)), [low, high])
    if not np.all(slope > 0):
        text = (
            "the log does not show the speed map: see the warnings."
            if all(np.isnan(fit.covariance).any() for fit in fits.values())
            else f"the speed map does not rise from command {low:.0f} to {high:.0f}: one speed belongs to two commands."
        )
        return (rejection("map-not-monotone", text, SPEED_POLY),)
    at = (
        "the log has no battery voltage: motor.speed_poly holds in its middle"
        if volts is None
        else f"motor.speed_poly holds at {volts:.2f} V, the battery's mean while the rotors were driven"
    )
    which = f"rotor{'s' * (len(names) > 1)} {', '.join(name.removeprefix('rotor ') for name in names)}"
    text = f"{at}. It is the mean of {which} for commands from {low:.0f} to {high:.0f}."
    return (note("speed-map-voltage", text, SPEED_POLY),)


def power_finding(fits: Iterable[LagFit]) -> Finding:
    """Return a note on the power of the battery's voltage with which speeds change, in the rotors' mean."""
    powers = [fit.power for fit in fits if fit.power is not None]
    if powers:
        power, std = np.mean(powers, axis=0)  # the uncertainty is that of the voltage, which rotors have in common
        text = (
            f"speeds go with the power {power:.2f} +- {std:.2f} of the battery's voltage (0: not, 1: as with the "
            "command)."
        )
    else:
        text = (
            "the battery's voltage hardly changed with the load, so that it does not show how speeds go with it: its "
            f"power is taken as {Supply().power:g} +- {SUPPLY_STD.power:g} (0: not, 1: as with the command)."
        )
    return note("lag-voltage-power", text, SPEED_POLY, "dynamics.map")


def rotor_rows(fits: Mapping[str, LagFit], commands: Mapping[str, tuple[float, float]]) -> list[dict[str, object]]:
    """Return a row for each rotor, rising and falling, with the lowest and the highest of its commands."""
    rows: list[dict[str, object]] = []
    for name, fit in fits.items():
        low, high = commands[name]
        for rising in (True, False):
            place = 0 if rising else 1
            rows.append(
                {
                    "rotor": _rotor(name),
                    "cmd_from": low if rising else high,
                    "cmd_to": high if rising else low,
                    "rising": rising,
                    "time_constant_s": fit.lag[place],
                    "std_s": _known(fit.std_s[place]),
                    "delay_s": fit.lag.delay_s,
                    "accepted": fit.accepted,
                }
            )
    return rows


def rotor_maps(fits: Mapping[str, LagFit], *, at_v: float, by_voltage: bool) -> list[dict[str, object]]:
    """Return a row with the map of each accepted rotor, for drives at the voltage `at_v`."""
    return [
        {"rotor": _rotor(name), "of": "rad/s", **_map(fit, at_v=at_v, by_voltage=by_voltage)}
        for name, fit in fits.items()
        if fit.accepted
    ]


def _map(fit: LagFit, *, at_v: float, by_voltage: bool) -> dict[str, object]:
    over = f"cmd / {FULL_COMMAND}" + " * V" * by_voltage
    supply: dict[str, object] = {}
    if fit.power is not None:
        power, std = fit.power
        over = f"cmd / {FULL_COMMAND} * at_v * (V / at_v)^power"
        supply = {"at_v": at_v, "power": power, "std_power": _known(std)}
    values = {f"c{power}": value for power, value in enumerate(fit.map)}
    stds = {f"std_c{power}": _known(float(value)) for power, value in enumerate(fit.map_std)}
    return {"over": over, **values, **stds, **supply}


def _rotor(name: str) -> int:
    return int(name.removeprefix("rotor "))


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None
