"""Gains, cross-talk and linearity of the load cell, from known weights hung on it at known places."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.loadcell.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
