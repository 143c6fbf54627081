"""How fast rotors follow a command that always changes, as in flight."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.motors.lag.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
