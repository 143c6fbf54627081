"""Checks the vehicle's identity, firmware, state and battery; no motor turns."""

from cfid.errors import DeviceError
from cfid.records.devices import CrazyflieLink
from cfid.rig.cflib_drivers import find_vehicle
from cfid.rig.check import DeviceAnswer
from cfid.rig.crazyflie import Link
from cfid.rig.lock import DeviceLock, holder_of
from cfid.rig.log_block import BATTERY, logged
from cfid.rig.motors import Firmware, firmware_of
from cfid.rig.ready_vehicle import IDLE_THRUST, state_and_idle
from cfid.rig.vehicle import Vehicle, asked
from cfid.wire.app import AppPorts
from cfid.wire.supervisor import VehicleState

_FOUND = {
    "app": "cfid's app: thrust, sine, ping, and motors that stop when the link is lost",
    "stock": "stock firmware: thrust by parameters, ping by echo, no sine",
}


def check_vehicle(setting: CrazyflieLink) -> list[DeviceAnswer]:
    """Connect to the vehicle and check it; one that another cfid holds is left alone.

    It is not a fault if rig.toml names no vehicle and none is found: not every experiment needs one.
    """
    if setting.uri and (holder := holder_of(setting.uri)):
        return [DeviceAnswer("link", "ok", f"held by {holder}", "skipped: a vehicle has one client")]
    try:
        uri = setting.uri or find_vehicle()
    except DeviceError as error:
        return [DeviceAnswer("link", "warning", str(error))]
    try:
        with DeviceLock.take(uri):
            return _ask(Link.connect(uri), setting)
    except DeviceError as error:
        return [DeviceAnswer("link", "fault", str(error), "power, address, radio: devices.crazyflie.uri in rig.toml")]


def _ask(link: Link, setting: CrazyflieLink) -> list[DeviceAnswer]:
    try:
        found = DeviceAnswer("link", "ok", f"{link.uri}, protocol {link.firmware_protocol}")
        ports = AppPorts(setting.thrust_port, setting.sine_port, setting.ping_port)
        return [found, *asked(link, lambda vehicle: _answers(vehicle, ports, setting.stop_below_v))]
    finally:
        link.close()


def _firmware(firmware: Firmware) -> DeviceAnswer:
    what = _FOUND[firmware.kind]
    if firmware.kind != "app":
        advice = "a lost link does not stop these motors; firmware_patches/README.md explains how to flash the app"
        return DeviceAnswer("motors", "warning", what, advice)
    if firmware.knows_owners:
        return DeviceAnswer("motors", "ok", what)
    advice = "another program's keep-alives prolong this one's commands: flash the app that came with this cfid"
    return DeviceAnswer("motors", "warning", f"{what}; an older version", advice)


async def _answers(vehicle: Vehicle, ports: AppPorts, stop_below_v: float | None) -> list[DeviceAnswer]:
    firmware = _firmware(await firmware_of(vehicle, ports))
    state = _state(*await state_and_idle(vehicle))
    volts = (await logged(vehicle, [BATTERY]))[0] if vehicle.wire.variable(BATTERY) is not None else None
    return [firmware, state, _battery(volts, stop_below_v)]


def _state(state: VehicleState | None, idle_thrust: int) -> DeviceAnswer:
    if state is None:
        return DeviceAnswer(
            "supervisor", "warning", "this firmware reports no state", "update it: 2023.02 or later does"
        )
    if state.remedy:
        return DeviceAnswer("supervisor", "fault", state.name, state.remedy)
    if not state.arms_itself and not idle_thrust:
        return DeviceAnswer(
            "supervisor", "fault", f"{state.name}, {IDLE_THRUST} is 0", "it cannot arm: turn it off and on"
        )
    return DeviceAnswer("supervisor", "ok", state.name)


def _battery(volts: float | None, stop_below_v: float | None) -> DeviceAnswer:
    if volts is None:
        return DeviceAnswer("battery", "warning", "the vehicle reports no voltage", "no run ends on a low battery")
    if stop_below_v is not None and volts < stop_below_v:
        return DeviceAnswer(
            "battery", "fault", f"{volts:.2f} V", f"charge it: rig.toml stops a run below {stop_below_v:g} V"
        )
    return DeviceAnswer("battery", "ok", f"{volts:.2f} V")
