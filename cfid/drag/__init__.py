"""Fit drag coefficients to forces measured in wind."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.drag.data import read_forces as read_forces
    from cfid.drag.data import read_index as read_index
    from cfid.drag.data import read_runs as read_runs
    from cfid.drag.result import fit as fit

__getattr__, __dir__ = attached(
    __name__, {"fit": "result", "read_forces": "data", "read_index": "data", "read_runs": "data"}
)
