"""Asks the vehicle who it is, what runs on it, and what state it is in, and how full its battery is; no motor turns."""

from cfid.errors import DeviceError
from cfid.records.campaign import CrazyflieLink
from cfid.rig.asking import logged, parameter_of, state_of
from cfid.rig.check import Finding
from cfid.rig.crazyflie import Link, find_vehicle
from cfid.rig.crazyflie_log import BATTERY
from cfid.rig.lock import DeviceLock, holder_of
from cfid.rig.motors import Firmware, firmware_of
from cfid.rig.ready_vehicle import IDLE_THRUST
from cfid.wire.app import Ports

_FOUND = {
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
        with DeviceLock.take(uri):
            return _ask(Link.connect(uri), setting)
    except DeviceError as error:
        return [Finding("link", "fault", str(error), "power, address, radio: devices.crazyflie.uri in rig.toml")]


def _ask(link: Link, setting: CrazyflieLink) -> list[Finding]:
    try:
        found = Finding("link", "ok", f"{link.uri}, protocol {link.firmware_protocol}")
        ports = Ports(setting.thrust_port, setting.sine_port, setting.ping_port)
        return [found, *_firmware(firmware_of(link, ports)), _state(link), _battery(link, setting.stop_below_v)]
    finally:
        link.close()


def _firmware(firmware: Firmware) -> list[Finding]:
    what = _FOUND[firmware.kind]
    if firmware.kind != "app":
        advice = "a lost link does not stop these motors; firmware_patches/README.md tells how to flash the app"
        return [Finding("motors", "warning", what, advice)]
    if firmware.knows_owners:
        return [Finding("motors", "ok", what)]
    advice = "another program's keep-alives prolong commands there: flash the app that came with this cfid"
    return [Finding("motors", "warning", f"{what}; an older version", advice)]


def _state(link: Link) -> Finding:
    state = state_of(link)
    if state is None:
        return Finding("supervisor", "warning", "this firmware reports no state", "update it: 2023.02 or later does")
    if state.remedy:
        return Finding("supervisor", "fault", state.name, state.remedy)
    if not state.arms_itself and not parameter_of(link, IDLE_THRUST):
        return Finding("supervisor", "fault", f"{state.name}, {IDLE_THRUST} is 0", "it cannot arm: turn it off and on")
    return Finding("supervisor", "ok", state.name)


def _battery(link: Link, stop_below_v: float | None) -> Finding:
    volts = logged(link, BATTERY)
    if volts is None:
        return Finding("battery", "warning", "the vehicle reports no voltage", "no run ends on a low battery")
    if stop_below_v is not None and volts < stop_below_v:
        return Finding(
            "battery", "fault", f"{volts:.2f} V", f"charge it: rig.toml stops a run below {stop_below_v:g} V"
        )
    return Finding("battery", "ok", f"{volts:.2f} V")
