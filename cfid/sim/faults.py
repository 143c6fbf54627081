"""Defines the faults of the simulated instruments and vehicle, and reads them from a command line."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar, get_args, get_type_hints

from cfid.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class LoadCellFaults:
    """Faults of the box and its network; times are seconds since it was opened, 0 for a count means never.

    Every n-th datagram is dropped, duplicated, swapped with the next, or corrupted (cut short or one bit flipped, in
    turn). `silent`: no UDP. `restart`: the box loses power. `second_client`: another client takes the stream. `slow_s`
    delays HTTP and TCP. `udp_blocked`: a firewall passes requests but no record. `status` is shown from
    `status_after_s` on; 0x41 resets its latch. `refuse_settings`: comm.cgi answers without changing anything, and a
    bias has no effect. `saturate`: Fz is loaded beyond its range.
    """

    drop_every: int = 0
    duplicate_every: int = 0
    reorder_every: int = 0
    corrupt_every: int = 0
    silent_after_s: float | None = None
    silent_for_s: float | None = None
    restart_after_s: float | None = None
    restart_for_s: float = 1.0
    second_client_after_s: float | None = None
    slow_s: float = 0.0
    udp_blocked: bool = False
    status_after_s: float | None = None
    status: int = 0x80010000
    refuse_settings: bool = False
    saturate_after_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class EncoderFaults:
    """Faults of the encoder's interface and its cable; times are seconds since it was opened.

    Every n-th reply is dropped, or corrupted (bytes lost, its end lost, or junk put before it, in turn). `split`:
    replies come in two pieces. `silent`: no replies. `unplug`: the port goes away. `slow_s` delays each reply.
    `wrong_width`: words have this many bits, whatever was set. `not_an_e201`: another device answers.
    """

    drop_every: int = 0
    corrupt_every: int = 0
    split: bool = False
    silent_after_s: float | None = None
    silent_for_s: float | None = None
    unplug_after_s: float | None = None
    unplug_for_s: float = 1.0
    slow_s: float = 0.0
    wrong_width: int | None = None
    not_an_e201: bool = False


@dataclass(frozen=True, kw_only=True)
class CrazyflieFaults:
    """Faults of the vehicle and its link; times are seconds since it was opened.

    Every n-th packet from the vehicle, or to it, is dropped. `silent`: no packet passes either way. `closed`: the port
    is closed, while the vehicle goes on. `busy`: while one client is active, others are ignored. `tumble`: the vehicle
    turns by `tumble_deg`, 180 upside down, 90 on its side. `emergency`: an emergency stop. `low_battery`: the voltage
    falls to 2.9 V. `reboot`: the vehicle loses power for a moment. `protocol`: it speaks this version,
    and `app_protocol`: its app speaks this one; 0 for their own.

    A stop is the app's, or zero written to motorPowerSet.enable. `stop_ignored`: it is acknowledged, and the motors go
    on. `stop_late_s` delays its answer. `stop_misnumbered`: its answer has another number.
    """

    silent_after_s: float | None = None
    silent_for_s: float | None = None
    closed_after_s: float | None = None
    drop_every: int = 0
    drop_to_vehicle_every: int = 0
    tumble_after_s: float | None = None
    tumble_for_s: float | None = None
    tumble_deg: float = 180.0
    emergency_after_s: float | None = None
    low_battery_after_s: float | None = None
    busy: bool = False
    protocol: int = 0
    app_protocol: int = 0
    reboot_after_s: float | None = None
    stop_ignored: bool = False
    stop_late_s: float = 0.0
    stop_misnumbered: bool = False


SOUND_LOADCELL = LoadCellFaults()
SOUND_ENCODER = EncoderFaults()
SOUND_CRAZYFLIE = CrazyflieFaults()

# Limits of the protocols' fields, and of a turn of the vehicle.
_LARGEST = {
    "encoder.wrong_width": 32,
    "loadcell.status": 0xFFFFFFFF,
    "crazyflie.tumble_deg": 180,
    "crazyflie.app_protocol": 255,
}

_Faults = TypeVar("_Faults", EncoderFaults, LoadCellFaults, CrazyflieFaults)
_DEVICES = {"encoder": EncoderFaults, "loadcell": LoadCellFaults, "crazyflie": CrazyflieFaults}


def within(now_s: float, after_s: float | None, for_s: float | None) -> bool:
    """Return whether a fault that begins at `after_s` and lasts `for_s` (None: without end) is present now."""
    return after_s is not None and after_s <= now_s < (float("inf") if for_s is None else after_s + for_s)


def parse_faults(arguments: Sequence[str]) -> tuple[EncoderFaults, LoadCellFaults, CrazyflieFaults]:
    """Read arguments such as `loadcell.drop_every=100` or `encoder.split=true`, or several separated by commas.

    Raises ConfigError naming an unknown fault, with the known ones, or an invalid value.
    """
    values: dict[str, str] = {}
    for argument in ",".join(arguments).split(",") if arguments else ():
        name, _, value = argument.partition("=")
        if name not in _known():
            raise ConfigError(f"{argument}: there is no fault '{name}'. Known faults: {', '.join(_known())}.")
        values[name] = value
    return (
        _made("encoder", EncoderFaults, values),
        _made("loadcell", LoadCellFaults, values),
        _made("crazyflie", CrazyflieFaults, values),
    )


def _known() -> list[str]:
    return [f"{device}.{field.name}" for device, kind in _DEVICES.items() for field in fields(kind)]


def _made(device: str, kind: type[_Faults], values: Mapping[str, str]) -> _Faults:
    hints = get_type_hints(kind)
    read: dict[str, Any] = {}
    for field in fields(kind):
        name = f"{device}.{field.name}"
        if name in values:
            read[field.name] = _value(name, values[name], get_args(hints[field.name]) or (hints[field.name],))
    return kind(**read)


def _value(name: str, text: str, kinds: tuple[type, ...]) -> bool | float:
    """Read a value as the first of the field's types: a number or a bool, perhaps followed by None."""
    kind = kinds[0]
    if kind is bool:
        if text not in ("true", "false"):
            raise ConfigError(f"{name}: should be true or false, not '{text}'.")
        return text == "true"
    try:
        value = int(text, 0) if kind is int else float(text)
    except ValueError:
        value = -1
    if not 0 <= value < float("inf") or value > _LARGEST.get(name, value):
        expected = "whole number" if kind is int else "number"
        limits = f"from zero to {_LARGEST[name]}" if name in _LARGEST else "of zero or more"
        raise ConfigError(f"{name}: should be a {expected} {limits}, not '{text}'.")
    return value
