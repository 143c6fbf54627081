"""Read a recording of any kind as a log; its content, not its name, shows the kind."""

from collections.abc import Callable
from pathlib import Path

from cfid.errors import ConfigError, DataError
from cfid.records.files import check_regular, sha256_of
from cfid.records.logs.blackbox import BEGIN as BLACKBOX
from cfid.records.logs.blackbox import read_blackbox
from cfid.records.logs.converted import read_converted
from cfid.records.logs.log import FlightLog
from cfid.records.logs.spin import with_kept_texts
from cfid.records.logs.table import read_table_log
from cfid.records.logs.ulog import BEGIN as ULOG
from cfid.records.logs.ulog import read_ulog
from cfid.records.logs.usd import MAGIC, read_usd
from cfid.records.parameters import Source
from cfid.records.tables.matlab import converted_series, is_matlab
from cfid.records.tables.schema import Foreign, refuse_clock

_BINARY: tuple[tuple[bytes, Callable[[Path, Source], FlightLog]], ...] = (
    (bytes([MAGIC]), read_usd),
    (ULOG, read_ulog),
    (BLACKBOX, read_blackbox),
)
NO_OPTIONS = Foreign()


def is_binary_log(path: Path) -> bool:
    """Return whether a file is a vehicle's binary log, not a table: uSD card, ULog or blackbox."""
    return _binary_reader(path) is not None


def read_log(path: Path, reading: Foreign = NO_OPTIONS) -> FlightLog:
    """Read a log; `reading` states what a table does not: time unit or rate, lines to skip, the time column, a clock.

    Raises DataError or ConfigError as the reader of its kind.
    """
    try:
        check_regular(path)
    except (FileNotFoundError, ValueError):  # a name with a zero byte
        raise DataError(f"{path}: no such file.") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}.") from None
    if path.is_dir():
        raise DataError(f"{path}: a folder, not a file.")
    source = Source(str(path), sha256_of(path))
    reader = _binary_reader(path)
    stated = next((key for key in ("time_unit", "rate_hz", "skip_lines", "columns") if getattr(reading, key)), None)
    if reader is not None and stated is not None:
        raise ConfigError(f"{path}: `{stated}` is for tables; this log states its own times and columns.")
    if reader is read_usd:
        return read_usd(path, source, reading.clock)
    if reader is not None:
        refuse_clock(path, reading)
        return reader(path, source)
    converted = read_converted(path, source) if stated is None and reading.clock is None else None
    if converted is not None:
        return converted
    log = read_table_log(path, source, reading)
    return with_kept_texts(log, converted_series(path)[1]) if is_matlab(path) else log


def _binary_reader(path: Path) -> Callable[[Path, Source], FlightLog] | None:
    try:
        check_regular(path)
        with path.open("rb") as file:
            begin = file.read(32)
    except OSError:
        return None
    return next((reader for sign, reader in _BINARY if begin.startswith(sign)), None)
