"""Simulates the vehicle's commander: which setpoint is in force, since when, and the thrust that it demands."""

import struct
from collections.abc import Callable
from enum import IntEnum

SETPOINT_PORT, GENERIC_SETPOINT_PORT = 3, 7

_HIGH_LEVEL_STEPS = 10  # of the loop, between two setpoints of the high-level commander
_SET_CHANNEL, _META_CHANNEL = 0, 1
_STOP_NOTIFIED = 0
_LEGACY = struct.Struct("<fffH")  # roll, pitch, yaw rate and thrust of port 3
_LEAST_THRUST, _MOST_THRUST = 1000, 60000


class Priority(IntEnum):
    """Which setpoint counts: the latest one of at least the priority of the one in force."""

    NOBODY = 0
    HIGH_LEVEL = 1
    CLIENT = 2  # or the app


class Commander:
    """The setpoint in force, by its time in milliseconds since power-on, its priority and its thrust."""

    def __init__(self, now_ms: Callable[[], int]) -> None:
        """Hold the empty setpoint of power-on; `now_ms` is the clock."""
        self._now_ms = now_ms
        self.setpoint_ms = 0
        self.priority = Priority.NOBODY
        self.thrust = 0
        self._locked = True

    def set(self, priority: Priority, thrust: int = 0) -> None:
        """Take a setpoint, unless one of a higher priority is in force."""
        if priority >= self.priority:
            self.setpoint_ms, self.priority, self.thrust = self._now_ms(), priority, thrust

    def relax(self) -> None:
        """Pass control to the high-level commander."""
        self.priority = Priority.HIGH_LEVEL

    def advance(self, step: int, *, can_fly: bool) -> None:
        """Set the null setpoint of the idle high-level commander where one is due."""
        if step % _HIGH_LEVEL_STEPS == 0 and can_fly:
            self.set(Priority.HIGH_LEVEL)

    def receive(self, port: int, channel: int, payload: bytes) -> None:
        """Take a client's setpoint, or its notice that no further setpoints follow."""
        if channel == _SET_CHANNEL:
            self.set(Priority.CLIENT, self._thrust(payload) if port == SETPOINT_PORT else 0)
        elif port == GENERIC_SETPOINT_PORT and channel == _META_CHANNEL and payload[:1] == bytes([_STOP_NOTIFIED]):
            self.relax()

    def _thrust(self, payload: bytes) -> int:
        """Return the thrust that a setpoint of port 3 demands: none before the first one without thrust."""
        thrust = int(_LEGACY.unpack(payload)[-1]) if len(payload) == _LEGACY.size else 0
        self._locked = thrust > 0 and (self._locked or self.priority is Priority.NOBODY)
        return 0 if self._locked or thrust < _LEAST_THRUST else min(thrust, _MOST_THRUST)
