"""Records round trips of pings to the vehicle (section 3.4.4)."""

from collections.abc import Callable
from contextlib import ExitStack

from cfid.console.live import LiveLine
from cfid.console.recording import Found, Rig, record
from cfid.console.run_summary import Judge
from cfid.console.vehicle import reach
from cfid.records.rig_file import RigFacts
from cfid.records.run import Label
from cfid.rig.hardware import Hardware
from cfid.rig.pings import Pings
from cfid.rig.run import Plan


def record_pings(
    *,
    count: int,
    every_s: float,
    rig: Rig,
    uri: str | None,
    note: str | None,
    judge: Judge,
    found: Found,
) -> None:
    """Record `count` round trips, one begun every `every_s` seconds. Raises DeviceError."""
    campaign = rig.campaign
    live = LiveLine()
    with ExitStack() as held:
        crazyflie = reach(uri, rig, held)
        crazyflie.refuse_driven()
        plan = Plan(
            runs_folder=campaign.runs_folder,
            kind="ping",
            label=Label(note=note),
            procedure=lambda there, hardware: ping_often(
                there["pings"], count=count, every_s=every_s, hardware=hardware, tell=live.task
            ),
            lasts_s=count * every_s,
            facts=RigFacts(lab_book=campaign.rig.lab_book),
            requested={"count": count, "interval_s": every_s},
            simulated=rig.simulated,
        )
        record("log ping", plan, [crazyflie.pings()], live, hardware=rig.hardware, judge=judge, found=found)


async def ping_often(
    pings: Pings, *, count: int, every_s: float, hardware: Hardware, tell: Callable[[str], None]
) -> None:
    """Send pings on a grid of times, one after another (C.2.6)."""
    began_s = hardware.seconds()
    for number in range(count):
        tell(f"ping {number + 1} of {count}")
        await pings.ping()
        await hardware.sleep(max(began_s + (number + 1) * every_s - hardware.seconds(), 0.0))
