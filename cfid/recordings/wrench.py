"""Read forces and torques over time, in N and N m, from a run folder or a table of any program.

Each column states its unit, in its name or by an option: a unit of force or torque, or counts. A run, and the lines
that ATI's demo program writes above its table, state how many counts a unit is.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from cfid.errors import ConfigError, DataError
from cfid.findings import Finding, finding, of_recording, texts
from cfid.large import chosen_rows, empty
from cfid.recordings.outliers import Mask, outliers, stuck
from cfid.recordings.recording import COUNTS, FEWEST_ROWS, OF_TABLES, Array, How, Recording, Series
from cfid.recordings.stamps import by_stamps
from cfid.recordings.table import Table
from cfid.records.files import RUN_FILE
from cfid.records.parameters import Source
from cfid.records.run import Facts, Label, facts_of, gaps
from cfid.units import factor
from cfid.wire.rdt_status import Family, family_of, read_status

Words = npt.NDArray[np.uint32]

LOADCELL = "loadcell"
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
USUAL_COUNTS = 1e6  # per N and per N m: the thesis' box, and the manufacturer's default

_IN_UNKNOWN_UNIT = re.compile(rf"(?:{'|'.join(AXES)})\s*[\[(].*", re.IGNORECASE)
_STATUS = "status"
_THESIS: Family = "netft"  # of a file that does not state its box
_SI, _SCALES = {"F": "N", "T": "N m"}, {"F": "counts_per_n", "T": "counts_per_nm"}
_LARGEST_COUNT, _LARGEST_N = 2.0**31, 1e5  # a word of 32 bits, and more than 40 kN, where the largest load cells end
# What ATI's demo program writes above its columns.
_PREAMBLE = ("RDT Sample Rate", "Force Units", "Counts per Unit Force", "Torque Units", "Counts per Unit Torque")
_Scale = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]


@dataclass(frozen=True, kw_only=True)
class WrenchRecord:
    """Forces (n, 3) and torques (n, 3) at times (n,) from the first sample on; times may repeat.

    `status` (n,) are the box's status words, None where the file has none; `lost` is the number of missing samples,
    None where unknown. `begin_s` is the first sample's time by the file's own clock, None where it has none. A device
    with fewer `axes` has nan in the others.
    """

    path: Path
    source: Source
    label: Label
    time_s: Array
    force_n: Array
    torque_nm: Array
    status: Words | None
    findings: tuple[Finding, ...]
    lost: int | None = None
    run: str | None = None
    begin_s: float | None = None
    axes: tuple[str, ...] = AXES

    @property
    def name(self) -> str:
        """The run's name, or the file's."""
        return self.run or self.path.stem

    @property
    def main_axis(self) -> str:
        """Fz, or the first axis of a load cell without it."""
        return "Fz" if "Fz" in self.axes else self.axes[0]

    @property
    def notes(self) -> tuple[str, ...]:
        """What the record's reader noted, in sentences that name the run or the file."""
        return texts(self.findings, "note", "warning")

    def values_of(self, axis: str) -> Array:
        """Return the values (n,) of an axis, in N or N m."""
        place = AXES.index(axis)
        return self.force_n[:, place] if place < 3 else self.torque_nm[:, place - 3]

    def require(self, *axes: str, purpose: str) -> None:
        """Raise DataError where an axis that a purpose needs was not measured."""
        missing = [axis for axis in axes if axis not in self.axes]
        if missing:
            raise DataError(
                f"{self.name}: the load cell measured {', '.join(self.axes)} alone, and {purpose} needs "
                f"{', '.join(missing)}.",
                code="axis-not-measured",
            )

    def kept(self, rows: Mask, *findings: Finding) -> "WrenchRecord":
        """Return the record with some of its samples, by a mask (n,), and with further findings about it."""
        return replace(
            self,
            time_s=chosen_rows(self.time_s, rows),
            force_n=chosen_rows(self.force_n, rows),
            torque_nm=chosen_rows(self.torque_nm, rows),
            status=None if self.status is None else self.status[rows],
            findings=(*self.findings, *(one.at(self.name) for one in findings)),
        )

    def without_outliers(self) -> "WrenchRecord":
        """Return the record without the samples that, in an axis, lie off the others' course, or far beyond them."""
        off = np.any([outliers(self.values_of(axis)) for axis in self.axes], axis=0)
        return self.kept(~off, self._finding("force-outliers", off)) if off.any() else self

    def with_stuck_named(self) -> "WrenchRecord":
        """Return the record with a finding on samples that repeat one value in every axis, which stay.

        Without them a sine would have a gap.
        """
        hung = np.all([stuck(self.values_of(axis), self.time_s) for axis in self.axes], axis=0)
        return self.kept(np.ones_like(hung), self._finding("force-hung", hung)) if hung.any() else self

    def without_stuck(self) -> "WrenchRecord":
        """Return the record without the samples at which an axis repeats one value for long."""
        masks = {axis: stuck(self.values_of(axis), self.time_s) for axis in self.axes}
        findings = [self._finding("force-stuck", mask, axis=axis) for axis, mask in masks.items() if mask.any()]
        return self.kept(~np.any(list(masks.values()), axis=0), *findings) if findings else self

    def _finding(self, code: str, mask: Mask, **values: Any) -> Finding:
        first_s = float(self.time_s[int(np.argmax(mask))])
        return finding(code, count=int(np.count_nonzero(mask)), rows=len(mask), first_s=first_s, **values)


