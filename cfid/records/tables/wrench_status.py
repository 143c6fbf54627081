"""Read the status words of a load cell's samples, and explain those that are not zero."""

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.large import parts
from cfid.records.tables.table import Array, CsvTable
from cfid.wire.rdt_status import Family, read_status

Words = npt.NDArray[np.uint32]


def status_words(table: CsvTable, values: Array) -> Words:
    """Return a column (n,) as status words. Raises DataError naming the first line without one."""
    bad = [(values[part] < 0) | (values[part] >= 2.0**32) | (values[part] % 1 != 0) for part in parts(len(values))]
    wrong = np.flatnonzero(np.concatenate(bad))
    if len(wrong):
        line = table.line_of_row(int(wrong[0]))
        raise DataError(
            f"{table.path}:{line}: status {values[wrong[0]]:.9g} is not a word of 32 bits. Delete that line."
        )
    return values.astype(np.uint32)


def status_notes(table: CsvTable, words: Words, family: Family) -> tuple[str, ...]:
    """Return a note on the samples whose status word is not zero, with the meaning of the word."""
    bad = np.flatnonzero(words)
    if not len(bad):
        return ()
    seen = [read_status(word, family) for word in np.unique(words[bad]).tolist()]
    meant = ", ".join(dict.fromkeys(text for status in seen for text in (*status.faults, *status.warnings)))
    line = table.line_of_row(int(bad[0]))
    return (f"{len(bad)} of {len(words)} samples have a status that is not 0 (first: line {line}): {meant}.",)
