"""Round trips to the vehicle, and its clock against this computer's."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.latency.result import fit as fit

__getattr__, __dir__ = attached(__name__, {"fit": "result"})
