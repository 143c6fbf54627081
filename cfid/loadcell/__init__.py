"""Known weights hung on the load cell at known places to its gains, cross-talk and linearity."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.loadcell.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
