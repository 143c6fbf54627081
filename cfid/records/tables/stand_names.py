"""Apply the operator's names of columns in a table of motors, where the header shows none or several."""

from collections.abc import Sequence
from dataclasses import replace

from cfid.errors import ConfigError
from cfid.records.tables.stand_heads import HEADS, has_unread_unit, heads_of, in_own_unit
from cfid.records.tables.table import CsvTable


def with_named(table: CsvTable, columns: Sequence[str]) -> tuple[CsvTable, tuple[str, ...]]:
    """Return a table whose columns are named by `columns`, each a NAME=COLUMN, and a note.

    NAME is one that a header may have, and states the unit where the file's header does not; COLUMN is the file's name,
    or the number counted from 1. Other columns of the same quantity lose their names. Raises ConfigError for an unknown
    name and for a header whose unit is not read, DataError for a column that is not there.
    """
    if not columns:
        return table, ()
    called: dict[int, str] = {}
    quantities: set[str] = set()
    for pair in columns:
        name, equals, column = (part.strip() for part in pair.partition("="))
        known = heads_of([name])
        if not (equals and known):
            raise ConfigError(
                f"{table.path}: `columns` {pair}: a table of motors takes NAME=COLUMN, as in thrust_n=3. Known names: "
                f"{HEADS}."
            )
        place = table.place(column)
        own = table.names[place]
        if has_unread_unit(name, own):
            raise ConfigError(
                f"{table.path}: `columns` {pair}: column '{own}' states a unit that is not read. "
                f"Convert it, and call it by a known name: {HEADS}."
            )
        called[place] = in_own_unit(name, own)
        quantities |= known.keys()
    if len(called) < len(columns) or len(set(called.values())) < len(columns):
        raise ConfigError(f"{table.path}: `columns` {','.join(columns)} names a column, or a quantity, twice.")
    kept = ("" if heads_of([name]).keys() & quantities else name for name in table.names)
    names = tuple(called.get(place, name) for place, name in enumerate(kept))
    stated = (f"'{called[place]}' is column {place + 1}, '{table.names[place]}'" for place in sorted(called))
    return replace(table, names=names, has_head=True), (f"{', '.join(stated)} (`columns`).",)
