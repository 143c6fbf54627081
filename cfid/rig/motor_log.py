"""Compares what the motors do, by the vehicle's log, with this program's commands, and names what else drives them.

The parameters motorPowerSet override everything else on the vehicle, cfid's app included: they are read and cleared.
"""

import math
from collections.abc import Mapping, Sequence

from twisted.internet.defer import Deferred

from cfid.errors import DeviceError, StopError
from cfid.rig.motors import STILL
from cfid.rig.stop import MAY_BE_RUNNING, TRIES, WITHIN_S
from cfid.rig.supervisor import present_state
from cfid.rig.vehicle import LogBlock, Vehicle
from cfid.units import MOTORS
from cfid.wire.crtp import LOG_DATA_CHANNEL, LOG_PORT, Variable
from cfid.wire.supervisor import Bits, encode_arming

APPLIED = tuple(f"motor.m{motor}" for motor in MOTORS)  # the commands that finally reach the motors

_READY_S = 0.3  # in which a disarmed brushed vehicle is ready again, and another program may go on
_LOOK_S, _ROW_S = 0.12, 0.5  # a client that flies sends a setpoint every 0.1 s or more often
_LOOKS = 3
_RESOLUTION = 256  # of brushed motors


class MotorWatch:
    """Compares the rows of a running log with the commands; `fault` states a difference that lasts, and its cause."""

    def __init__(self, vehicle: Vehicle, *, idle_thrust: int) -> None:
        """Take a vehicle whose idle motors may turn at `idle_thrust`."""
        self.fault = ""
        self._vehicle, self._idle_thrust = vehicle, idle_thrust
        self._compared = vehicle.expected
        self._first_s = self._last_s = -math.inf  # rows that differ
        self._naming: Deferred[None] | None = None

    def take(self, arrived_s: float, row: Mapping[str, float]) -> None:
        """Take a row and when it arrived; where it lacks a motor, nothing can be compared."""
        applied, expected = [row.get(name, math.nan) for name in APPLIED], self._vehicle.expected
        if expected != self._compared or arrived_s - self._last_s > 1.5:
            self._compared, self._first_s = expected, math.inf
        if expected is None or self._naming is not None:
            return
        least, most = expected
        below = any(command < low - _RESOLUTION for low, command in zip(least, applied, strict=True))
        if not below and not _beyond(most, applied, self._idle_thrust):
            return
        self._first_s, self._last_s = min(self._first_s, arrived_s), arrived_s
        stopped = not _beyond(STILL, applied, self._idle_thrust)
        # A vehicle that stopped its motors reports why within 0.6 s.
        if arrived_s - self._first_s >= (0.6 if stopped else 0.1):
            self._naming = Deferred.fromCoroutine(self._name(applied))
            self._naming.addErrback(lambda failure: failure.trap(DeviceError))  # a lost link is reported by others

    async def _name(self, applied: Sequence[float]) -> None:
        self.fault = f"{self._vehicle.uri}: {await _cause(self._vehicle, applied)}."


async def foreign_motion(vehicle: Vehicle, *, idle_thrust: int) -> str:
    """Return what turns motors before this program commands any, or would override it; empty where nothing does.

    Raises DeviceError when the vehicle does not answer.
    """
    if any(vehicle.link.variable(name) is None for name in APPLIED):
        return ""
    applied = await _applied(vehicle)
    driven = _beyond(STILL, applied, idle_thrust) or await is_overridden(vehicle)
    return await _cause(vehicle, applied) if driven else ""


async def confirm_still(vehicle: Vehicle, *, app_feeds: bool = False) -> None:
    """Raise StopError unless the vehicle's log shows all four motors at zero for a while.

    A vehicle with a motor that still runs is disarmed first, which stops it, unless the parameters motorPowerSet drive
    it; a brushed vehicle is ready again in a moment. Where the app feeds null setpoints for two seconds after its stop,
    another client's setpoints drive motors in pulses that no look is sure to see, and then all the time: disarming ends
    the feeding, so that the look sees what the operator will.
    """
    disarming = encode_arming(arm=False, protocol=vehicle.link.firmware_protocol)
    try:
        if app_feeds:
            vehicle.link.send(disarming)
        if not any(await _applied(vehicle, for_s=_READY_S if app_feeds else _LOOK_S)):
            return
        vehicle.link.send(disarming)
        await vehicle.hardware.sleep(_READY_S)
        applied = await _applied(vehicle)
        cause = await _cause(vehicle, applied) if any(applied) else ""
    except DeviceError as error:
        raise StopError(f"{MAY_BE_RUNNING}: the log could not confirm that the motors stopped. ({error})") from None
    if cause:
        raise StopError(f"{MAY_BE_RUNNING}: {vehicle.uri}: {cause}.")


