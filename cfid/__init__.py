"""cfid measures the physical parameters of a Crazyflie quadrocopter, with their uncertainties.

campaign = cfid.open_campaign("cfid-demo")
result = cfid.swing.fit(campaign.run("last swing"))
"""

from typing import TYPE_CHECKING

from cfid.lazy import attached
from cfid.version import __version__ as __version__

if TYPE_CHECKING:
    from cfid import drag, flight, friction, inertia, latency, loadcell, motors, swing, transfer
    from cfid.records.campaign import open_campaign
    from cfid.records.run import read_run
    from cfid.records.tables.any_kind import read_table

__all__ = [
    "drag",
    "flight",
    "friction",
    "inertia",
    "latency",
    "loadcell",
    "motors",
    "open_campaign",
    "read_run",
    "read_table",
    "swing",
    "transfer",
]

__getattr__, __dir__ = attached(
    __name__,
    {
        **dict.fromkeys(__all__, ""),
        "open_campaign": "records.campaign",
        "read_run": "records.run",
        "read_table": "records.tables.any_kind",
    },
)
