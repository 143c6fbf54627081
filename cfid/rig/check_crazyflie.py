"""Asks the vehicle who it is, what runs on it, and how full its battery is; no motor turns."""

import time

from cfid.campaign import CrazyflieLink
from cfid.errors import DeviceError
from cfid.rig.check import Finding
from cfid.rig.crazyflie import Link, find_vehicle
from cfid.rig.crazyflie_log import BATTERY
from cfid.rig.lock import DeviceLock, holder_of
from cfid.rig.motors import Firmware, firmware_of
from cfid.wire import crtp
from cfid.wire.app import Ports
from cfid.wire.crtp import LOG_CONTROL_CHANNEL, LOG_DATA_CHANNEL, LOG_PORT, Packet

_BLOCK = 201
_PERIOD_MS = 10
_ROW_S = 0.5

_TOLD = {
    "app": "cfid's app: thrust, sine, ping, and motors that stop without us",
    "thesis": "the thesis' modules of 2015: thrust, sine, ping",
    "stock": "stock firmware: thrust by parameters, ping by echo, no sine",
}


def check_crazyflie(setting: CrazyflieLink) -> list[Finding]:
    """Connect to the vehicle and ask; one that another cfid holds is left alone.

    A vehicle that rig.toml does not name and no radio finds is no fault: it may be another day's experiment.
    """
    if setting.uri and (holder := holder_of(setting.uri)):
        return [Finding("link", "ok", f"held by {holder}", "not asked: a vehicle has one client")]
    try:
        uri = setting.uri or find_vehicle()
    except DeviceError as error:
        return [Finding("link", "warning", str(error))]
    try:
        with DeviceLock.take(uri, holder="cfid rig check"):
            return _ask(Link.connect(uri), setting)
    except DeviceError as error:
        return [Finding("link", "fault", str(error), "power, address, radio: devices.crazyflie.uri in rig.toml")]


def _ask(link: Link, setting: CrazyflieLink) -> list[Finding]:
    try:
        found = Finding("link", "ok", f"{link.uri}, protocol {link.firmware_protocol}")
        ports = Ports(setting.thrust_port, setting.sine_port, setting.ping_port)
        return [found, _firmware(firmware_of(link, ports)), _battery(link, setting.stop_below_v)]
    finally:
        link.close()


def _firmware(firmware: Firmware) -> Finding:
    if firmware.kind == "app":
        return Finding("motors", "ok", _TOLD[firmware.kind])
    advice = "a lost link does not stop these motors; firmware_patches/README.md tells how to flash the app"
    return Finding("motors", "warning", _TOLD[firmware.kind], advice)


def _battery(link: Link, stop_below_v: float | None) -> Finding:
    volts = _read_volts(link)
    if volts is None:
        return Finding("battery", "warning", "the vehicle does not tell its voltage", "no run ends on a low battery")
    if stop_below_v is not None and volts < stop_below_v:
        return Finding(
            "battery", "fault", f"{volts:.2f} V", f"charge it: rig.toml stops a run below {stop_below_v:g} V"
        )
    return Finding("battery", "ok", f"{volts:.2f} V")


def _read_volts(link: Link) -> float | None:
    variable = link.variable(BATTERY)
    if variable is None:
        return None

    def answered(packet: Packet) -> bool | None:
        return True if packet[:2] == (LOG_PORT, LOG_CONTROL_CHANNEL) else None

    def row(packet: Packet) -> float | None:
        if packet[:2] != (LOG_PORT, LOG_DATA_CHANNEL):
            return None
        read = crtp.decode_log_row(_BLOCK, [variable], packet.payload)
        return None if read is None else read[1][0]

    link.ask(Packet(LOG_PORT, LOG_CONTROL_CHANNEL, crtp.encode_create_log(_BLOCK, [variable])), answered)
    start = Packet(LOG_PORT, LOG_CONTROL_CHANNEL, crtp.encode_start_log(_BLOCK, _PERIOD_MS))
    volts = link.ask(start, row, within_s=_ROW_S)
    link.send(Packet(LOG_PORT, LOG_CONTROL_CHANNEL, crtp.encode_stop_log(_BLOCK)))
    time.sleep(0.02)  # the link closes without looking whether that has left
    return volts
