"""How fast rotors follow steps of the command."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.motors.steps.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
