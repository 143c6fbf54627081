"""Monitors the vehicle's supervisor: records its state, and waits for a state that a command needs.

Firmware that reports its state on port 9 is polled; older firmware logs the same word.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from twisted.internet.base import DelayedCall
from twisted.internet.defer import CancelledError, Deferred, succeed

from cfid.errors import DeviceError
from cfid.records.run import DeviceRecord
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Block, Instrument
from cfid.rig.vehicle import LogBlock, Vehicle
from cfid.wire.crtp import LOG_DATA_CHANNEL, LOG_PORT
from cfid.wire.supervisor import (
    ASK_STATE,
    INFO_CHANNEL,
    INFO_VARIABLE,
    PORT_SINCE,
    SUPERVISOR_PORT,
    Bits,
    VehicleState,
    decode_arming,
    decode_state,
    encode_arming,
)

EVERY_S = 0.05  # the supervisor itself updates every 0.04 s
_ASK_S, _TRIES = 0.1, 5
_BACK_S = 1.0  # a vehicle is ready again within 0.16 s of a timeout
_SPIN_UP_S = 2.5  # the firmware gives rotors 2 s to reach their idle speed


class Supervisor:
    """The supervisor of a vehicle in a loop, with the latest state reported, None before the first."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Take a vehicle."""
        self.state: VehicleState | None = None
        self.seen_s = -np.inf
        self._vehicle, self._protocol = vehicle, vehicle.link.firmware_protocol
        self._is_logged = self._protocol < PORT_SINCE and vehicle.link.variable(INFO_VARIABLE) is not None
        self._block: LogBlock | None = None
        self._beginning: Deferred[None] = succeed(None)
        self._logged_s = -np.inf
        self._handle: Callable[[VehicleState, float], None] | None = None
        vehicle.listen(SUPERVISOR_PORT, INFO_CHANNEL, self._take_answer)
        vehicle.listen(LOG_PORT, LOG_DATA_CHANNEL, self._take_row)

    @property
    def reports(self) -> bool:
        """Whether this firmware reports its state at all."""
        return self._protocol >= PORT_SINCE or self._is_logged

    def watch(self, handle: Callable[[VehicleState, float], None] | None) -> None:
        """Call `handle` with each state that is reported and the monotonic time of its arrival; None ends that."""
        self._handle = handle

    def ask(self) -> None:
        """Request the state without waiting. Raises DeviceError when the link is gone."""
        if self._protocol >= PORT_SINCE:
            self._vehicle.link.send(ASK_STATE)
            return
        quiet_s = self._vehicle.hardware.seconds() - max(self._logged_s, self.seen_s)
        if self._is_logged and self._beginning.called and quiet_s > 0.3:  # the log was reset
            self._beginning = Deferred.fromCoroutine(self._log_state())
            self._beginning.addErrback(lambda failure: failure.trap(DeviceError, CancelledError))

    async def end(self) -> None:
        """End the reports that were requested."""
        self._beginning.cancel()
        block, self._block = self._block, None
        if block is not None:
            await block.delete()

    async def close(self) -> None:
        """End the reports for good."""
        await self.end()
        self._vehicle.ignore(SUPERVISOR_PORT, INFO_CHANNEL, self._take_answer)
        self._vehicle.ignore(LOG_PORT, LOG_DATA_CHANNEL, self._take_row)

    async def wait(self, holds: Callable[[VehicleState], bool], *, within_s: float) -> VehicleState | None:
        """Return the first state reported from now on for which `holds` is true, None when none arrives in time.

        Returns the latest state at once where the firmware reports no state. Raises DeviceError when the link is gone.
        """
        begun_s = self._vehicle.hardware.seconds()
        while self.reports:
            self.ask()
            await self._vehicle.hardware.sleep(0.02)
            if self.seen_s > begun_s and self.state is not None and holds(self.state):
                return self.state
            if self._vehicle.hardware.seconds() - begun_s > within_s:
                return None
        return self.state

    async def request_arming(self, *, arm: bool = True) -> bool | None:
        """Request to arm or disarm; return whether that was granted, None without an answer: then look at the state."""
        request = encode_arming(arm=arm, protocol=self._protocol)

        def answered(payload: bytes) -> bool | None:
            return decode_arming(payload, protocol=self._protocol)

        return await self._vehicle.ask(request, answered, within_s=_ASK_S, tries=_TRIES)

    async def make_ready(self) -> None:
        """Bring the vehicle into a state in which motors may run; arm it where it does not arm itself.

        A vehicle that arms itself is disarmed first, so that its timeouts start anew: it disarms itself 30 s after it
        got ready and 3 s after it landed, perhaps just as motors start. It arms itself on entering one state only: a
        request that arrives just then, late or repeated, leaves it disarmed until it is armed.
        Raises DeviceError naming the state in which it stays.
        """
        await self.wait(lambda state: bool(state.remedy) or _settled(state), within_s=_BACK_S)
        if self.state is not None and self.state.arms_itself and self.state.can_fly:
            await self.request_arming(arm=False)
            await self._vehicle.hardware.sleep(EVERY_S)  # within which it updates its state
            await self.wait(lambda state: bool(state.remedy) or state.can_fly, within_s=_BACK_S)
        if self.state is not None and _waits_for_arming(self.state):
            if await self.request_arming() is False:
                raise DeviceError(f"{self._vehicle.uri}: the vehicle refuses to be armed.")
            await self.wait(lambda state: bool(state.remedy) or state.can_fly, within_s=_SPIN_UP_S)
        if self.reports and (self.state is None or not self.state.can_fly):
            raise DeviceError(f"{self._vehicle.uri}: {self._obstacle()}.")

    async def confirm_disarmed(self) -> bool:
        """Return whether the vehicle is disarmed, or need not be: it arms itself, or reports no state."""
        await self.wait(lambda state: state.arms_itself or not state.armed, within_s=0.6)
        return self.state is None or self.state.arms_itself or not self.state.armed

    def _obstacle(self) -> str:
        if self.state is None:
            return "the vehicle reports no state"
        if self.state.remedy:
            return f"the vehicle is {self.state.name}: {self.state.remedy}"
        if self.state.arms_itself:
            return f"the vehicle does not get ready: it is {self.state.name}"
        return (
            f"the vehicle did not get ready within {_SPIN_UP_S:g} s of arming ({self.state.name}): each rotor has to "
            "show 1000 to 3500 rpm at idle thrust. One may be blocked, or powerDist.idleThrust changed"
        )

    def _take_answer(self, payload: bytes, arrived_s: float) -> None:
        state = decode_state(payload)
        if state is not None:
            self._note(state, arrived_s)

    async def _log_state(self) -> None:
        """Begin to log the state; one that is not logged counts as not reported, which the callers notice."""
        if self._block is not None:
            await self._block.delete()
        self._block = LogBlock(self._vehicle, [INFO_VARIABLE])
        await self._block.start(round(1000 * EVERY_S))
        self._logged_s = self._vehicle.hardware.seconds()

    def _take_row(self, payload: bytes, arrived_s: float) -> None:
        row = None if self._block is None else self._block.row(payload)
        if row is not None:
            self._note(VehicleState.of(int(row[1][0])), arrived_s)

    def _note(self, state: VehicleState, arrived_s: float) -> None:
        self.state, self.seen_s = state, arrived_s
        if self._handle is not None:
            self._handle(state, arrived_s)


