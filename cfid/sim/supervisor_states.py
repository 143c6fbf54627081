"""The states of the firmware's supervisor (release 2026.08) and the transitions between them.

Conditions are bits of an integer, so that a look at all of them costs next to nothing.
"""

from enum import Enum
from typing import NamedTuple


class State(Enum):
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


CAN_FLY = {State.READY, State.FLYING, State.LANDED, State.LEVEL_OUT}
MOTORS_MAY_RUN = CAN_FLY | {State.ARMING}

ARMED = 1 << 0
IS_FLYING = 1 << 1
TUMBLED = 1 << 2
OLD_SETPOINT = 1 << 3
TOO_OLD_SETPOINT = 1 << 4
EMERGENCY = 1 << 5
CRASHED = 1 << 6
PREFLIGHT_TIMEOUT = 1 << 7
LANDED_TIMEOUT = 1 << 8
SPINUP_TIMEOUT = 1 << 9
ROTORS_SPIN_UP = 1 << 10  # all of them, fast enough and long enough, or nobody watches them
ROTOR_BLOCKED = 1 << 11


class _Rule(NamedTuple):
    """Leads to a state where any condition of `any_of` holds, `missing` does not, or no one of `none_of` does."""

    to: State
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
_RULES: dict[State, tuple[_Rule, ...]] = {
    State.NOT_INITIALIZED: (_Rule(State.NOT_PASSED, none_of=_ALWAYS),),
    State.NOT_PASSED: (_Rule(State.FREE_FALL, EMERGENCY), _Rule(State.PASSED, none_of=TUMBLED)),
    State.PASSED: (_Rule(State.FREE_FALL, EMERGENCY), _Rule(State.NOT_PASSED, TUMBLED), _Rule(State.ARMING, ARMED)),
    State.ARMING: (
        _Rule(State.FREE_FALL, EMERGENCY),
        _Rule(State.NOT_PASSED, TUMBLED | SPINUP_TIMEOUT, missing=ARMED),
        _Rule(State.READY, ROTORS_SPIN_UP),
    ),
    State.READY: (
        _Rule(State.FREE_FALL, EMERGENCY | ROTOR_BLOCKED),
        _Rule(State.NOT_PASSED, TUMBLED | PREFLIGHT_TIMEOUT, missing=ARMED),
        _Rule(State.FLYING, IS_FLYING),
    ),
    State.FLYING: (
        _Rule(State.FREE_FALL, TOO_OLD_SETPOINT | EMERGENCY | ROTOR_BLOCKED),
        _Rule(State.CRASHED, TUMBLED),
        _Rule(State.RESET, missing=ARMED),
        _Rule(State.LEVEL_OUT, OLD_SETPOINT),
        _Rule(State.LANDED, missing=IS_FLYING),
    ),
    State.LANDED: (
        _Rule(State.RESET, LANDED_TIMEOUT, missing=ARMED),
        _Rule(State.FREE_FALL, ROTOR_BLOCKED),
        _Rule(State.FLYING, IS_FLYING),
    ),
    State.RESET: (_Rule(State.NOT_PASSED, none_of=_ALWAYS),),
    State.LEVEL_OUT: (
        _Rule(State.FREE_FALL, TOO_OLD_SETPOINT | TUMBLED | EMERGENCY | ROTOR_BLOCKED),
        _Rule(State.FLYING, none_of=OLD_SETPOINT | TOO_OLD_SETPOINT),
    ),
    State.FREE_FALL: (_Rule(State.LOCKED, none_of=_ALWAYS),),
    State.LOCKED: (),
    State.CRASHED: (_Rule(State.NOT_PASSED, none_of=CRASHED | TUMBLED), _Rule(State.LOCKED, EMERGENCY)),
}


def next_state(state: State, conditions: int) -> State:
    """Return the state after a look that finds these conditions: the first rule that applies decides."""
    return next((rule.to for rule in _RULES[state] if rule.applies(conditions)), state)
