"""Checks the vehicle's identity, firmware, state and battery; no motor turns."""

from cfid.errors import DeviceError
from cfid.quantities.registry import Platform
from cfid.records.rig_file import CrazyflieLink
from cfid.rig.check import DeviceAnswer
from cfid.rig.link import Link
from cfid.rig.lock import DeviceLock, holder_of
from cfid.rig.log_block import BATTERY, logged
from cfid.rig.motor_log import foreign_motion
from cfid.rig.motors import Firmware, firmware_of
from cfid.rig.radio import find_vehicle
from cfid.rig.ready_vehicle import ReadyVehicle, state_and_idle
from cfid.rig.recorder import sleep
from cfid.rig.supervisor import present_state
from cfid.rig.tables import connect
from cfid.rig.vehicle import Vehicle, asked
from cfid.wire.app import AppPorts
from cfid.wire.crtp import Packet
from cfid.wire.supervisor import DEVICE, PLATFORM_PORT, RELEASE, VERSION_CHANNEL, Bits, VehicleState

_LANDS_S = 2.5  # after the last motor stopped, a vehicle counts as flying for 2 s
_FOUND = {
    "app": "cfid's app: thrust, sine, ping, and motors that stop when the link is lost",
    "stock": "stock firmware: thrust by parameters, ping by echo, no sine",
}
_NEWEST_PROTOCOL = 12  # of release 2026.08, with which cfid was tried
_NAMES: dict[Platform, tuple[str, ...]] = {
    "cf2": ("Crazyflie 2.0", "Crazyflie 2.1"),
    "cf21": ("Crazyflie 2.1",),
    "cf21bl": ("Crazyflie 2.1 Brushless",),
}


def check_vehicle(setting: CrazyflieLink, platform: Platform) -> list[DeviceAnswer]:
    """Connect to the vehicle and check it; one that another cfid holds is left alone. `platform` is that of rig.toml.

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
            return _ask(connect(uri), setting, platform)
    except DeviceError as error:
        return [DeviceAnswer("link", "fault", str(error))]


def _ask(link: Link, setting: CrazyflieLink, platform: Platform) -> list[DeviceAnswer]:
    async def answers(vehicle: Vehicle) -> list[DeviceAnswer]:
        state, idle_thrust = await state_and_idle(vehicle)
        cause = await foreign_motion(vehicle, idle_thrust=idle_thrust)
        if not cause and state is not None and Bits.FLYING in state.bits:
            await sleep(vehicle.loop, _LANDS_S)
            state = await present_state(vehicle)
        volts = (await logged(vehicle, [BATTERY]))[0] if link.variable(BATTERY) is not None else None
        return [
            *await _identity(vehicle, platform),
            await _motors(vehicle, link, setting, state, idle_thrust),
            _state(state, cause),
            _battery(volts, setting.stop_below_v),
        ]

    try:
        return asked(link, answers)
    finally:
        link.close()


async def _identity(vehicle: Vehicle, platform: Platform) -> list[DeviceAnswer]:
    """Return the versions of the firmware, and whether rig.toml names the vehicle that answers."""
    protocol, release, name = (
        vehicle.wire.firmware_protocol,
        await _stated(vehicle, RELEASE),
        await _stated(vehicle, DEVICE),
    )
    versions = f"{vehicle.uri}, protocol {protocol}" + (f", firmware {release}" if release else "")
    advice = f"this cfid was tried with protocols up to {_NEWEST_PROTOCOL}: look for a newer cfid"
    is_new = protocol > _NEWEST_PROTOCOL
    answers = [DeviceAnswer("link", "warning" if is_new else "ok", versions, advice if is_new else "")]
    if name and name not in _NAMES.get(platform, (name,)):
        right = next((known for known, names in _NAMES.items() if name in names), "other")
        advice = f'rig.toml states platform = "{platform}" under [vehicle]: write "{right}", or connect that vehicle'
        answers.append(DeviceAnswer("vehicle", "warning", name, advice))
    elif name:
        answers.append(DeviceAnswer("vehicle", "ok", name))
    return answers


async def _stated(vehicle: Vehicle, question: bytes) -> str:
    """Return what the vehicle states about itself, "" where its firmware does not know the question."""

    def text(payload: bytes) -> str | None:
        if not payload.startswith(question):
            return None
        return payload.removeprefix(question).decode("ascii", "replace").strip("\0 ")

    return await vehicle.ask(Packet(PLATFORM_PORT, VERSION_CHANNEL, question), text) or ""


async def _motors(
    vehicle: Vehicle, link: Link, setting: CrazyflieLink, state: VehicleState | None, idle_thrust: int
) -> DeviceAnswer:
    """Return how the motors are driven, and whether commands that turn them would be refused, apart from its state."""
    try:
        firmware = await firmware_of(vehicle, AppPorts(setting.thrust_port, setting.sine_port, setting.ping_port))
        if state is None or not state.remedy:
            ReadyVehicle(link, firmware, setting, state, idle_thrust).refuse_unfit()
        return _firmware(firmware)
    except DeviceError as error:
        return DeviceAnswer("motors", "fault", str(error).removeprefix(f"{vehicle.uri}: "))


def _firmware(firmware: Firmware) -> DeviceAnswer:
    what = _FOUND[firmware.kind]
    if firmware.kind != "app":
        advice = "a lost link does not stop these motors; firmware_patches/README.md explains how to flash the app"
        return DeviceAnswer("motors", "warning", what, advice)
    if firmware.knows_owners:
        return DeviceAnswer("motors", "ok", what)
    advice = "another program's keep-alives prolong this one's commands: flash the app that came with this cfid"
    return DeviceAnswer("motors", "warning", f"{what}; an older version", advice)


def _state(state: VehicleState | None, cause: str) -> DeviceAnswer:
    """Return the answer about the supervisor; `cause` is what drives motors although no cfid does."""
    if cause:
        return DeviceAnswer("supervisor", "fault", state.name if state else "no state reported", cause)
    if state is None:
        return DeviceAnswer(
            "supervisor", "warning", "this firmware reports no state", "update it: 2023.02 or later does"
        )
    if state.remedy:
        return DeviceAnswer("supervisor", "fault", state.name, state.remedy)
    if Bits.FLYING in state.bits:
        return DeviceAnswer(
            "supervisor", "fault", state.name, "its motors are at zero, yet it does not land: restart it"
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