class PowerSet:
    """The five parameters of a vehicle; with `enable` at 1 each motor runs at its own parameter's command."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Take a vehicle that has them. Raises DeviceError for one that lacks any."""
        self._vehicle = vehicle
        self.enable = self._parameter("enable")
        self.each = [self._parameter(f"m{motor}") for motor in MOTORS]

    async def clear(self) -> None:
        """Disable the parameters, set all to zero and read them back. Raises DeviceError when that is not confirmed."""
        for parameter in (self.enable, *self.each):
            await self._vehicle.write_parameter(parameter, 0, within_s=WITHIN_S, tries=TRIES)
        for parameter in (self.enable, *self.each):
            if await self._vehicle.read_parameter(parameter, within_s=WITHIN_S, tries=TRIES) != 0:
                raise DeviceError(f"{self._vehicle.uri}: a parameter of motorPowerSet was set to 0 and is not.")

    def _parameter(self, name: str) -> Variable:
        found = self._vehicle.link.parameter(f"motorPowerSet.{name}")
        if found is None:
            raise DeviceError(f"{self._vehicle.uri}: the firmware has no parameter motorPowerSet.{name}.")
        return found


async def is_overridden(vehicle: Vehicle) -> bool:
    """Return whether these parameters drive the motors. Raises DeviceError without an answer."""
    enable = vehicle.link.parameter("motorPowerSet.enable")
    value = 0 if enable is None else await vehicle.read_parameter(enable, within_s=WITHIN_S, tries=TRIES)
    if value is None:
        raise DeviceError(f"{vehicle.uri}: the vehicle does not report motorPowerSet.enable.")
    return value != 0


async def _applied(vehicle: Vehicle, *, for_s: float = _LOOK_S) -> list[float]:
    """Return the largest command of each motor in a short look: one that competes with the app's comes in pulses.

    Another program that connects, such as one that stops the motors, too, deletes all blocks of the log: a block whose
    rows end is left alone, since its number may be that program's by now, and a new one is looked at.
    """
    largest = [0.0] * len(APPLIED)
    for _ in range(_LOOKS):
        block = LogBlock(vehicle, APPLIED)
        await block.start(10)
        end_s = vehicle.hardware.seconds() + for_s
        while (row := await vehicle.next((LOG_PORT, LOG_DATA_CHANNEL), block.row, within_s=_ROW_S)) is not None:
            largest = list(map(max, largest, row[0][1]))
            if vehicle.hardware.seconds() >= end_s:
                await block.delete()
                return largest
    raise DeviceError(f"{vehicle.uri}: no row of the motors' log came within {_ROW_S:g} s, in {_LOOKS} looks.")


def _beyond(most: Sequence[int], applied: Sequence[float], idle_thrust: int) -> bool:
    return any(command > max(high, idle_thrust) + _RESOLUTION for high, command in zip(most, applied, strict=True))


async def _cause(vehicle: Vehicle, applied: Sequence[float]) -> str:
    """Return what drives motors, or stopped them, against or without this program's commands."""
    shown = f"its motors are at {', '.join(f'{command:.0f}' for command in applied)}, which this cfid does not command"
    if await is_overridden(vehicle):
        return (
            f"{shown}: the parameters motorPowerSet drive them, set by another program or left on by a killed one. "
            "`cfid motors stop` clears them"
        )
    if not any(applied):
        return f"{shown}: another program stopped them"
    state = await present_state(vehicle)
    if state is not None and Bits.HIGH_LEVEL in state.bits:
        return f"{shown}: its high-level commander flies. End the program that started it, then `cfid motors stop`"
    return (
        f"{shown}: another client's setpoints drive them, or an app on other ports than devices.crazyflie in rig.toml "
        "has. End that program, then `cfid motors stop`"
    )
