"""Judge a battery's voltage in a flight's log: whether it shows the sag under the rotors' load."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from cfid.estimate.linear import gain_of
from cfid.estimate.signals import block_means
from cfid.findings import warning
from cfid.flight.data import FlownLog
from cfid.flight.estimation import FlightFit, fit_alone
from cfid.flight.model import DELAYS, SAG_S, filtering_s, without
from cfid.flight.rows import STEP_S, delayed
from cfid.flight.values import MOMENTS
from cfid.recordings.crazyflie import Timed

Array = npt.NDArray[np.float64]

_APART_S = 0.02  # the largest time between values of the voltage
_LEAST_SHOWN = 0.5  # of its variance within 5 s: what the load has to explain
_LATEST_S = 0.01  # by which it may lag behind the load: moments then err by 0.3 % at most
_MEAN_S = 0.02  # over which values are averaged: otherwise, noise of 20 mV in rows of 2 ms hides the load


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
    """Return a flight as `with_usable_voltages` does, unchanged if it cannot be fitted or has speeds.

    Raises CrossedError for motors in another order.
    """
    fit = fit_alone(flown.flight) if flown.flight.in_volts and flown.flight.speeds is None else None
    return flown if fit is None else with_usable_voltages([flown], fit)[0]


def _voltage_fault(flown: FlownLog, voltmeter: Timed, fit: FlightFit) -> str | None:
    """Return how a record of the battery's voltage lacks sag under load, None if it does not.

    What changes within 5 s falls with the load, the squares of the drives, which follow the commands with a lag. In a
    regression on the squares of both, a record that leads the drives, as a motor's current does, has a positive share
    of the commands, and one that is late or smoothed a negative one: to first order, that share of the lag.
    """
    flight = flown.by_command
    in_air = np.interp(voltmeter.time_s, flight.time_s, flight.airborne.astype(float), left=0.0, right=0.0) == 1.0
    time_s, volts = voltmeter.time_s[in_air], voltmeter.value[in_air]
    apart_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else math.inf
    if not apart_s <= _APART_S:
        return f"has values {1e3 * apart_s:.0f} ms apart (limit {1e3 * _APART_S:.0f} ms)"
    delay_s = max(float(fit.values[DELAYS][1]) - filtering_s(flight.low_pass_hz[1]), 0.0)
    command = delayed(flight.drive, delay_s)
    at_s = STEP_S * (np.arange(len(command)) + 0.5)
    loads = [np.interp(time_s, at_s, np.sum(drive**2, axis=1)) for drive in (command, fit.lag.follow(command))]

    length = max(round(_MEAN_S / apart_s), 1)
    means = block_means(np.stack([*loads, volts]), length=length).T
    phase = np.linspace(0, np.pi, len(means))
    slow = [np.cos(count * phase) for count in range(1 + max(round(length * apart_s * len(phase) / SAG_S), 1))]
    quick = without(means, np.column_stack(slow))
    load, sag = quick[:, :2], -quick[:, 2]
    of_command, of_drive = (shares := gain_of(load) @ sag).tolist()
    explained = 1 - float(np.sum((sag - load @ shares) ** 2)) / max(float(sag @ sag), 1e-300)
    if explained < _LEAST_SHOWN:
        return f"does not show what rotors draw, which explains {100 * explained:.0f} % of how it changes within 5 s"
    late_s = -of_command / (of_command + of_drive) * float(np.mean(fit.lag))
    return None if late_s < _LATEST_S else f"is {1e3 * late_s:.0f} ms late (limit {1e3 * _LATEST_S:.0f} ms)"
