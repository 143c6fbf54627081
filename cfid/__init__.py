"""cfid measures the physical parameters of a Crazyflie quadrocopter, with their uncertainties.

campaign = cfid.open_campaign("cfid-demo")
result = cfid.swing.fit(campaign.run("last swing"))
"""

from typing import TYPE_CHECKING

from cfid.lazy import attached
from cfid.version import __version__ as __version__

if TYPE_CHECKING:
    from cfid import drag, flight, friction, inertia, latency, loadcell, motors, swing, transfer
    from cfid.recordings.read import read_recording
    from cfid.records.campaign import open_campaign
    from cfid.records.run import read_run

__all__ = [
    "drag",
    "flight",
    "friction",
    "inertia",
    "latency",
    "loadcell",
    "motors",
    "open_campaign",
    "read_recording",
    "read_run",
    "swing",
    "transfer",
]

__getattr__, __dir__ = attached(
    __name__,
    {
        **dict.fromkeys(__all__, ""),
        "open_campaign": "records.campaign",
        "read_recording": "recordings.read",
        "read_run": "records.run",
    },
)
