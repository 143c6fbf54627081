"""Finds and locks the encoder and the load cell, and states how they are recorded."""

from contextlib import ExitStack
from typing import Any

from cfid.errors import ConfigError
from cfid.records.rig_file import EncoderLines, EncoderPort, LoadCellBox, LoadCellLines
from cfid.records.run import DeviceRecord
from cfid.rig import box as loadcell_box
from cfid.rig.clock import HostClock
from cfid.rig.device import Device
from cfid.rig.e201_port import find_encoder, lock_name
from cfid.rig.encoder import Encoder
from cfid.rig.loadcell import LoadCell
from cfid.rig.lock import DeviceLock
from cfid.rig.loop import Loop
from cfid.rig.rdt_port import Inbox, RdtPort
from cfid.rig.ready_lines import angle_scale, ready_lines
from cfid.rig.recorder import Instrument, Say
from cfid.rig.serial_line import serial_lines
from cfid.rig.shown import degrees, first_force, vertical_force


def ready_encoder(
    setting: EncoderPort | EncoderLines, held: ExitStack, *, counts_per_turn: float | str, continuous: bool, say: Say
) -> Device:
    """Find and lock the encoder; return how it is recorded. Raises ConfigError or DeviceError."""
    if isinstance(setting, EncoderLines):
        scale = angle_scale(setting, counts_per_turn)
        record, opened_lines = ready_lines("encoder", setting, held, say=say, scale=scale)
        return Device(record=record, open=opened_lines, reading=degrees(setting.turn(counts_per_turn)))
    found = find_encoder(setting.port, counts_per_turn=counts_per_turn)
    names = [lock_name(found.port)]
    holding = held.enter_context(ExitStack())
    holding.enter_context(DeviceLock.take(names[0]))

    def again() -> Any:
        """Find the encoder after its plug was pulled; if it then has another port, lock that port instead."""
        there = find_encoder(setting.port, counts_per_turn=counts_per_turn, serial_number=found.serial_number)
        name = lock_name(there.port)
        if name != names[-1]:
            lock = DeviceLock.take(name)
            holding.close()
            holding.enter_context(lock)
            names.append(name)
        return there

    def opened(loop: Loop, clock: HostClock) -> Instrument:
        return Encoder(
            found,
            open_line=serial_lines(loop),
            find=again,
            counts_per_turn=counts_per_turn,
            rate_hz=setting.rate_hz,
            continuous=continuous,
            loop=loop,
            clock=clock,
            say=say,
        )

    record = DeviceRecord.model_validate(
        {
            "file": "encoder.csv",
            "columns": ("t", "phi", "device_us") if found.stamped and not continuous else ("t", "phi"),
            "counts_per_turn": counts_per_turn,
            "asked": "continuous" if continuous else "polled",
            "rate_hz": setting.rate_hz,
            "interface": found._asdict(),
        }
    )
    return Device(record=record, open=opened, reading=degrees(counts_per_turn))


def ready_loadcell(
    setting: LoadCellBox | LoadCellLines,
    held: ExitStack,
    *,
    buffered: bool,
    bias: bool,
    say: Say,
    patient: bool = True,
) -> Device:
    """Lock the load cell, set its rate and read its settings; return how it is recorded.

    Without `patient` the run ends as soon as its stream breaks off. Raises ConfigError or DeviceError.
    """
    if isinstance(setting, LoadCellLines):
        if bias:
            raise ConfigError("`bias`: only a Net F/T box has a bias; fits take the zero from pauses.")
        record, opened_lines = ready_lines("loadcell", setting, held, say=say, patient=patient, scale={"units": "n,nm"})
        return Device(record=record, open=opened_lines, reading=first_force(setting.measured[0].name))
    setting = loadcell_box.resolved(setting)
    where = f"{setting.address}:{setting.rdt_port}"
    held.enter_context(DeviceLock.take(where))
    if bias and not loadcell_box.take_bias(setting):
        say(f"{where}: the box' page still shows the earlier bias. Check that the load reads zero now.")
    settings = loadcell_box.set_rate(setting, buffered=buffered)

    def opened(loop: Loop, clock: HostClock) -> Instrument:
        inbox = Inbox((setting.address, setting.rdt_port))
        port = RdtPort(inbox, box=(setting.address, setting.rdt_port), reactor=loop)
        port.startListening()
        return LoadCell(
            settings,
            inbox,
            port,
            where=where,
            loop=loop,
            clock=clock,
            say=say,
            buffered=buffered,
            patient=patient,
        )

    record = DeviceRecord.model_validate(
        {
            "file": "loadcell.csv",
            "columns": LoadCell.columns,
            "counts_per_n": settings.counts_per_n,
            "counts_per_nm": settings.counts_per_nm,
            "asked": "buffered" if buffered else "real-time",
            "rate_hz": settings.rate_hz,
            "biased": bias,
            "address": where,
            "settings": settings._asdict(),
        }
    )
    return Device(record=record, open=opened, reading=vertical_force(settings.counts_per_n))
