"""Recordings of one command each, as an index names them, to one mean force each."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from cfid.console.facts import assumed
from cfid.console.options import positive
from cfid.drag.wind.files import WindRow
from cfid.drag.wind.frames import AZIMUTH_DEG, MARKERS, YAW_DEG
from cfid.drag.wind.plan import WindSetting
from cfid.errors import CfidError, FitError
from cfid.findings import texts
from cfid.motors.vibration.data import Rotors, VibrationRecord
from cfid.records.facts import NONE_STATED, RigFacts
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
    """How recordings are read and averaged, and which facts of the rig options state; an index has those of `rig`."""

    reading: "WrenchReading"
    method: str
    given: RigFacts = NONE_STATED
    rig: RigFacts = NONE_STATED


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

    record, facts = read_wrench(row.loadcell, how.reading), how.given.over(how.rig)
    name = f"{row.where} {row.loadcell.name}"
    notes = [note.removeprefix(f"{record.path.name}: ") for note in record.notes]
    mean, shown = MeanForce(np.zeros(3), np.zeros(3), (0.0, 0.0)), 0.0
    if row.command > DEAD_COMMAND:
        mean = _averaged(row, record, how)
        notes += [mean.note] if mean.note else []
        if not row.tach_rpm and row.max_mps > 0:
            notes.append(HEARD)
        shown = shown_rpm(row.tach_rpm, record, mean, facts, name=name, windy=row.max_mps > 0)
    run = wind_run(mean, shown, facts, name=name, command=row.command, place=row)
    notes += assumptions(facts, row, typed=bool(row.tach_rpm))
    return Reduced(runs=(run,), notes=tuple(notes), sources=(record.source,))


def shown_rpm(
    typed: float | None, record: "WrenchRecord", mean: "MeanForce", facts: RigFacts, *, name: str, windy: bool
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
    return (facts.tachometer.markers or MARKERS) * heard.speed_rad_per_s / RPM


def _turning(rate_hz: float) -> tuple[float, float] | None:
    """Return how fast rotors may turn, where blade pass of faster ones would fold back; None where it does not."""
    return (_SLOWEST_RAD_S, _USUAL_RAD_S) if rate_hz < _HEARD_ANY_FROM_HZ else None


def assumptions(facts: RigFacts, place: WindRow | WindSetting, *, typed: bool) -> list[str]:
    """Return notes on the facts that a run in wind or a reference needs and nobody stated."""
    windy, notes = place.max_mps > 0, []
    if facts.yaw_in_wind_deg is None:
        notes.append(assumed(f"a yaw of {YAW_DEG:g} degrees on the load cell is", "--yaw-deg"))
    if windy and place.azimuth_deg is None and facts.wind.azimuth_deg is None:
        notes.append(assumed(f"an azimuth of {AZIMUTH_DEG:.2f} degrees is", "--azimuth-deg"))
    if windy and typed and facts.tachometer.markers is None:
        notes.append(assumed(f"{MARKERS} markers of the tachometer are", "--markers"))
    return notes


def wind_run(
    mean: "MeanForce", shown: float, facts: RigFacts, *, name: str, command: int, place: WindRow | WindSetting
) -> "WindRun":
    """Return a mean force with what was set and read, and how vehicle and wind generator stood."""
    from cfid.drag.wind.reduction import WindRun

    azimuth_deg = facts.wind.azimuth_deg if place.azimuth_deg is None else place.azimuth_deg
    yaw_deg = facts.yaw_in_wind_deg
    return WindRun(
        name=name,
        command=command,
        angle_deg=place.angle_deg,
        min_mps=place.min_mps,
        max_mps=place.max_mps,
        shown_rpm=shown,
        force_n=mean.force_n * (1, 1, -1 if facts.loadcell.flip_fz else 1),
        force_std_n=mean.std_n,
        azimuth_deg=AZIMUTH_DEG if azimuth_deg is None else azimuth_deg,
        yaw_deg=YAW_DEG if yaw_deg is None else yaw_deg,
        markers=facts.tachometer.markers or MARKERS,
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
