"""Finds the shortest period at which a link passes nearly every row of the vehicle's log, by trying."""

from collections.abc import Callable, Mapping, Sequence

from cfid.errors import DeviceError
from cfid.rig.clock import HostClock
from cfid.rig.loop import Ending, Loop, run_until_done
from cfid.rig.ready_vehicle import ReadyVehicle
from cfid.rig.recorder import Recorder

PERIODS_MS = (1, 2, 5, 10)
LARGEST_LOSS = 0.01
_TRIAL_S = 2.0


def fastest_period_ms(vehicle: ReadyVehicle, names: Sequence[str]) -> tuple[int, Mapping[int, float]]:
    """Return the shortest of PERIODS_MS that loses less than LARGEST_LOSS of the rows, and each loss measured.

    Raises DeviceError when the longest loses more too, KeyboardInterrupt when a signal ends the trials.
    """
    return shortest(lambda period_ms: _loss(vehicle, names, period_ms), uri=vehicle.uri)


def shortest(loss_at: Callable[[int], float], *, uri: str) -> tuple[int, Mapping[int, float]]:
    """Return the shortest period whose loss, as tried by `loss_at`, is small enough. Raises DeviceError if none is."""
    losses: dict[int, float] = {}
    for period_ms in PERIODS_MS:
        losses[period_ms] = loss_at(period_ms)
        if losses[period_ms] < LARGEST_LOSS:
            return period_ms, losses
    raise DeviceError(
        f"{uri}: the link loses {100 * losses[PERIODS_MS[-1]]:.0f} % of rows that are {PERIODS_MS[-1]} ms "
        f"apart (limit {100 * LARGEST_LOSS:g} %). Bring the vehicle closer, change the channel, use its USB cable, or "
        "choose `log_ms` and accept the losses."
    )


def _loss(vehicle: ReadyVehicle, names: Sequence[str], period_ms: int) -> float:
    """Return the fraction of a trial's rows that is lost, whether on the way or never sent."""
    device = vehicle.log(names, period_ms=period_ms)

    async def main(loop: Loop, ending: Ending) -> float:
        instrument = device.open(loop, HostClock.now())
        recorder = Recorder([instrument], None, loop=loop, show=lambda: None)
        await recorder.record(lambda: ending.within(_TRIAL_S))
        if ending.signal:
            raise KeyboardInterrupt
        came = recorder.progress[instrument.name]
        lost = came.lost or 0
        return lost / (came.rows + lost) if came.rows else 1.0

    return run_until_done(main)
