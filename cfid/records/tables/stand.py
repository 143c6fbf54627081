"""Read tables of thrust, torque, speed and voltage over motor command, typed by hand or from thrust stands.

This module only resolves column names and units; settling and the tachometer's markers are left to the fits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np

from cfid.counted import counted
from cfid.findings import Finding, note, of_recording
from cfid.large import stored
from cfid.quantities.registry import range_of
from cfid.records.files import RUN_FILE
from cfid.records.parameters import Source
from cfid.records.run import run_at
from cfid.records.tables.blocks import open_table
from cfid.records.tables.column_units import spelt
from cfid.records.tables.schema import Foreign, TimeUnit, refuse_clock
from cfid.records.tables.stand_columns import Found, columns_of, turned
from cfid.records.tables.stand_commands import commands_of
from cfid.records.tables.stand_faults import without_faults
from cfid.records.tables.stand_heads import heads_of
from cfid.records.tables.stand_names import with_named
from cfid.records.tables.stand_rows import check_one_motor, with_rows
from cfid.records.tables.stand_speeds import mean_of_known, speeds_of
from cfid.records.tables.stand_times import Timing, timing_of
from cfid.records.tables.table import Array, CsvTable
from cfid.records.tables.text import short
from cfid.records.tables.times import line_notes
from cfid.units import ROTORS, USUAL_GRAVITY_MPS2

Speeds = Literal["motor", "series", "rotors", "mean"]

STAND = "stand"

# In the header of Bitcraze's stand, which measures four motors, beside one of its thrusts.
_BITCRAZE = frozenset({"pwm", "rpm1", "rpm2", "rpm3", "rpm4"})
_BITCRAZE_THRUST = frozenset({"weight[g]", "thrust[g]", "thrust[n]"})


@dataclass(frozen=True, kw_only=True)
class StandTable:
    """A table's columns (n,) in SI units, None for absent ones; `columns` has the file's names for each.

    Thrust and torque are one motor's where the file is of `motors` motors; where `motors` is None, they are as in the
    file. `command` is nan where the file has only thrust and speed; any quantity is nan where a field was not a number.
    `speeds_rad_s` (n, s) are as displayed, nan where a sensor was dead: a motor's ("motor"), one rotor's in several
    series ("series"), four rotors' at once ("rotors") or their mean ("mean"). `rotors` is the number of rotors whose
    speed the header names, None for none and for a mean. `grams` is the reading of scales.
    `time_s` is None for settled points and an array for a record over time, whose `rate_hz` is None where a column
    gave the time.
    """

    path: Path
    source: Source
    columns: Mapping[str, tuple[str, ...]]
    command: Array
    thrust_n: Array | None
    motors: int | None
    rotors: int | None
    torque_nm: Array | None
    vbat_v: Array | None
    grams: Array | None
    speeds_rad_s: Array | None
    speeds: Speeds | None
    time_s: Array | None
    rate_hz: float | None
    findings: tuple[Finding, ...]

    @property
    def square_mean_speed_rad_s(self) -> Array | None:
        """The speed (n,) at which every rotor would give the mean of the rotors' thrusts, by k w^2."""
        return None if self.speeds_rad_s is None else mean_of_known(self.speeds_rad_s, power=2)


