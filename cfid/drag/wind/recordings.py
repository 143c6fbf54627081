"""Recordings of one command each, as an index names them, to one mean force each."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from cfid.console.options import positive
from cfid.drag.wind.files import WindRow
from cfid.drag.wind.plan import WindSetting
from cfid.errors import CfidError, FitError
from cfid.findings import texts
from cfid.motors.vibration.data import Rotors, VibrationRecord
from cfid.units import DEAD_COMMAND, RPM

if TYPE_CHECKING:
    from cfid.drag.wind.mean_forces import MeanForce
    from cfid.drag.wind.reduction import WindRun
    from cfid.records.parameters import Source
    from cfid.records.tables.wrench import WrenchReading, WrenchRecord

HEARD = "without a tachometer reading: the rotors' speed is heard in the vibration."

_LISTENED_S = 3.0  # of a window: enough to tell a speed to a thousandth
_HEARD_FROM_HZ = 1990.0  # below, the blade-pass line of a rotor at 3000 rad/s folds back onto others
_HEARD_ANY_FROM_HZ = 3300.0  # the same at 5000 rad/s
_SLOWEST_RAD_S, _USUAL_RAD_S = 200.0, 3000.0  # a Crazyflie's rotors stay below
_UNHEARD = "no tachometer reading, and vibration does not tell the rotors' speed"
_BY_HAND = "The columns from_s and to_s of the index give a window by hand."
_AT_ONCE = 2  # files: while one waits for the disk or is parsed, another is averaged


@dataclass(frozen=True, kw_only=True)
class Recordings:
    """How recordings are read and averaged, and how many markers the tachometer counted."""

    reading: "WrenchReading"
    method: str
    markers: int


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """What came of one recording or run: mean forces, the battery's voltage at each where known, and what is said."""

    runs: "tuple[WindRun, ...]"
    notes: tuple[str, ...]
    sources: "tuple[Source, ...]"
    volts: tuple[float, ...] = ()


def reduce_rows(rows: Sequence[WindRow], how: Recordings) -> list[Reduced]:
    """Reduce the recordings of an index, several at once. Raises DataError or FitError that name row and file."""
    import pandas as pd  # before the threads ask for it  # noqa: F401

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        return list(pool.map(partial(_reduce_row, how=how), rows))


def _reduce_row(row: WindRow, how: Recordings) -> Reduced:
    """Reduce a recording; what a load cell feels of standing rotors is not looked at."""
    import numpy as np

    from cfid.drag.wind.mean_forces import MeanForce
    from cfid.records.tables.wrench import read_wrench

    record = read_wrench(row.loadcell, how.reading)
    name = f"{row.where} {row.loadcell.name}"
    notes = [note.removeprefix(f"{record.path.name}: ") for note in record.notes]
    mean, shown = MeanForce(np.zeros(3), np.zeros(3), (0.0, 0.0)), 0.0
    if row.command > DEAD_COMMAND:
        mean = _averaged(row, record, how)
        notes += [mean.note] if mean.note else []
        if not row.tach_rpm and row.max_mps > 0:
            notes.append(HEARD)
        shown = shown_rpm(row.tach_rpm, record, mean, how, name=name, windy=row.max_mps > 0)
    run = wind_run(mean, shown, name=name, command=row.command, place=row)
    return Reduced(runs=(run,), notes=tuple(notes), sources=(record.source,))


def shown_rpm(
    typed: float | None, record: "WrenchRecord", mean: "MeanForce", how: Recordings, *, name: str, windy: bool
) -> float:
    """Return a tachometer's reading, or what it would show by what is heard; a reference needs none.

    The loudest rotor stands for all four, as the one that a tachometer reads does (C.3.1). Raises FitError when nobody
    can tell.
    """
    if typed:
        return positive(typed, f"{name}: the tachometer's")
    if not windy:
        return 0.0
    rate_hz = (len(record.time_s) - 1) / float(record.time_s[-1] - record.time_s[0])
    if rate_hz < _HEARD_FROM_HZ:
        raise FitError(f"{name}: {_UNHEARD}, sampled at {rate_hz:.0f} Hz: 2000 are needed. Give the reading.")
    begin_s, end_s = mean.window_s
    try:
        heard = VibrationRecord(record, Rotors(expected_rad_per_s=_turning(rate_hz))).speed_in(
            begin_s, min(begin_s + _LISTENED_S, end_s), rotors=1
        )
    except CfidError as error:
        raise FitError(f"{name}: {_UNHEARD}: {error} Give the reading.") from None
    if not heard.accepted:
        reasons = " ".join(texts(heard.findings, "rejection"))
        raise FitError(f"{name}: {_UNHEARD}: {reasons} Give the reading.")
    return how.markers * heard.speed_rad_per_s / RPM


def _turning(rate_hz: float) -> tuple[float, float] | None:
    """Return how fast rotors may turn, where blade pass of faster ones would fold back; None where it does not."""
    return (_SLOWEST_RAD_S, _USUAL_RAD_S) if rate_hz < _HEARD_ANY_FROM_HZ else None


def wind_run(mean: "MeanForce", shown: float, *, name: str, command: int, place: WindRow | WindSetting) -> "WindRun":
    """Return a mean force with what was set and read."""
    from cfid.drag.wind.reduction import WindRun

    return WindRun(
        name=name,
        command=command,
        angle_deg=place.angle_deg,
        min_mps=place.min_mps,
        max_mps=place.max_mps,
        shown_rpm=shown,
        force_n=mean.force_n,
        force_std_n=mean.std_n,
        azimuth_rad=place.azimuth_rad,
    )


def _averaged(row: WindRow, record: "WrenchRecord", how: Recordings) -> "MeanForce":
    from cfid.drag.wind.mean_forces import mean_force, mean_force_thesis

    try:
        return (mean_force_thesis if how.method == "thesis" else mean_force)(
            time_s=record.time_s,
            force_n=record.force_n,
            command=row.command,
            status=record.status,
            window_s=row.window_s,
        )
    except FitError as error:
        raise FitError(f"{row.where}: {row.loadcell}: {error} {_BY_HAND}") from None
    except CfidError as error:
        raise type(error)(f"{row.where}: {row.loadcell}: {error}") from None
