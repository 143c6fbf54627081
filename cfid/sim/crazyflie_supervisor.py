"""Simulates the firmware's supervisor: 25 times a second it checks its conditions, which decide its state.

Times are the ticks that the firmware counts, milliseconds since power-on. The parameters motorPowerSet bypass it.
"""

from collections.abc import Mapping, Sequence

from cfid.sim import supervisor_states as states
from cfid.sim.propulsion import Four
from cfid.sim.supervisor_states import CAN_FLY, MOTORS_MAY_RUN, SupervisorState, next_state

UPDATE_STEPS = 40  # of the stabilizer's loop
INFO_CHANNEL = 0

_FLYING_MS = 2000  # since the last command above idle thrust
_OLD_MS, _TOO_OLD_MS = 500, 2000
_WATCHDOG_MS = 1000
_TILTED_G, _TILTED_MS = 0.5, 1000
_UPSIDE_DOWN_G, _UPSIDE_DOWN_MS = -0.2, 100
_ROTORS_MS = 200
_SPINNING_RPM, _BLOCKED_RPM = range(1000, 3501), range(1, 500)

_COMMAND_CHANNEL = 1
_ANSWER = 0x80
_ALL_BITS = 0x0C  # commands below it ask for a single bit
_ARM, _RECOVER, _EMERGENCY_STOP, _WATCHDOG = 1, 2, 3, 4
_TRAJECTORY_FINISHED = 1 << 9  # of the high-level commander, which never flies here


class SimulatedSupervisor:
    """Arms itself with brushed motors; with brushless ones a client arms it, and it monitors their rotors.

    `can_fly`: the app's commands take effect. `motors_may_run`: the stabilizer drives motors, at least at idle thrust.
    `flying`: until 2 s after the last thrust. `tumbled`: it lay on its side or its back at the last update.
    """

    def __init__(self, parameters: Mapping[str, float], *, arms_itself: bool) -> None:
        """Start as at power-on. `parameters` are the vehicle's, which include time limits."""
        self.state = SupervisorState.NOT_INITIALIZED
        self.can_fly = self.motors_may_run = self.flying = False
        self.bits = 0
        self._parameters = parameters
        self._arms_itself = arms_itself
        self.armed = self.crashed = self.tumbled = False
        self._stopped = False
        self._watched_ms: int | None = None  # when the emergency stop's watchdog was last fed
        self._thrust_ms: int | None = None
        self._tilted_ms: int | None = None
        self._spinning_ms: int | None = None
        self._blocked_ms: int | None = None
        self._entered_ms = 0
        self._landed_ms: int | None = None

    def stop_for_good(self) -> None:
        """Take an emergency stop, which only a power cycle ends."""
        self._stopped = True

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
        entered = next_state(self.state, conditions)
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
            self.stop_for_good()
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
        return self._stopped or expired or bool(self._parameters["stabilizer.stop"])

    def _conditions(self, now_ms: int, setpoint_ms: int) -> int:
        limits, in_state_ms = self._parameters, now_ms - self._entered_ms
        # While it cannot fly, the firmware passes its supervisor the empty setpoint of power-on.
        age_ms = now_ms - (setpoint_ms if self.can_fly else 0)
        spins_up, ready = self.state is SupervisorState.ARMING, self.state is SupervisorState.READY
        found = {
            states.ARMED: self.armed,
            states.IS_FLYING: self._is_flying(now_ms),
            states.TUMBLED: self.tumbled,
            states.OLD_SETPOINT: age_ms > _OLD_MS,
            states.TOO_OLD_SETPOINT: age_ms > _TOO_OLD_MS,
            states.EMERGENCY: self._emergency(now_ms),
            states.CRASHED: self.crashed,
            states.PREFLIGHT_TIMEOUT: ready and in_state_ms > limits["supervisor.prefltTimeout"],
            states.SPINUP_TIMEOUT: spins_up and in_state_ms > limits["supervisor.spinupTimeout"],
            states.LANDED_TIMEOUT: (
                self._landed_ms is not None and now_ms - self._landed_ms > limits["supervisor.landedTimeout"]
            ),
        }
        return sum(condition for condition, holds in found.items() if holds)

    def _rotor_conditions(self, now_ms: int, rotors_rpm: Sequence[float]) -> int:
        """Check the rotors' speeds while they spin up, and for blocked rotors while the vehicle may fly."""
        if not rotors_rpm:
            return states.ROTORS_SPIN_UP
        speeds = [int(rpm) for rpm in rotors_rpm]
        spinning = self.state is SupervisorState.ARMING and all(speed in _SPINNING_RPM for speed in speeds)
        blocked = self.can_fly and any(speed in _BLOCKED_RPM for speed in speeds)
        self._spinning_ms = (self._spinning_ms or now_ms) if spinning else None
        self._blocked_ms = (self._blocked_ms or now_ms) if blocked else None
        found = 0
        if self._spinning_ms is not None and now_ms - self._spinning_ms >= _ROTORS_MS:
            found |= states.ROTORS_SPIN_UP
        if self._blocked_ms is not None and now_ms - self._blocked_ms >= _ROTORS_MS:
            found |= states.ROTOR_BLOCKED
        return found

    def _enter(self, state: SupervisorState, now_ms: int) -> None:
        self.state, self._entered_ms = state, now_ms
        self.can_fly, self.motors_may_run = state in CAN_FLY, state in MOTORS_MAY_RUN
        self.flying = state in (SupervisorState.FLYING, SupervisorState.LEVEL_OUT)
        self._spinning_ms = self._blocked_ms = None
        if state is SupervisorState.LANDED:
            self._landed_ms = now_ms
        if state is SupervisorState.CRASHED:
            self.crashed = True
        if not self.motors_may_run:
            self.armed = self._arms_itself and state is SupervisorState.PASSED

    def _reported_bits(self) -> int:
        """Return the state word that the firmware reports."""
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
