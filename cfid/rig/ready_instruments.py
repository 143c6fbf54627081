"""Prepares hand-held instruments as devices of a run."""

from contextlib import ExitStack

from cfid.records.rig_file import LineDevice
from cfid.records.run import DeviceRecord
from cfid.rig.clock import HostClock
from cfid.rig.device import Device, Open
from cfid.rig.hand_held import HandHeld, Readings, ScalesParser, Ut372Parser
from cfid.rig.listening import find_ut372, serial_ports, ut372_ports
from cfid.rig.loop import Loop
from cfid.rig.progress import Reading
from cfid.rig.ready_lines import ready_lines
from cfid.rig.recorder import Instrument, Say
from cfid.rig.shown import displayed


def ready_tachometer(port: str | None) -> Device:
    """Return a UT372, which is found by its USB numbers where no port is given. Raises DeviceError."""
    where = port or find_ut372()

    def opened(loop: Loop, clock: HostClock) -> Instrument:
        return HandHeld(where, Ut372Parser(), listen=ut372_ports(loop), loop=loop, clock=clock)

    return _device("tachometer.csv", Ut372Parser.columns, opened, shown=displayed("rpm"), port=where)


def ready_instrument(name: str, setting: LineDevice, held: ExitStack, *, say: Say) -> Device:
    """Return a tachometer or scales that send lines. Raises DeviceError."""
    record, opened = ready_lines(name, setting, held, say=say)
    reading = displayed(setting.column_unit(setting.measured[0]))
    return Device(record=record, open=opened, eventful=True, reading=reading)


def ready_scales(port: str, *, baud: int) -> Device:
    """Return scales on a serial port."""

    def opened(loop: Loop, clock: HostClock) -> Instrument:
        return HandHeld(port, ScalesParser(), listen=serial_ports(loop, baud=baud), loop=loop, clock=clock)

    return _device("scales.csv", ScalesParser.columns, opened, shown=displayed("g"), port=port, baud=baud)


def typed_readings(value: str) -> Device:
    """Return readings that the operator types, in a column named `value`."""

    def opened(loop: Loop, clock: HostClock) -> Instrument:
        return Readings("readings", value, loop=loop, clock=clock)

    return _device("readings.csv", ("t", "command", value, "withdrawn"), opened, typed=True)


def _device(
    file: str, columns: tuple[str, ...], opened: Open, *, shown: Reading | None = None, **more: object
) -> Device:
    record = DeviceRecord.model_validate({"file": file, "columns": columns, **more})
    return Device(record=record, open=opened, eventful=True, reading=shown)
