"""Fit thrust, lag, moments of inertia and drag to flight logs."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.flight.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
