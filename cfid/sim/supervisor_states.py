"""Defines the states of the firmware's supervisor (release 2026.08) and the transitions between them.

Conditions are bits of an integer, so that checking all of them is cheap.
"""

from enum import Enum
from typing import NamedTuple


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


CAN_FLY = {SupervisorState.READY, SupervisorState.FLYING, SupervisorState.LANDED, SupervisorState.LEVEL_OUT}
MOTORS_MAY_RUN = CAN_FLY | {SupervisorState.ARMING}

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
ROTORS_SPIN_UP = 1 << 10  # all rotors turned fast enough for long enough, or report no speed
ROTOR_BLOCKED = 1 << 11


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
_RULES: dict[SupervisorState, tuple[_Rule, ...]] = {
    SupervisorState.NOT_INITIALIZED: (_Rule(SupervisorState.NOT_PASSED, none_of=_ALWAYS),),
    SupervisorState.NOT_PASSED: (
        _Rule(SupervisorState.FREE_FALL, EMERGENCY),
        _Rule(SupervisorState.PASSED, none_of=TUMBLED),
    ),
    SupervisorState.PASSED: (
        _Rule(SupervisorState.FREE_FALL, EMERGENCY),
        _Rule(SupervisorState.NOT_PASSED, TUMBLED),
        _Rule(SupervisorState.ARMING, ARMED),
    ),
    SupervisorState.ARMING: (
        _Rule(SupervisorState.FREE_FALL, EMERGENCY),
        _Rule(SupervisorState.NOT_PASSED, TUMBLED | SPINUP_TIMEOUT, missing=ARMED),
        _Rule(SupervisorState.READY, ROTORS_SPIN_UP),
    ),
    SupervisorState.READY: (
        _Rule(SupervisorState.FREE_FALL, EMERGENCY | ROTOR_BLOCKED),
        _Rule(SupervisorState.NOT_PASSED, TUMBLED | PREFLIGHT_TIMEOUT, missing=ARMED),
        _Rule(SupervisorState.FLYING, IS_FLYING),
    ),
    SupervisorState.FLYING: (
        _Rule(SupervisorState.FREE_FALL, TOO_OLD_SETPOINT | EMERGENCY | ROTOR_BLOCKED),
        _Rule(SupervisorState.CRASHED, TUMBLED),
        _Rule(SupervisorState.RESET, missing=ARMED),
        _Rule(SupervisorState.LEVEL_OUT, OLD_SETPOINT),
        _Rule(SupervisorState.LANDED, missing=IS_FLYING),
    ),
    SupervisorState.LANDED: (
        _Rule(SupervisorState.RESET, LANDED_TIMEOUT, missing=ARMED),
        _Rule(SupervisorState.FREE_FALL, ROTOR_BLOCKED),
        _Rule(SupervisorState.FLYING, IS_FLYING),
    ),
    SupervisorState.RESET: (_Rule(SupervisorState.NOT_PASSED, none_of=_ALWAYS),),
    SupervisorState.LEVEL_OUT: (
        _Rule(SupervisorState.FREE_FALL, TOO_OLD_SETPOINT | TUMBLED | EMERGENCY | ROTOR_BLOCKED),
        _Rule(SupervisorState.FLYING, none_of=OLD_SETPOINT | TOO_OLD_SETPOINT),
    ),
    SupervisorState.FREE_FALL: (_Rule(SupervisorState.LOCKED, none_of=_ALWAYS),),
    SupervisorState.LOCKED: (),
    SupervisorState.CRASHED: (
        _Rule(SupervisorState.NOT_PASSED, none_of=CRASHED | TUMBLED),
        _Rule(SupervisorState.LOCKED, EMERGENCY),
    ),
}


def next_state(state: SupervisorState, conditions: int) -> SupervisorState:
    """Return the state after an update with these conditions: the first rule that applies decides."""
    return next((rule.to for rule in _RULES[state] if rule.applies(conditions)), state)
