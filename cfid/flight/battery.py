"""Restore the sag under load that a late, smoothed or rarely sampled record of the battery's voltage leaves out.

A battery's voltage drops within milliseconds of its rotors' load, and by up to as much again within 1.5 s. The load is
modelled as a sum with non-negative factors of the squares of the commands, of the squares of the drives that follow the
commands with the rotors' lag, and of the latter together with the slow relaxation that follows them. The record is

    volts = what changes within 5 s and slower - load

after a first-order low-pass or a delay, at the times of its samples. What the low-pass or the delay removes from the
load is restored. A brushed motor's current overshoots, which nearly undoes a smoothing as short as the rotors' lag: the
less the smoothing or the delay exceeds that lag, the more uncertain the restored part is.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls
from scipy.signal import lfilter

from cfid.estimate.signals import block_means
from cfid.findings import Finding, warning
from cfid.flight.data import FlownLog
from cfid.flight.estimation import FlightFit, fit_alone
from cfid.flight.model import SAG_S, filtering_s
from cfid.flight.rows import STEP_S, delayed
from cfid.flight.values import MOMENTS, TIMES

Array = npt.NDArray[np.float64]

# For half the time between samples plus the smoothing: up to this limit, moments err by 0.3 % at most, and nothing is
# restored.
_LATE_S = 0.01
# Up to 0.83 s: a longer smoothing shows no load of manoeuvres.
_SMOOTHED_S = (0.0, *(0.003 * 1.1**power for power in range(60)))
_DELAYED_S = tuple(0.005 * count for count in range(1, 41))  # up to 0.2 s
# The time in which a cell relaxes further: without this term, a smoothing of 0.2 s was identified as one of 0.29 s.
_RELAXING_S = 1.5
_SHOWN = 0.5  # of the variance within 5 s: the least part that the load has to explain
# Of the voltage: the most that a record which does not show the load may leave out. Moments then err by 0.6 %.
_HIDDEN = 0.003
_MEAN_S = 0.02  # over which samples are averaged: otherwise, noise of 20 mV in rows of 2 ms hides the load
_FEWEST = 60  # the least number of samples
_APART_S = 0.25  # the largest time between samples: rarer samples show manoeuvres of half a second only by chance
_QUICK = 0.05  # the quantile of the times between changes that is taken as the time between samples
_SINGLE = 1.5  # rows: if changes are closer than this, every row is a sample
# Of the time between samples: the largest mean distance of the changes from its multiples. By chance it is 0.25.
_UNEVEN = 0.15
# A smoothing has to leave at most this part of what remains unexplained without smoothing. An unsmoothed record of a
# load that differs by 20 ms leaves 0.9.
_LESS = 0.85
_SAMPLED_STD = 0.2  # of the sag between samples; currents that overshoot omit a seventh of it
_SMOOTHED_STD = 0.3  # of the sag that a long smoothing removes; currents that overshoot omit up to 0.4 of it
# Of the lag: the time by which a current that overshoots leads. It is 1 / 0.57 - 1, with 1.5 V induced of 2.5 V at
# hover.
_LEAD = 0.75


class Record(NamedTuple):
    """Samples (k,) of the voltage at times since the first drive, and the time between them."""

    time_s: Array
    volts: Array
    apart_s: float


class Path(NamedTuple):
    """What lies between a load and its record: a low-pass with a time constant, or a delay."""

    smoothed_s: float = 0.0
    late_s: float = 0.0

    @property
    def whole_s(self) -> float:
        """The delay of slow changes in the record."""
        return self.smoothed_s + self.late_s

    @property
    def longest(self) -> bool:
        """Whether this is the longest path that is searched, so that the true one may be longer."""
        return self.smoothed_s == _SMOOTHED_S[-1] or self.late_s == _DELAYED_S[-1]

    def of(self, loads: Array) -> Array:
        """Return what the path records of loads (n, p)."""
        return delayed(_smoothed(loads, self.smoothed_s), self.late_s)


class Shown(NamedTuple):
    """What a record shows of the load: the path between them, and the part of its variance that the load explains.

    `hidden_v` is what the best-fitting path removes from the load, even if it fits hardly better than no path at all.
    `between` (n,) and `taken` (n,) are what the record lacks at each drive: between its samples, and through its path.
    """

    path: Path
    explained: float
    hidden_v: float
    between: Array
    taken: Array


def with_whole_sag(flights: Sequence[FlownLog], found: FlightFit) -> tuple[Sequence[FlownLog], list[Finding]]:
    """Return the flights with the sag that a late voltage record leaves out, and findings on that.

    `found` is a fit to these flights, which gives the rotors' lag. If any record does not show the load, the drives of
    all flights are commands without the voltage.
    """
    if not found.in_volts:
        return flights, []
    each, findings = [], []
    for one in flights:
        whole, finding = _whole(one, found)
        if finding is not None:
            findings.append(finding.at(one.flight.name))
        if whole is None:
            return [replace(flown, flight=flown.by_command) for flown in flights], findings
        each.append(whole)
    return each, findings


def with_own_sag(flown: FlownLog) -> FlownLog:
    """Return a flight as `with_whole_sag` does, with the new findings among its own; unchanged if it cannot be fitted.

    Raises CrossedError for motors in another order.
    """
    if not flown.flight.in_volts:
        return flown
    found = fit_alone(flown.flight)
    if found is None:
        return flown
    (whole,), findings = with_whole_sag([flown], found)
    return replace(whole, findings=(*whole.findings, *findings))


def _whole(flown: FlownLog, found: FlightFit) -> tuple[FlownLog | None, Finding | None]:
    """Return a flight with the whole sag, None if its record does not show it, and a finding if anything changed."""
    if flown.voltmeter is None:
        return flown, None
    record = _sampled(*flown.voltmeter)
    shown = None
    if len(record.time_s) >= _FEWEST and record.apart_s < _APART_S:
        shown = _shown(flown, record, found)
    if shown is None or shown.explained < _SHOWN:
        hides = record.apart_s / 2 > _LATE_S or (shown is not None and shown.hidden_v > _HIDDEN * np.mean(record.volts))
        return (None, _unusable(record)) if hides else (flown, None)
    if shown.path.longest:
        return None, _unusable(record)
    if record.apart_s / 2 + shown.path.whole_s <= _LATE_S:
        return flown, None
    at_s, missing = _middles_s(flown), shown.between + shown.taken
    volts = np.interp(at_s, record.time_s, record.volts) + missing
    lead_s = _LEAD * sum(found.lag) / 2
    taken_std = max(lead_s / max(shown.path.whole_s, lead_s), _SMOOTHED_STD)
    volts_std = _SAMPLED_STD * shown.between + taken_std * shown.taken
    drive = flown.by_command.drive * volts[:, np.newaxis]
    flight = replace(flown.flight, drive=drive, volts=volts, volts_std=volts_std)
    return replace(flown, flight=flight), _late(
        record, shown, missing[flight.step_driven], volts_std[flight.step_driven]
    )


def _sampled(time_s: Array, volts: Array) -> Record:
    """Return the samples of a voltage (k,) that rows may repeat: the changes, if these are regularly spaced.

    A quantized voltage that changes slowly also repeats in many rows, but its changes are not at multiples of one time.
    """
    row_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else math.inf
    changes = np.flatnonzero(np.diff(volts)) + 1
    if len(changes) < 2:
        return Record(time_s[:1], volts[:1], math.inf)
    gone_s = np.diff(time_s[changes])
    apart_s = float(np.quantile(gone_s, _QUICK))
    uneven = float(np.mean(np.abs(gone_s / apart_s - np.round(gone_s / apart_s))))
    if apart_s < _SINGLE * row_s or uneven > _UNEVEN:
        return Record(time_s, volts, row_s)
    return Record(time_s[changes], volts[changes], apart_s)


def _shown(flown: FlownLog, record: Record, found: FlightFit) -> Shown | None:
    """Return what a record shows of the load with the path that fits it best; None for too few samples in the air."""
    flight, at_s = flown.by_command, _middles_s(flown)
    in_air = np.interp(record.time_s, flight.time_s, flight.airborne.astype(float), left=0.0, right=0.0) == 1.0
    time_s, volts = record.time_s[in_air], record.volts[in_air]
    if len(time_s) < _FEWEST:
        return None
    length = max(round(_MEAN_S / record.apart_s), 1)
    at_samples_s, (time_s, volts) = time_s, block_means(np.array([time_s, volts]), length=length)
    phase = np.pi * (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    count = max(round((time_s[-1] - time_s[0]) / SAG_S), 1)
    slow = np.column_stack([np.cos(power * phase) for power in range(1 + count)])
    basis, loads = np.linalg.qr(slow)[0], _loads(flown, found)
    left = volts - basis @ (basis.T @ volts)

    def explaining(path: Path) -> tuple[float, Array]:
        """Return the part of the variance that the recorded loads leave unexplained, and the loads' factors (p,)."""
        columns = [np.interp(at_samples_s, at_s, column) for column in path.of(loads).T]
        means = block_means(np.array(columns), length=length).T
        factors, error = nnls(means - basis @ (basis.T @ means), -left)
        return error**2 / max(float(left @ left), 1e-300), np.asarray(factors)

    def unexplained(path: Path) -> float:
        return explaining(path)[0]

    smoothing = min((Path(smoothed_s=each) for each in _SMOOTHED_S), key=unexplained)
    delay = min((Path(late_s=each) for each in _DELAYED_S), key=unexplained)
    best = delay if unexplained(delay) <= _LESS * unexplained(smoothing) else smoothing
    hidden = (best.of(loads) - loads) @ explaining(best)[1]
    path = best if unexplained(best) <= _LESS * unexplained(Path()) else Path()
    left_over, factors = explaining(path)
    there, load = path.of(loads) @ factors, loads @ factors
    recorded = np.interp(at_s, record.time_s, np.interp(record.time_s, at_s, there))
    hidden_v = float(np.std(hidden[flown.flight.step_driven]))
    return Shown(path, 1 - left_over, hidden_v, recorded - there, there - load)