class _RunFacts(Facts):
    """The further keys in run.toml of a load cell."""

    counts_per_n: _Scale | None = None
    counts_per_nm: _Scale | None = None
    units: Literal["counts", "n,nm"] = "counts"  # forces that were imported are in N and N m
    settings: Mapping[str, Any] = Field(default_factory=dict)


def wrench_of(recording: Recording, how: How | None = None, *, gain: tuple[float, ...] | None = None) -> WrenchRecord:
    """Return the forces and torques of a recording: those of a run's load cell, or of a table's columns Fx to Tz.

    `gain` (6,) has the ratios of reading to load, from a calibration; a run has its own. Raises DataError with file,
    line and next step, and ConfigError for what is missing or contradicts the recording.
    """
    run, how = recording.run, how or How()
    if run is None:
        series, about, place, family = _series_with_axes(recording), recording.findings, recording.path.name, _THESIS
        names = {axis: name for axis in AXES if (name := _name_of(series, axis)) is not None}
        scales = {"F": how.counts_per_n, "T": how.counts_per_nm}
        per_unit, counted = _per_unit(series, names, scales)
        how.refuse_unused(series.path, *OF_TABLES, *(("counts_per_n", "counts_per_nm") if counted else ()))
        if counted and None in [scales[axis[0]] for axis in names]:
            about = (*about, finding("force-scale-assumed", counts=USUAL_COUNTS).at(place))
    else:
        how.refuse_unused(recording.path)
        file, device = run.device_file(LOADCELL), run.header.devices[LOADCELL]
        if LOADCELL not in recording.series:
            raise DataError(f"{file}: has no rows.", code="no-rows")
        series, facts = recording.series[LOADCELL], facts_of(run, LOADCELL, _RunFacts)
        names = {axis: series.column(axis).name for axis in AXES if axis in device.columns}
        if not names:
            raise DataError(f"{file}: none of its columns is {', '.join(AXES)}.", code="no-column")
        scales = {"F": facts.counts_per_n, "T": facts.counts_per_nm}
        per_unit, counted = _per_unit(series, names, scales)
        missing = [_SCALES[axis[0]] for axis in names if counted and scales[axis[0]] is None]
        if missing:
            raise DataError(f"{run.folder / RUN_FILE}: devices.{LOADCELL}.{missing[0]} is missing: write it there.")
        gain = run.header.rig.loadcell.gain
        about = of_recording(recording.name, gaps(facts))
        place, family = f"{recording.name}/{file.name}", family_of(str(facts.settings.get("product")))
    if series.time_s is None:
        raise ConfigError(
            f"{series.path}: no column of time: name it, as in `columns` t=1, or give `rate_hz`.", code="no-time"
        )
    status = _name_of(series, _STATUS)
    series = series.complete([*names.values(), *([] if status is None else [status])])
    _refuse_impossible(series, names, per_unit, counted=counted)
    if run is not None:
        series, _ = by_stamps(series)
    if series.rows < FEWEST_ROWS:
        raise DataError(f"{series.path}: {series.rows} rows; a recording has at least {FEWEST_ROWS}.", code="few-rows")
    words = None if status is None else _words(series, status)
    values = empty(series.rows, len(AXES))
    values[:] = np.nan
    for at, axis in enumerate(AXES):
        if axis in names:
            divisor = per_unit[axis] * (1.0 if gain is None else gain[at])
            np.divide(series.column(names[axis]).values, divisor, out=values[:, at])
    time_s = np.zeros(0) if series.time_s is None else series.time_s
    findings = (*series.findings, *(() if words is None else _explained(series, words, family)))
    return WrenchRecord(
        path=series.path,
        source=series.source or recording.source,
        label=recording.facts.label,
        time_s=time_s - time_s[0] if time_s[0] else time_s,
        force_n=values[:, :3],
        torque_nm=values[:, 3:],
        status=words,
        findings=(*about, *(one if one.where else one.at(place) for one in findings)),
        lost=None if run is None else run.header.devices[LOADCELL].lost,
        run=None if run is None else recording.name,
        begin_s=None if series.begin_s is None else series.begin_s + float(time_s[0]),
        axes=tuple(names),
    )


