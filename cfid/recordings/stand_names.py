"""What thrust stands and typed tables of motors call their columns, as data, and what their files do not say."""

import re
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.recordings.recording import Column
from cfid.units import ROTORS, bracketed, split_unit

Speeds = Literal["motor", "series", "rotors", "mean"]

# By quantity, the names of its columns without units, in lower case; a speed's kind tells of which rotors it is.
NAMES: Mapping[str, Mapping[str, str]] = {
    "command": {"command": "cmd|command|pwm|esc|esc signal|esc throttle|throttle"},
    "thrust": {"one": r"thrust|weight|force fz \(thrust\)", "total": "thrust total|weight total"},
    "torque": {"one": r"torque|torque mz \(torque\)"},
    "speed": {
        "motor": "rpm|speed|omega|(motor|motor optical|motor electrical|rotation|rotational) speed",
        "series": "(rpm|series) [1-9][0-9]*",
        "rotors": "(rpm|rotor ?)[1-4]",
        "mean": "rpm mean|mean speed",
    },
    "voltage": {"one": "vbat|voltage"},
    "grams": {"scales": "grams"},
}
SPEED_NAMES: Mapping[Speeds, str] = {  # by which a run keeps speeds
    "motor": "speed",
    "series": "series",
    "rotors": "rotor",
    "mean": "mean_speed",
}
UNIT_OF_NAME = {"rpm": "rpm", "grams": "g"}  # by a name's first word
KNOWN = (
    "cmd or pwm (0 to 65535), pwm_percent, command_fraction, ESC signal (us); thrust_n, Thrust (gf), weight[g], "
    "thrust_total_g; torque_nm; rpm, speed_rad_s, rpm_1, rpm_2 (series of one rotor), rpm1 to rpm4, rpm_mean; vbat_v; "
    "grams (scales); t_s"
)


class Profile(NamedTuple):
    """A stand whose files do not say everything, known by all of `heads` and one of `thrusts`.

    Its tables are of `motors` motors, and have `rate_hz` rows a second where no column is the time. `columns` are its
    names for what else is read, with the names of that here.
    """

    heads: frozenset[str]
    thrusts: frozenset[str]
    motors: int
    rate_hz: float
    columns: Mapping[str, str]

    def matches(self, heads: Sequence[str]) -> bool:
        """Return whether a table with these heads is of this stand."""
        spelt = {re.sub(r"\s", "", head).lower() for head in heads}
        return spelt >= self.heads and not spelt.isdisjoint(self.thrusts)


BITCRAZE = Profile(
    heads=frozenset({"pwm", "rpm1", "rpm2", "rpm3", "rpm4"}),
    thrusts=frozenset({"weight[g]", "thrust[g]", "thrust[n]"}),
    motors=ROTORS,
    rate_hz=100.0,
    columns={"torque_z[n]": "torque_nm"},
)
_OF_POWERTRAIN = re.compile(r".+ - (?=(esc throttle|force fz|torque mz|rotation speed|voltage)\b)")  # of Flight Stand


class MotorColumn(NamedTuple):
    """A column of a known name: its kind of a quantity, its unit ("" where nothing states one) and its numbers (n,).

    `name` is without the unit, or as an option states it, and `head` the name in the file.
    """

    name: str
    head: str
    kind: str
    unit: str
    values: npt.NDArray[np.float64]


def head_of(column: Column) -> str:
    """Return a column's name in the file."""
    return column.head or column.name


def motor_columns(columns: Sequence[Column], stated: Sequence[str] = ()) -> dict[str, list[MotorColumn]]:
    """Return columns by quantity; those with a `stated` name take the place of others of their quantity."""
    by_quantity: dict[str, list[MotorColumn]] = {}
    own = BITCRAZE.columns if BITCRAZE.matches([head_of(column) for column in columns]) else {}
    for column in columns:
        renamed = own.get(head_of(column).lower())
        name, unit = split_unit(renamed or column.name)
        words = re.sub(r"[\s_]+", " ", _OF_POWERTRAIN.sub("", name.strip().lower()))
        implied = bracketed(head_of(column)) if column.name in stated else ""  # an unknown unit is named as that
        unit = unit if renamed else column.unit or implied or unit or UNIT_OF_NAME.get(re.split(r"[ \d]", words)[0], "")
        for quantity, kinds in NAMES.items():
            for kind, pattern in kinds.items():
                if re.fullmatch(pattern, words):
                    known = MotorColumn(column.name, head_of(column), kind, unit, column.values)
                    by_quantity.setdefault(quantity, []).append(known)
    for quantity, known_columns in by_quantity.items():
        by_quantity[quantity] = [column for column in known_columns if column.name in stated] or known_columns
    return by_quantity
