"""The vehicle's supervisor: whether its motors may run, and what the supervisor port answers.

It knows the states in which a vehicle that is fastened can be. Parameters motorPowerSet do not ask it.
"""

_INFO_CHANNEL, _COMMAND_CHANNEL = 0, 1
_ANSWER = 0x80
_ALL_BITS = 0x0C  # commands below it ask for a single bit
_ARM, _RECOVER, _EMERGENCY_STOP = 1, 2, 3


class Supervisor:
    """Armed by itself with brushed motors; with brushless ones when it is told to."""

    def __init__(self, *, arms_itself: bool) -> None:
        """Stand upright and still."""
        self.tumbled = False
        self.flying = False
        self._arms_itself = arms_itself
        self._armed = arms_itself
        self._crashed = False
        self._locked = False

    @property
    def allowed(self) -> bool:
        """Whether motors may run."""
        return self._armed and self._upright

    @property
    def bits(self) -> int:
        """The state as the firmware tells it, from the lowest bit on.

        Can be armed, is armed, arms itself, can fly, is flying, is tumbled, is locked, is crashed.
        """
        flags = (
            self._upright and not self._armed,
            self._armed,
            self._arms_itself,
            self.allowed,
            self.flying,
            self.tumbled,
            self._locked,
            self._crashed,
        )
        return sum(flag << place for place, flag in enumerate(flags))

    def tumble(self) -> None:
        """Fall over, and stay so: it is disarmed and can only be put up again."""
        self.tumbled = self._crashed = True
        self._armed = False

    def stop_for_good(self) -> None:
        """Take an emergency stop: only a new start helps."""
        self._locked = True
        self._armed = False

    def answer(self, channel: int, payload: bytes) -> bytes | None:
        """Return what comes back on the same channel, None for nothing."""
        if not payload:
            return None
        command = payload[0]
        if channel == _INFO_CHANNEL and 0 < command <= _ALL_BITS:
            single = bytes([self.bits >> (command - 1) & 1])
            return bytes([_ANSWER | command]) + (self.bits.to_bytes(2, "little") if command == _ALL_BITS else single)
        if channel != _COMMAND_CHANNEL:
            return None
        if command == _EMERGENCY_STOP:
            self.stop_for_good()
        if command == _ARM:
            return bytes([_ANSWER | command, *self._arm(payload[1:2] not in (b"", b"\0"))])
        if command == _RECOVER:
            self._crashed = self._crashed and self.tumbled
            self._armed = self.allowed or (self._arms_itself and self._upright)
            return bytes([_ANSWER | command, not self._crashed, not self._crashed])
        return None

    @property
    def _upright(self) -> bool:
        return not (self.tumbled or self._crashed or self._locked)

    def _arm(self, wanted: bool) -> tuple[bool, bool]:
        """Return whether that can be, and whether it is armed then; one that arms itself is so again at once."""
        possible = self._upright or not wanted
        armed = wanted and possible
        self._armed = armed or (self._arms_itself and self._upright)
        return possible, armed