def described_above(table: Table, how: How) -> tuple[Table, How]:
    """Return a table, and how it is read, with what ATI's demo program writes above its columns: units, scale and rate.

    Options replace what is stated there. Raises ConfigError for a unit or a number there that is not known.
    """
    lines = (line.strip(' "\r').partition(":") for line in table.layout.above.splitlines())
    stated = {key: value.strip(' "') for key, _, value in lines if key in _PREAMBLE}
    if not {"Counts per Unit Force", "Counts per Unit Torque"} <= stated.keys():
        return table, how
    columns = list(table.columns)
    for word, si, option in (("Force", "N", "counts_per_n"), ("Torque", "N m", "counts_per_nm")):
        given, unit = getattr(how, option), stated.get(f"{word} Units", "")
        if given is None and factor(unit, si) is None:
            raise ConfigError(f"{table.path}: its {word} Units, '{unit[:40]}', are not known: give `{option}`.")
        per_unit = 1.0 if given is not None else _number(table, stated, f"Counts per Unit {word}", option)
        for at, column in enumerate(columns):
            if column.name in AXES and column.name[0] == word[0] and not column.unit:
                columns[at] = replace(column, unit="counts" if given else unit, values=column.values / per_unit)
    is_timed = any(word.startswith("t=") for word in how.columns)
    if how.rate_hz is None and not is_timed and _PREAMBLE[0] in stated:
        how = replace(how, rate_hz=_number(table, stated, _PREAMBLE[0], "rate_hz"))
    described = finding("forces-described", lines=", ".join(f"{key} {value}" for key, value in stated.items()))
    findings = (*table.findings, described.at(table.path.name))
    return replace(table, columns=tuple(columns), findings=findings), how


def _number(table: Table, stated: Mapping[str, str], key: str, option: str) -> float:
    text = stated[key]
    if not (table.layout.is_number(text) and 0 < float(text) < np.inf):
        raise ConfigError(f"{table.path}: its {key}, '{text[:40]}', is no number above zero: give `{option}`.")
    return float(text)


def _series_with_axes(recording: Recording) -> Series:
    """Return the series with most axes. Raises DataError where none has any."""
    series = max(recording.series.values(), key=lambda one: sum(_name_of(one, axis) is not None for axis in AXES))
    unknown = [column.name for column in series.columns if _IN_UNKNOWN_UNIT.fullmatch(column.name)]
    if unknown:
        raise ConfigError(
            f"{series.path}: the unit of column '{unknown[0]}' is not known: name the column and its unit, as in "
            f"`columns` {unknown[0][:2]}='{unknown[0]}' and `unit` {unknown[0][:2]}=N.",
            code="other-unit",
        )
    if all(_name_of(series, axis) is None for axis in AXES):
        listing = ", ".join(column.head or column.name for column in series.columns)
        raise DataError(
            f"{series.path}: no column {', '.join(AXES)} with a known unit among {listing}: name them, as in `columns` "
            "Fz=3, or write them so into the header, as in Fz (N).",
            code="no-column",
        )
    return series


def _name_of(series: Series, called: str) -> str | None:
    """Return the name of an axis's column, in any case, None without one. Raises DataError for several."""
    columns = [column for column in series.columns if column.name.lower() == called.lower()]
    if len(columns) > 1:
        heads = ", ".join(column.head or column.name for column in columns)
        raise DataError(
            f"{series.path}: {heads} are all {called}: name one, by `columns` {called}=...", code="no-column"
        )
    return columns[0].name if columns else None


