"""Rotor speeds, estimated from the vibration in a load cell's record."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.motors.vibration.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