async def present_state(vehicle: Vehicle) -> VehicleState | None:
    """Return the state of a vehicle, None where the firmware reports none. Raises DeviceError without an answer."""
    supervisor = Supervisor(vehicle)
    try:
        state = await supervisor.wait(lambda _: True, within_s=1.0)
    finally:
        await supervisor.close()
    if state is None and supervisor.reports:
        raise DeviceError(f"{vehicle.uri}: the vehicle did not report its state: the link loses packets.")
    return state


def _waits_for_arming(state: VehicleState) -> bool:
    return Bits.CAN_BE_ARMED in state.bits and not state.armed


def _settled(state: VehicleState) -> bool:
    """Return whether a state lasts until motors turn or a client arms; the others end within a few updates."""
    return state.can_fly or (_waits_for_arming(state) and not state.arms_itself)


class SupervisorLog(Instrument):
    """Records the supervisor: a row for each change of its state word.

    A state in which no motor may run ends the run where motors are meant to turn.
    """

    name = "supervisor"
    columns = ("t", "state")
    eventful = True

    def __init__(self, supervisor: Supervisor, vehicle: Vehicle, record: DeviceRecord) -> None:
        """Take the supervisor of a vehicle."""
        self.record = record
        self._supervisor, self._vehicle = supervisor, vehicle
        self._rows: list[tuple[float, int]] = []
        self._states: list[VehicleState] = []
        self._next: DelayedCall | None = None
        self._unanswered = 0  # polls, which a suspended program does not send

    def start(self, hardware: Hardware) -> None:
        """Begin to poll."""
        self._hardware = hardware
        self._vehicle.begin()
        self._supervisor.watch(self._take)
        self._poll()

    def take(self) -> Block:
        """Return the changes, with a fault for a state that ends a run: locked, crashed, tumbled, deck fault, none."""
        rows, self._rows = self._rows, []
        state = self._supervisor.state
        return self.block(rows, fault=self._fault(), status="" if state is None else state.name)

    async def stop(self) -> None:
        """Read the state once more, since the motors' stop may have changed it, and stop polling."""
        if self._next is not None and self._next.active():
            self._next.cancel()
        self._next = None
        try:
            await self._supervisor.wait(lambda state: not state.is_passing, within_s=_ASK_S * _TRIES)
            await self._supervisor.end()
        except DeviceError:  # the link is gone: the last known state stays
            return

    def close(self) -> None:
        """Take no further state."""
        self._supervisor.watch(None)

    def facts(self) -> Mapping[str, Any]:
        """Return the states before and after by name."""
        if not self._states:
            return {}
        return {"state_before": self._states[0].name, "state_after": self._states[-1].name}

    def _fault(self) -> str:
        state, uri = self._supervisor.state, self._vehicle.uri
        if state is not None and state.remedy:
            return f"{uri}: the vehicle is {state.name}: {state.remedy}."
        # A link has to lose nearly every poll of a second.
        if not self._supervisor.reports or self._unanswered <= 20:
            return ""
        unreported_s = EVERY_S * self._unanswered
        return f"{uri}: the vehicle has not reported its state for {unreported_s:.1f} s: does another program use it?"

    def _poll(self) -> None:
        self._next = self._hardware.later(EVERY_S, self._poll)
        self._unanswered += 1
        try:
            self._supervisor.ask()
        except DeviceError:  # the instruments that command the vehicle report it
            return

    def _take(self, state: VehicleState, arrived_s: float) -> None:
        self._unanswered = 0
        if not self._states or state != self._states[-1]:
            self._states.append(state)
            self._rows.append((arrived_s, int(state.bits)))
