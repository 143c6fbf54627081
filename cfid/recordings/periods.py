"""Read timed periods of a swing: those of a stopwatch, or of a light gate."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cfid.errors import DataError
from cfid.recordings.angle import AngleSource, AxisRecord, CountsPerTurn, angle_of, recording_at
from cfid.recordings.recording import Array, Column, How, Recording, Series
from cfid.units import split_unit

PERIODS = "periods"  # the device of a run

_OPTIONS = ("columns", "units", "skip_lines", "decimal", "rows")


@dataclass(frozen=True, kw_only=True)
class PeriodRecord(AxisRecord):
    """Durations (n,) of a number of periods (n,), with their standard uncertainties and amplitudes where stated.

    Amplitudes are those half-way through the periods; `amplitude_std_rad` is the standard uncertainty of each.
    """

    periods: Array
    duration_s: Array
    std_s: Array | None = None
    amplitude_rad: Array | None = None
    amplitude_std_rad: Array | None = None

    @property
    def columns(self) -> Mapping[str, Array]:
        """The columns of the device in a run, by name; `t` are the times at which each duration would begin."""
        optional = {
            "std_s": self.std_s,
            "amplitude_rad": self.amplitude_rad,
            "amplitude_std_rad": self.amplitude_std_rad,
        }
        return {
            "t": np.cumsum(self.duration_s) - self.duration_s,
            "periods": self.periods,
            "duration_s": self.duration_s,
            **{name: values for name, values in optional.items() if values is not None},
        }


def axis_record(recording: AngleSource, *, rig_counts_per_turn: CountsPerTurn | None = None) -> AxisRecord:
    """Return a record as it is, else read the angle or the periods of a run or a file.

    Raises as `read_recording`, `angle_of` and `periods_of`.
    """
    if isinstance(recording, AxisRecord):
        return recording
    recording = recording_at(recording)
    if _holds_periods(recording):
        return periods_of(recording)
    return angle_of(recording, rig_counts_per_turn=rig_counts_per_turn)


def _holds_periods(recording: Recording) -> bool:
    if recording.run is not None:
        return PERIODS in recording.series
    return any(_column(series, "period") or _column(series, "periods") for series in recording.series.values())


def periods_of(recording: Recording, how: How | None = None) -> PeriodRecord:
    """Return the periods of a table with `period_s`, or with `periods` and the `duration_s` that they took.

    Optional columns are `std_s`, the standard uncertainty of each duration, `amplitude_deg`, that half-way through the
    periods, and `amplitude_std_deg`. Raises DataError for a table without them, or with numbers that cannot be,
    ConfigError for a column without a unit.
    """
    if recording.run is None:
        (how or How()).refuse_unused(recording.path, *_OPTIONS)
    series = next((one for one in recording.series.values() if _column(one, "periods") or _column(one, "period")), None)
    if series is None:
        listing = ", ".join(name for one in recording.series.values() for name in one.names)
        raise DataError(
            f"{recording.path}: no periods among {listing}: name the columns period_s, or periods and duration_s.",
            code="no-column",
        )
    single, counted = _column(series, "period"), _column(series, "periods")
    duration = _column(series, "duration") if single is None else single
    if duration is None:
        raise DataError(f"{series.path}: no column duration_s, in which the periods passed.", code="no-column")
    optional = [_column(series, name) for name in ("std", "amplitude", "amplitude_std")]
    series = series.complete([one.name for one in (counted, duration, *optional) if one is not None])
    duration_s = series.si(duration.name, "s")
    numbers = np.ones(series.rows) if single is not None or counted is None else series.column(counted.name).values
    std, amplitude, amplitude_std = (
        None if one is None else series.si(one.name, unit)
        for one, unit in zip(optional, ("s", "rad", "rad"), strict=True)
    )
    for name, values in (("duration", duration_s), ("periods", numbers), ("std", std)):
        if values is not None and not np.all(values > 0):
            row = int(np.argmin(values))
            raise DataError(f"{series.line(row)}: {name} {values[row]:g}: has to be above zero.", code="not-positive")
    if amplitude is not None and not np.all((amplitude >= 0) & (amplitude < np.pi)):
        row = int(np.argmax(np.abs(amplitude)))
        raise DataError(f"{series.line(row)}: no amplitude of a swing: is it in degrees?", code="other-unit")
    return PeriodRecord(
        path=series.path,
        source=series.source or recording.source,
        label=recording.facts.label,
        periods=numbers,
        duration_s=duration_s,
        std_s=std,
        amplitude_rad=amplitude,
        amplitude_std_rad=amplitude_std,
        findings=(*recording.findings, *series.findings),
        run=None if recording.run is None else recording.name,
    )


def _column(series: Series, name: str) -> Column | None:
    """Return a column by its name without the unit, which the columns of a run keep in theirs."""
    return next((one for one in series.columns if name in (one.name, split_unit(one.name)[0])), None)