def read_stand_table(
    path: Path,
    *,
    gravity_mps2: float = USUAL_GRAVITY_MPS2,
    rate_hz: float | None = None,
    skip_lines: int = 0,
    time_unit: TimeUnit | None = None,
    columns: Sequence[str] = (),
    esc_us: tuple[float, float] | None = None,
    motors: int | None = None,
) -> StandTable:
    """Read a table whose header names quantities and units, in any order; other columns are ignored with a note.

    Rows of a pwm that is held for long are a record over time, at `rate_hz` where no column gives the time. `esc_us`
    are the pulse widths of commands 0 and 65535, `columns` states what the header does not, as in `with_named`, and
    which rows are meant, as in `with_rows`. `motors` is how many motors ran: it divides thrust and torque. Without it,
    the table of Bitcraze's stand and a `thrust_total` are of four. Fields that are not numbers are missing, with a
    note.

    Raises DataError with file, line or column, and next step; ConfigError for an invalid rate or range.
    """
    typed = not (path.parent / RUN_FILE).is_file()
    chosen = with_rows(open_table(path, skip_lines=skip_lines, typed=typed), columns)
    opened, named = with_named(chosen.table, chosen.columns)
    table, found, read_notes = columns_of(opened)
    command, command_notes = commands_of(table, found, esc_us)
    timing = timing_of(table, found, command, unit=time_unit, rate_hz=rate_hz)
    used = [*chosen.by, *(name for columns in found.values() for name in columns.names)]
    check_one_motor(table, command, used=used, settled=timing.time_s is None)
    if timing.order is not None:
        command = command[timing.order]
        found = {quantity: columns._replace(raw=columns.raw[timing.order]) for quantity, columns in found.items()}
    fault_notes = () if timing.time_s is None else without_faults(table, found, command, timing.order)
    ran = motors or (ROTORS if _is_of_four(chosen.table, found) else None)
    thrust, thrust_notes = _thrust(found, command, gravity_mps2, motors=ran or 1)
    torque, torque_notes = _torque(found, command, motors=ran or 1)
    speeds, speed_notes = speeds_of(found, command, thrust, settled=timing.time_s is None)
    kind = found["speeds_rad_s"].head.kind if "speeds_rad_s" in found else None
    notes = (
        *chosen.notes,
        *named,
        *command_notes,
        *_motors_note(found, ran, stated=motors is not None),
        *thrust_notes,
        *torque_notes,
        *timing.notes,
        *fault_notes,
        *speed_notes,
        *read_notes,
        *_unused_note(table, used),
        *line_notes(table),
    )
    return StandTable(
        path=path,
        source=Source(str(path), table.sha256),
        columns={quantity: columns.names for quantity, columns in found.items()},
        command=command,
        thrust_n=thrust,
        motors=ran,
        rotors=_rotors(table),
        torque_nm=torque,
        vbat_v=_single(found, "vbat_v"),
        grams=_single(found, "grams"),
        speeds_rad_s=speeds,
        speeds=cast(Speeds | None, kind),
        time_s=timing.time_s,
        rate_hz=timing.rate_hz,
        findings=(
            note("file-read", _understood(table, found, timing, len(command))).at(path.name),
            *of_recording(path.name, notes),
            *(one.at(path.name) for one in _larger_motor(found, thrust)),
        ),
    )


def stand_file(path: Path) -> Path | None:
    """Return the table of a run that was imported from a thrust stand's recording, None for anything else."""
    run = run_at(path)
    return run.device_file(STAND) if run is not None and STAND in run.header.devices else None


def read_stand_as(
    path: Path,
    reading: Foreign,
    *,
    gravity_mps2: float = USUAL_GRAVITY_MPS2,
    esc_us: tuple[float, float] | None = None,
    motors: int | None = None,
) -> StandTable:
    """Read a table with a command's options for other programs' files; see `read_stand_table`."""
    refuse_clock(path, reading)
    return read_stand_table(
        path,
        gravity_mps2=gravity_mps2,
        rate_hz=reading.rate_hz,
        skip_lines=reading.skip_lines,
        time_unit=reading.time_unit,
        columns=reading.columns,
        esc_us=esc_us,
        motors=motors,
    )


def _larger_motor(found: Found, thrust_n: Array | None) -> tuple[Finding, ...]:
    """Return a note on a motor with its own controller whose thrust (n,) is more than a small quadrocopter's."""
    expected = range_of("motor.max_thrust_n", "crazyflie")
    if thrust_n is None or expected is None or "command" not in found or found["command"].head.kind != "esc":
        return ()
    most = float(np.nanmax(thrust_n))
    if most <= expected.largest:
        return ()
    text = (
        f"{most:.3g} N are more than a motor of a small quadrocopter has ({expected.largest:g} N): where no rig.toml "
        "states the vehicle, the numbers are judged by physics alone."
    )
    return (note("motor-of-larger-vehicle", text),)