def _loads(flown: FlownLog, found: FlightFit) -> Array:
    """Return the three terms of the load (n, 3), up to factors.

    They are the squares of the commands, the squares of what follows these with the rotors' lag, and the latter plus as
    much again of slow relaxation: a cell never relaxes without an immediate drop.
    """
    command = flown.by_command.drive
    delay_s = max(float(found.values[3]) - filtering_s(flown.flight.low_pass_hz[1]), 0.0)
    late = delayed(found.lag.follow(command), delay_s)
    quick = np.column_stack([np.sum(delayed(command, delay_s) ** 2, axis=1), np.sum(late**2, axis=1)])
    return np.column_stack([quick, quick[:, 1:] + _smoothed(quick[:, 1:], _RELAXING_S)])


def _middles_s(flown: FlownLog) -> Array:
    """Return the times (n,) of the drives' middles since the start of the first drive."""
    return np.asarray(STEP_S * (np.arange(len(flown.by_command.drive)) + 0.5), dtype=np.float64)


def _smoothed(loads: Array, for_s: float) -> Array:
    if for_s == 0:
        return loads
    share = 1 - math.exp(-STEP_S / for_s)
    return np.asarray(loads[0] + lfilter([share], [1.0, share - 1], loads - loads[0], axis=0))


def _late(record: Record, shown: Shown, missing: Array, volts_std: Array) -> Finding:
    """Return a warning with what a record lacks (k,) while the rotors are driven, in V, and its uncertainty."""
    left_v, std_v = float(np.std(missing)), float(np.std(volts_std))
    text = (
        f"the battery's voltage is {_described(record, shown.path)}: it leaves out {left_v:.2g} V rms of the sag "
        f"under load, which is added from the commands in proportion to the sag that it shows, to {std_v:.1g} V rms. "
        "Log pm.vbat at 100 Hz or more, not smoothed."
    )
    return warning("flight-voltage-late", text, *TIMES, *MOMENTS.values())


def _unusable(record: Record) -> Finding:
    every = f"{record.apart_s:.2g} s apart" if math.isfinite(record.apart_s) else "all the same"
    text = (
        f"the battery's voltage, whose values are {every}, does not show what rotors draw: it is not used, and thrust "
        "is that of the commands. Log pm.vbat at 100 Hz or more, not smoothed."
    )
    return warning("flight-voltage-not-used", text, *MOMENTS.values())


def _described(record: Record, path: Path) -> str:
    apart = f"new every {1e3 * record.apart_s:.0f} ms" if record.apart_s / 2 > _LATE_S / 2 else ""
    smoothed = f"smoothed by {1e3 * path.smoothed_s:.0f} ms" if path.smoothed_s > _LATE_S / 2 else ""
    late = f"{1e3 * path.late_s:.0f} ms late" if path.late_s else ""
    return " and ".join(word for word in (apart, smoothed, late) if word)
