"""parameters.toml: a campaign's values for people, one line a quantity, written from its fits; no command reads it.

The last line is a checksum of the others, so that a file that was cut or edited is noticed when it is written anew.
"""

import hashlib
import math
from typing import Any

import tomlkit
from tomlkit.items import InlineTable, Table

from cfid.quantities.registry import find, is_of_the_run, unit_of
from cfid.quantities.rounding import value_and_std
from cfid.quantities.values import is_rows, units_of
from cfid.records.covariances import numbers_of, shaped_as
from cfid.records.files import RIG_FILE
from cfid.records.fits import BY_HAND, Fit
from cfid.records.parameters import plain, runs_of
from cfid.records.rig_file import Rig
from cfid.records.values import Quantity, Values

FORMAT = 3  # formats 1 and 2 held the numbers themselves
_SEAL = "# checksum: "
_SERIES = "tf.series."


def text_of(values: Values, *, name: str, version: str) -> str:
    """Return the file for the campaign `name`."""
    document = tomlkit.document()
    title = f"{values.rig.vehicle.name}, campaign {name}, cfid {version}."
    shown = "".join(letter if letter.isprintable() else "?" for letter in title)  # a newline would end the comment
    document.add(tomlkit.comment(f"{shown} Written from fits/,"))
    document.add(tomlkit.comment("where covariances, causes and sources are: an edit here changes no number."))
    document["format"] = FORMAT
    document["rig"] = _rig_table(values.rig)
    for fit, quantities in values.by_fit.items():
        rows = {quantity.key: _row(quantity) for quantity in quantities if _is_shown(quantity, values)}
        if rows and values.label(fit) not in document:
            table = tomlkit.table()
            table.comment(_origin(fit))
            document[values.label(fit)] = table
        for key, row in rows.items():
            document[values.label(fit)][key] = row
    text = tomlkit.dumps(document).encode("utf-8", "replace").decode()
    return f"{text}{_seal_of(text)}"


def is_as_written(text: str) -> bool:
    """Return whether a file was neither cut nor edited since it was written."""
    content, seal, _ = text.rpartition(_SEAL)
    return bool(seal) and text == f"{content}{_seal_of(content)}"


def _seal_of(content: str) -> str:
    return f"{_SEAL}{hashlib.sha256(content.encode()).hexdigest()[:16]}\n"


def _rig_table(rig: Rig) -> Table:
    table = tomlkit.table()
    table.comment(f"as {RIG_FILE} states")
    stated = (
        ("mass_kg", rig.vehicle.mass_kg, rig.vehicle.mass_std_kg),
        ("gravity_mps2", rig.site.gravity_mps2, rig.site.gravity_std_mps2),
    )
    for key, value, std in stated:
        table[key] = _line(value, std or None, unit_of(key), RIG_FILE)
    return table


def _origin(fit: Fit) -> str:
    section, runs = fit.section, runs_of(fit.section.sources)
    method = "" if section.method in ("default", "") else f", method {section.method}"
    count = f", {len(runs)} run{'' if len(runs) == 1 else 's'}" if runs else ""
    marks = ", SIMULATED" * section.simulated + ", REJECTED" * (not section.accepted)
    return f"cfid {fit.command}{method}, {section.found:%Y-%m-%d %H:%M} UTC{count}{marks}"


def _is_shown(quantity: Quantity, values: Values) -> bool:
    """Return whether a quantity has a line: no table, nothing of a single recording, no series if there is just one."""
    key = quantity.key
    if quantity.fit.name == BY_HAND:
        return True
    series = {each.partition(_SERIES)[2].partition(".")[0] for each in quantity.section.parameters if _SERIES in each}
    is_single = key.startswith(_SERIES) and len(series) < 2
    row = find(key)
    is_table = is_rows(plain(quantity.parameter.value)) or (row is not None and row.unit == "as named")
    return not (is_table or is_single or is_of_the_run(key))


def _row(quantity: Quantity) -> InlineTable:
    parameter = quantity.parameter
    value = plain(parameter.value)
    units = dict.fromkeys(units_of(quantity.key, parameter.unit, len(numbers_of("", value))))
    row = _line(value, plain(parameter.std), ", ".join(units), quantity.fit.stem)
    if quantity.rejection:
        row["rejected"] = quantity.rejection
    if quantity.outdated:
        row["outdated"] = " ".join(quantity.outdated)
    return row


def _line(value: Any, std: Any, unit: str, origin: str) -> InlineTable:
    numbers: list[Any] = numbers_of("", value)
    stds: list[Any] = numbers_of("", std)
    if len(stds) != len(numbers):
        stds = [None] * len(numbers)
    row = tomlkit.inline_table()
    row["value"] = shaped_as("", [_rounded(*pair) for pair in zip(numbers, stds, strict=True)], value)
    if std is not None:
        row["std"] = shaped_as("", [_rounded(number, number) for number in stds], value)
    if unit:
        row["unit"] = unit
    row["from"] = origin
    return row


def _rounded(value: Any, std: Any) -> Any:
    """Return a number without the digits below the second one of its standard uncertainty, nan for an unknown one."""
    if not isinstance(value, float):
        return math.nan if value is None else value
    return float(value_and_std(value, std)[0])
