"""Coulomb and viscous friction of the swing's axis, from dropped weights."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.friction.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