def _is_of_four(table: CsvTable, found: Found) -> bool:
    """Return whether a file is of four motors: it has the header of Bitcraze's stand, or states a total thrust."""
    names = {spelt(name) for name in table.names}
    thrust = found.get("thrust_n")
    return (names >= _BITCRAZE and not names.isdisjoint(_BITCRAZE_THRUST)) or (
        thrust is not None and thrust.head.kind.startswith("total")
    )


def _motors_note(found: Found, motors: int | None, *, stated: bool) -> tuple[str, ...]:
    """Return a note on what is divided by the number of motors that ran, None for none."""
    names = [f"'{found[quantity].names[0]}'" for quantity in ("thrust_n", "torque_nm") if quantity in found]
    if motors is None or not names:
        return ()
    how = f"divided by {motors}" if motors > 1 else "not divided"
    end = " (`motors`)." if stated else ". Fits take another number by `motors`."
    return (f"{' and '.join(names)}, of {counted(motors, 'motor')}: {how}{end}",)


def _rotors(table: CsvTable) -> int | None:
    """Return the number of rotors whose speeds a header names; several sensors or series are one rotor's."""
    heads = [head for head, _ in heads_of(table.names).get("speeds_rad_s", ())]
    if not heads or heads[0].kind == "mean":
        return None
    return len(heads) if heads[0].kind == "rotors" else 1


def _thrust(found: Found, command: Array, gravity_mps2: float, *, motors: int) -> tuple[Array | None, tuple[str, ...]]:
    """Return thrust (n,) in newtons, of one of `motors` motors, and notes."""
    column = found.get("thrust_n")
    if column is None:
        return None, ()
    grams = column.head.kind.endswith("grams")
    value = column.value[:, 0] * (gravity_mps2 if grams else 1.0) / motors
    notes = [f"'{column.names[0]}' is a weight: grams by {gravity_mps2:g} m/s^2."] if grams else []
    value, is_turned = turned(value, _drive(found, command))
    if is_turned:
        notes.append(f"'{column.names[0]}' falls as the motor is driven harder: its sign is changed.")
    return stored(value), tuple(notes)


def _torque(found: Found, command: Array, *, motors: int) -> tuple[Array | None, tuple[str, ...]]:
    column = found.get("torque_nm")
    if column is None:
        return None, ()
    value, is_turned = turned(column.value[:, 0] / motors, _drive(found, command))
    text = f"'{column.names[0]}' falls as the motor is driven harder: its sign is changed."
    return stored(value), (text,) if is_turned else ()


def _drive(found: Found, command: Array) -> Array:
    """Return what drives a motor: the command (n,), or the speed where there is none."""
    return command if "command" in found else mean_of_known(found["speeds_rad_s"].value)


def _single(found: Found, quantity: str) -> Array | None:
    return found[quantity].value[:, 0] if quantity in found else None


def _understood(table: CsvTable, found: Found, timing: Timing, rows: int) -> str:
    """Return the line that states how the file was read."""
    columns = ", ".join(
        f"{quantity.partition('_')[0]} from '{', '.join(columns.names)}'"
        for quantity, columns in found.items()
        if quantity != "time_s" or (timing.time_s is not None and timing.rate_hz is None)
    )
    kind = f"{counted(rows, 'settled point')}"
    if timing.time_s is not None:
        length_s = float(timing.time_s[-1] - timing.time_s[0])
        kind = f"a recording of {length_s:.4g} s in {rows} rows, {(rows - 1) / length_s:.3g} Hz"
    return f"{kind}: {columns}{table.layout}."


def _unused_note(table: CsvTable, used: Sequence[str]) -> tuple[str, ...]:
    unused = [name for name in table.names if name and name not in used]
    return (f"not used: {short(', '.join(unused), 120)}.",) if unused else ()
