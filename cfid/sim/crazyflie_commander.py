"""Simulates the vehicle's commander: which setpoint is in force, and since when; not what a setpoint demands."""

from collections.abc import Callable
from enum import IntEnum

SETPOINT_PORT, GENERIC_SETPOINT_PORT = 3, 7

_HIGH_LEVEL_STEPS = 10  # of the loop, between two setpoints of the high-level commander
_SET_CHANNEL, _META_CHANNEL = 0, 1
_STOP_NOTIFIED = 0


class Priority(IntEnum):
    """Which setpoint counts: the latest one of at least the priority of the one in force."""

    NOBODY = 0
    HIGH_LEVEL = 1
    CLIENT = 2  # or the app


class Commander:
    """The setpoint in force, by its time in milliseconds since power-on and by its priority."""

    def __init__(self, now_ms: Callable[[], int]) -> None:
        """Hold the empty setpoint of power-on; `now_ms` is the clock."""
        self._now_ms = now_ms
        self.setpoint_ms = 0
        self.priority = Priority.NOBODY

    def set(self, priority: Priority) -> None:
        """Take a setpoint, unless one of a higher priority is in force."""
        if priority >= self.priority:
            self.setpoint_ms, self.priority = self._now_ms(), priority

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
            self.set(Priority.CLIENT)
        elif port == GENERIC_SETPOINT_PORT and channel == _META_CHANNEL and payload[:1] == bytes([_STOP_NOTIFIED]):
            self.relax()
