"""Simulates the firmware's commander and its supervisor: the setpoint in force, and whether motors may run.

25 times a second the supervisor (release 2026.08) checks its conditions, which decide its state. Times are the ticks
that the firmware counts, milliseconds since power-on. The parameters motorPowerSet bypass both.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from enum import Enum, IntEnum
from typing import NamedTuple

from cfid.sim.propulsion import Four

SETPOINT_PORT, GENERIC_SETPOINT_PORT = 3, 7
UPDATE_STEPS = 40  # of the stabilizer's loop
INFO_CHANNEL = 0

_SET_CHANNEL, _META_CHANNEL = 0, 1
_STOP_NOTIFIED = 0
_LEGACY = struct.Struct("<fffH")  # roll, pitch, yaw rate and thrust of port 3
_LEAST_THRUST, _MOST_THRUST = 1000, 60000
_HIGH_LEVEL_STEPS = 10  # of the loop, between two setpoints of the high-level commander

_COMMAND_CHANNEL = 1
_ANSWER = 0x80
_ALL_BITS = 0x0C  # commands below it ask for a single bit
_ARM, _RECOVER, _EMERGENCY_STOP, _WATCHDOG = 1, 2, 3, 4
_TRAJECTORY_FINISHED = 1 << 9  # of the high-level commander, which never flies here

_FLYING_MS = 2000  # since the last command above idle thrust
_OLD_MS, _TOO_OLD_MS = 500, 2000
_WATCHDOG_MS = 1000
_TILTED_G, _TILTED_MS = 0.5, 1000
_UPSIDE_DOWN_G, _UPSIDE_DOWN_MS = -0.2, 100
_ROTORS_MS = 200
_SPINNING_RPM, _BLOCKED_RPM = range(1000, 3501), range(1, 500)

# Conditions are bits of an integer, so that checking all of them is cheap.
_ARMED = 1 << 0
_IS_FLYING = 1 << 1
_TUMBLED = 1 << 2
_OLD_SETPOINT = 1 << 3
_TOO_OLD_SETPOINT = 1 << 4
_EMERGENCY = 1 << 5
_CRASHED = 1 << 6
_PREFLIGHT_TIMEOUT = 1 << 7
_LANDED_TIMEOUT = 1 << 8
_SPINUP_TIMEOUT = 1 << 9
_ROTORS_SPIN_UP = 1 << 10  # all rotors turned fast enough for long enough, or report no speed
_ROTOR_BLOCKED = 1 << 11


class Priority(IntEnum):
    """Which setpoint counts: the latest one of at least the priority of the one in force."""

    NOBODY = 0
    HIGH_LEVEL = 1
    CLIENT = 2  # or the app


class Commander:
    """The setpoint in force: when it was set, its priority and the thrust that it demands."""

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


class SupervisorState(Enum):
    """A state, by the name that the recorded traces use."""

    NOT_INITIALIZED = "not_initialized"
    NOT_PASSED = "preflight_not_passed"
    PASSED = "preflight_passed"
    ARMING = "arming"
    READY = "ready_to_fly"
    FLYING = "flying"
    LANDED = "landed"
    RESET = "reset"
    LEVEL_OUT = "warning_level_out"
    FREE_FALL = "exception_free_fall"
    LOCKED = "locked"
    CRASHED = "crashed"


_CAN_FLY = {SupervisorState.READY, SupervisorState.FLYING, SupervisorState.LANDED, SupervisorState.LEVEL_OUT}
_MOTORS_MAY_RUN = _CAN_FLY | {SupervisorState.ARMING}


class _Rule(NamedTuple):
    """A transition `to` a state when any of `any_of` holds, `missing` does not hold, or none of `none_of` holds."""

    to: SupervisorState
    any_of: int = 0
    missing: int = 0
    none_of: int | None = None

    def applies(self, conditions: int) -> bool:
        return bool(
            conditions & self.any_of
            or self.missing & ~conditions
            or (self.none_of is not None and not conditions & self.none_of)
        )


_ALWAYS = 0  # as `none_of`
# The first rule that applies decides; without one the state stays.
_RULES: dict[SupervisorState, tuple[_Rule, ...]] = {
    SupervisorState.NOT_INITIALIZED: (_Rule(SupervisorState.NOT_PASSED, none_of=_ALWAYS),),
    SupervisorState.NOT_PASSED: (
        _Rule(SupervisorState.FREE_FALL, _EMERGENCY),
        _Rule(SupervisorState.PASSED, none_of=_TUMBLED),
    ),
    SupervisorState.PASSED: (
        _Rule(SupervisorState.FREE_FALL, _EMERGENCY),
        _Rule(SupervisorState.NOT_PASSED, _TUMBLED),
        _Rule(SupervisorState.ARMING, _ARMED),
    ),
    SupervisorState.ARMING: (
        _Rule(SupervisorState.FREE_FALL, _EMERGENCY),
        _Rule(SupervisorState.NOT_PASSED, _TUMBLED | _SPINUP_TIMEOUT, missing=_ARMED),
        _Rule(SupervisorState.READY, _ROTORS_SPIN_UP),
    ),
    SupervisorState.READY: (
        _Rule(SupervisorState.FREE_FALL, _EMERGENCY | _ROTOR_BLOCKED),
        _Rule(SupervisorState.NOT_PASSED, _TUMBLED | _PREFLIGHT_TIMEOUT, missing=_ARMED),
        _Rule(SupervisorState.FLYING, _IS_FLYING),
    ),
    SupervisorState.FLYING: (
        _Rule(SupervisorState.FREE_FALL, _TOO_OLD_SETPOINT | _EMERGENCY | _ROTOR_BLOCKED),
        _Rule(SupervisorState.CRASHED, _TUMBLED),
        _Rule(SupervisorState.RESET, missing=_ARMED),
        _Rule(SupervisorState.LEVEL_OUT, _OLD_SETPOINT),
        _Rule(SupervisorState.LANDED, missing=_IS_FLYING),
    ),
    SupervisorState.LANDED: (
        _Rule(SupervisorState.RESET, _LANDED_TIMEOUT, missing=_ARMED),
        _Rule(SupervisorState.FREE_FALL, _ROTOR_BLOCKED),
        _Rule(SupervisorState.FLYING, _IS_FLYING),
    ),
    SupervisorState.RESET: (_Rule(SupervisorState.NOT_PASSED, none_of=_ALWAYS),),
    SupervisorState.LEVEL_OUT: (
        _Rule(SupervisorState.FREE_FALL, _TOO_OLD_SETPOINT | _TUMBLED | _EMERGENCY | _ROTOR_BLOCKED),
        _Rule(SupervisorState.FLYING, none_of=_OLD_SETPOINT | _TOO_OLD_SETPOINT),
    ),
    SupervisorState.FREE_FALL: (_Rule(SupervisorState.LOCKED, none_of=_ALWAYS),),
    SupervisorState.LOCKED: (),
    SupervisorState.CRASHED: (
        _Rule(SupervisorState.NOT_PASSED, none_of=_CRASHED | _TUMBLED),
        _Rule(SupervisorState.LOCKED, _EMERGENCY),
    ),
}


class SimulatedSupervisor:
    """Arms itself with brushed motors; with brushless ones a client arms it, and it monitors their rotors.

    `can_fly`: the app's commands take effect. `motors_may_run`: the stabilizer drives motors, at least at idle thrust.
    `flying`: until 2 s after the last thrust. `tumbled`: it lay on its side or its back at the last update.
    `stopped`: an emergency stop, which only a power cycle ends. `bits` is the state word that the firmware reports.
    """

    def __init__(self, parameters: Mapping[str, float], *, arms_itself: bool) -> None:
        """Start as at power-on. `parameters` are the vehicle's, which include time limits."""
        self.state = SupervisorState.NOT_INITIALIZED
        self.can_fly = self.motors_may_run = self.flying = False
        self.armed = self.crashed = self.tumbled = self.stopped = False
        self.bits = 0
        self._parameters = parameters
        self._arms_itself = arms_itself
        self._entered_ms = 0
        self._watched_ms: int | None = None  # when the emergency stop's watchdog was last fed
        self._thrust_ms: int | None = None
        self._tilted_ms: int | None = None
        self._spinning_ms: int | None = None
        self._blocked_ms: int | None = None
        self._landed_ms: int | None = None

    def request_arming(self, arm: bool) -> bool:
        """Arm or disarm; return whether that was granted."""
        if arm and not self.armed and self.state is not SupervisorState.PASSED:
            return False
        self.armed = arm
        return True

    def recover(self) -> bool:
        """Clear the crashed state of a vehicle that was put upright; return whether it is cleared."""
        self.crashed = self.crashed and self.tumbled
        return not self.crashed

    def update(
        self,
        now_ms: int,
        *,
        acc_z_g: float,
        setpoint_ms: int,
        motors: Four,
        idle: int,
        rotors_rpm: Sequence[float],
    ) -> None:
        """Gather the conditions, make at most one transition, and renew the bits.

        `setpoint_ms` is when the setpoint in force arrived. `rotors_rpm` is empty where nothing reports speeds.
        """
        if max(motors) > idle:
            self._thrust_ms = now_ms
        self.tumbled = self._is_tumbled(now_ms, acc_z_g)
        conditions = self._conditions(now_ms, setpoint_ms) | self._rotor_conditions(now_ms, rotors_rpm)
        entered = next((rule.to for rule in _RULES[self.state] if rule.applies(conditions)), self.state)
        if entered is not self.state:
            self._enter(entered, now_ms)
        self.bits = self._reported_bits()

    def settled_until(self, now_ms: int, *, acc_z_g: float) -> int | None:
        """Return until when no update changes anything while motors are off and no client acts, None for no limit."""
        moving = self._is_flying(now_ms) or acc_z_g < _TILTED_G or self.tumbled
        if moving or self._emergency(now_ms) or self._watched_ms is not None:
            return None if self.state is SupervisorState.LOCKED else now_ms
        if self.state is SupervisorState.READY and self.armed:
            return self._entered_ms + int(self._parameters["supervisor.prefltTimeout"])
        if self.state is SupervisorState.LOCKED or (self.state is SupervisorState.PASSED and not self.armed):
            return None
        return now_ms

    def answer(self, channel: int, payload: bytes, now_ms: int) -> bytes | None:
        """Return the answer on the same channel, None for none."""
        if not payload:
            return None
        command = payload[0]
        if channel == INFO_CHANNEL and 0 < command <= _ALL_BITS:
            single = bytes([self.bits >> (command - 1) & 1])
            return bytes([_ANSWER | command]) + (self.bits.to_bytes(2, "little") if command == _ALL_BITS else single)
        if channel != _COMMAND_CHANNEL:
            return None
        if command == _EMERGENCY_STOP:
            self.stopped = True
        if command == _WATCHDOG:
            self._watched_ms = now_ms
        if command == _ARM:
            return bytes([_ANSWER | command, self.request_arming(payload[1:2] not in (b"", b"\0")), self.armed])
        if command == _RECOVER:
            return bytes([_ANSWER | command, self.recover(), not self.crashed])
        return None

    def _is_tumbled(self, now_ms: int, acc_z_g: float) -> bool:
        """Return whether the vehicle lay on its side for 1 s or on its back for 0.1 s, if that check is enabled."""
        if acc_z_g >= _TILTED_G:
            self._tilted_ms = None
            return False
        if self._tilted_ms is None:
            self._tilted_ms = now_ms
        limit_ms = _UPSIDE_DOWN_MS if acc_z_g < _UPSIDE_DOWN_G else _TILTED_MS
        return now_ms - self._tilted_ms > limit_ms and bool(self._parameters["supervisor.tmblChckEn"])

    def _is_flying(self, now_ms: int) -> bool:
        return self._thrust_ms is not None and now_ms - self._thrust_ms < _FLYING_MS

    def _emergency(self, now_ms: int) -> bool:
        expired = self._watched_ms is not None and now_ms >= self._watched_ms + _WATCHDOG_MS
        return self.stopped or expired or bool(self._parameters["stabilizer.stop"])

    def _conditions(self, now_ms: int, setpoint_ms: int) -> int:
        limits, in_state_ms = self._parameters, now_ms - self._entered_ms
        # While it cannot fly, the firmware passes its supervisor the empty setpoint of power-on.
        age_ms = now_ms - (setpoint_ms if self.can_fly else 0)
        spins_up, ready = self.state is SupervisorState.ARMING, self.state is SupervisorState.READY
        conditions = {
            _ARMED: self.armed,
            _IS_FLYING: self._is_flying(now_ms),
            _TUMBLED: self.tumbled,
            _OLD_SETPOINT: age_ms > _OLD_MS,
            _TOO_OLD_SETPOINT: age_ms > _TOO_OLD_MS,
            _EMERGENCY: self._emergency(now_ms),
            _CRASHED: self.crashed,
            _PREFLIGHT_TIMEOUT: ready and in_state_ms > limits["supervisor.prefltTimeout"],
            _SPINUP_TIMEOUT: spins_up and in_state_ms > limits["supervisor.spinupTimeout"],
            _LANDED_TIMEOUT: (
                self._landed_ms is not None and now_ms - self._landed_ms > limits["supervisor.landedTimeout"]
            ),
        }
        return sum(condition for condition, holds in conditions.items() if holds)

    def _rotor_conditions(self, now_ms: int, rotors_rpm: Sequence[float]) -> int:
        """Check the rotors' speeds while they spin up, and for blocked rotors while the vehicle may fly."""
        if not rotors_rpm:
            return _ROTORS_SPIN_UP
        speeds = [int(rpm) for rpm in rotors_rpm]
        spinning = self.state is SupervisorState.ARMING and all(speed in _SPINNING_RPM for speed in speeds)
        blocked = self.can_fly and any(speed in _BLOCKED_RPM for speed in speeds)
        self._spinning_ms = (self._spinning_ms or now_ms) if spinning else None
        self._blocked_ms = (self._blocked_ms or now_ms) if blocked else None
        spun_up = self._spinning_ms is not None and now_ms - self._spinning_ms >= _ROTORS_MS
        stays_blocked = self._blocked_ms is not None and now_ms - self._blocked_ms >= _ROTORS_MS
        return _ROTORS_SPIN_UP * spun_up | _ROTOR_BLOCKED * stays_blocked

    def _enter(self, state: SupervisorState, now_ms: int) -> None:
        self.state, self._entered_ms = state, now_ms
        self.can_fly, self.motors_may_run = state in _CAN_FLY, state in _MOTORS_MAY_RUN
        self.flying = state in (SupervisorState.FLYING, SupervisorState.LEVEL_OUT)
        self._spinning_ms = self._blocked_ms = None
        if state is SupervisorState.LANDED:
            self._landed_ms = now_ms
        if state is SupervisorState.CRASHED:
            self.crashed = True
        if not self.motors_may_run:
            self.armed = self._arms_itself and state is SupervisorState.PASSED

    def _reported_bits(self) -> int:
        flags = (
            self.state is SupervisorState.PASSED,
            self.armed,
            self._arms_itself,
            self.can_fly,
            self.flying,
            self.tumbled,
            self.state is SupervisorState.LOCKED,
            self.crashed,
        )
        return sum(flag << place for place, flag in enumerate(flags)) | _TRAJECTORY_FINISHED
