"""How fast rotors turn, from the vibration that the load cell feels."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.motors.vibration.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
