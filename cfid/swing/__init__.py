"""Fit a free swing: its natural frequency, damping and axis inertia."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.swing.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
