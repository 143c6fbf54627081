"""How fast rotors follow their commands: one rotor model for steps, staircases, logs and stands."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.motors.rotor.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