def _per_unit(
    series: Series, names: Mapping[str, str], scales: Mapping[str, float | None]
) -> tuple[dict[str, float], bool]:
    """Return how many of its unit each axis' N or N m is, and whether these are counts, of `scales` by kind of axis.

    The unit of an axis is also that of the others of its kind that state none. Raises ConfigError where none states
    one, DataError for counts beside other units, and for units of another kind.
    """
    columns = {axis: series.column(name) for axis, name in names.items()}
    counted = {column.unit.lower() in COUNTS for column in columns.values() if column.unit}
    if len(counted) > 1:
        raise DataError(f"{series.path}: some axes are in counts and some not: correct the header.", code="mixed-units")
    if counted == {True}:
        for kind, value in scales.items():
            if value is not None and not 0 < value < np.inf:
                raise ConfigError(f"`{_SCALES[kind]}` {value:g}: has to be above zero.")
        return {axis: scales[axis[0]] or USUAL_COUNTS for axis in names}, True
    per_unit = {}
    for axis, column in columns.items():
        name, si = column.name, _SI[axis[0]]
        unit = column.unit or next((one.unit for other, one in columns.items() if other[0] == axis[0] and one.unit), "")
        if not unit:
            short = si.replace(" ", "")
            raise ConfigError(
                f"{series.path}: column '{column.head or name}' names no unit: give `unit` {name}={short} or "
                f"{name}=counts, or write it into its name, as in {name}_{short.lower()}.",
                code="no-unit",
            )
        scale = factor(unit, si)
        if scale is None:
            raise DataError(
                f"{series.path}: column '{column.head or name}' is in '{unit}', which is no unit of "
                f"{'force' if axis[0] == 'F' else 'torque'}. Where the name is wrong, give `unit` {name}=...",
                code="other-unit",
            )
        per_unit[axis] = 1.0 / scale
    return per_unit, False


def _refuse_impossible(
    series: Series, names: Mapping[str, str], per_unit: Mapping[str, float], *, counted: bool
) -> None:
    """Raise DataError that names the first row of an axis with a value that no load cell measures."""
    for axis, name in names.items():
        values = series.column(name).values
        largest = _LARGEST_COUNT if counted else _LARGEST_N * per_unit[axis]
        wrong = ~(np.abs(values) <= largest) | (counted & (values != np.rint(values)))
        if wrong.any():
            row = int(np.argmax(wrong))
            what = (
                f"no count, which is a whole number of 32 bits: give `unit` {name}=N, or the unit that it has"
                if counted
                else f"more than any load cell measures: are these counts? Then give `unit` {name}=counts"
            )
            raise DataError(
                f"{series.line(row)}: {values[row]:.9g} in column '{name}' is {what}.", code="impossible-force"
            )


def _words(series: Series, name: str) -> Words:
    """Return a column as status words (n,). Raises DataError naming the first line without one."""
    values = series.column(name).values
    wrong = (values < 0) | (values >= 2.0**32) | (values % 1 != 0)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(
            f"{series.line(row)}: status {values[row]:.9g} is not a word of 32 bits. Delete that line.",
            code="no-status-word",
        )
    return values.astype(np.uint32)


def _explained(series: Series, words: Words, family: Family) -> tuple[Finding, ...]:
    """Return a finding on the samples whose status word is not zero, with the meaning of the words."""
    bad = np.flatnonzero(words)
    if not len(bad):
        return ()
    read = [read_status(word, family) for word in np.unique(words[bad]).tolist()]
    meaning = ", ".join(dict.fromkeys(text for status in read for text in (*status.faults, *status.warnings)))
    line = series.line_number(int(bad[0]))
    return (finding("force-status", count=len(bad), rows=len(words), line=line, meaning=meaning),)


def rotation_about_z(yaw_deg: float) -> Array:
    """Return Rz(+yaw) (3, 3): counterclockwise seen from above."""
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def turn_about_z(vector: Array, *, yaw_deg: float) -> Array:
    """Return vectors (..., 3) of the load cell's frame in the vehicle's, by Rz(+yaw) (C.3.1, prepare_data).

    The thesis mounted the vehicle at +45 degrees for wind (C.3.1), and at -45 degrees for sines, so that motor 1 lay on
    the cell's x axis (C.2.5).
    """
    return np.asarray(vector @ rotation_about_z(yaw_deg).T)
