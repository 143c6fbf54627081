"""Refuse to import a stand's recording of several motors, which a run cannot distinguish."""

from cfid.errors import CfidError, ConfigError
from cfid.records.tables.schema import Foreign
from cfid.records.tables.stand import read_stand_as
from cfid.records.tables.stand_rows import SeveralMotorsError, with_rows
from cfid.records.tables.table import CsvTable

_OWN_FILE = (
    "a run keeps all rows, and not the words that tell them apart. Write the rows of each into a file of its own"
)


def of_one_motor(table: CsvTable, reading: Foreign) -> tuple[str, ...]:
    """Return the settings that name columns. Raises ConfigError for rows of several motors, unless COLUMN=* takes all.

    A recording that a fit would refuse for any other reason is imported all the same.
    """
    chosen = with_rows(table, [one for one in reading.columns if "=" in one])
    if chosen.notes:
        raise ConfigError(f"{table.path}: `columns` {','.join(reading.columns)} chooses rows: {_OWN_FILE}.")
    try:
        read_stand_as(table.path, reading)
    except SeveralMotorsError as question:
        raise ConfigError(f"{question} For an import, {_OWN_FILE}.") from None
    except CfidError:
        pass
    return chosen.columns
