"""Prepares a device that sends lines: locks its port, and states how it is recorded."""

import errno
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cfid.errors import ConfigError, DeviceError
from cfid.records.rig_file import EncoderLines, LineDevice
from cfid.records.run import DeviceRecord
from cfid.rig.clock import HostClock
from cfid.rig.e201_port import lock_name, why_not_open
from cfid.rig.encoder import Receiver
from cfid.rig.lines import Lines
from cfid.rig.listening import Port, serial_ports
from cfid.rig.lock import DeviceLock
from cfid.rig.loop import Loop
from cfid.rig.recorder import Instrument, Say

OpenLines = Callable[[Loop, HostClock], Instrument]


def ready_lines(
    name: str,
    setting: LineDevice,
    held: ExitStack,
    *,
    say: Say,
    patient: bool = True,
    scale: Mapping[str, object] = MappingProxyType({}),
) -> tuple[DeviceRecord, OpenLines]:
    """Lock a device's port; return its description in run.toml, including `scale`, and how a loop opens it.

    Without `patient` the run ends as soon as its lines break off. Raises DeviceError.
    """
    if not Path(setting.port).exists():
        raise DeviceError(f"{setting.port}: {why_not_open(FileNotFoundError(errno.ENOENT, 'No such file'))}")
    names = [lock_name(setting.port)]
    holding = held.enter_context(ExitStack())
    holding.enter_context(DeviceLock.take(names[0]))

    def locked(port: str) -> None:
        """Lock the port that a link leads to now: a plug that was pulled may come back as another port."""
        if lock_name(port) != names[-1]:
            lock = DeviceLock.take(lock_name(port))
            holding.close()
            holding.enter_context(lock)
            names.append(lock_name(port))

    def opened(loop: Loop, clock: HostClock) -> Instrument:
        listen = serial_ports(loop, baud=setting.baud)

        def locked_port(port: str, receiver: Receiver) -> Port:
            locked(port)
            return listen(port, receiver)

        return Lines(name, setting, listen=locked_port, loop=loop, clock=clock, say=say, patient=patient)

    return record_of(name, setting, scale=scale), opened


def record_of(name: str, setting: LineDevice, *, scale: Mapping[str, object] = MappingProxyType({})) -> DeviceRecord:
    """Return a device's description in run.toml, including `scale`."""
    stated: dict[str, Any] = setting.model_dump(mode="json", exclude={"rate_hz", "kind"}, exclude_defaults=True)
    return DeviceRecord.model_validate(
        {
            "file": f"{name}.csv",
            "columns": setting.columns,
            **scale,
            "asked": "lines",
            "rate_hz": setting.rate_hz,
            "lines": stated,
        }
    )


def angle_scale(setting: EncoderLines, counts_per_turn: float | str) -> dict[str, object]:
    """Return what run.toml states about the angle's unit. Raises ConfigError where the counts per turn are unknown."""
    if not setting.counted:
        return {"angle_unit": "rad"}
    if isinstance(counts_per_turn, str):
        raise ConfigError(
            f"encoder.counts_per_turn: is '{counts_per_turn}', a format of the E201's words: set the counts of a turn "
            f"that {setting.port} sends."
        )
    return {"counts_per_turn": counts_per_turn}
