"""Flight logs to thrust, lag, moments of inertia and drag, and parameter sets against flights they have not seen."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.flight.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
