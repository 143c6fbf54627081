"""Judge a sine as soon as it is recorded: whether its reports arrived, and whether the load cell measures it."""

from cfid.errors import FitError
from cfid.recordings.wrench import LOADCELL
from cfid.records.run import Run
from cfid.transfer.sines.alignment import align
from cfid.transfer.sines.data import read_sines
from cfid.transfer.sines.during import CLEAR, SineSums, not_felt
from cfid.transfer.sines.plan import CUTOFF_HZ


def verdict(run: Run) -> str:
    """State how clearly the load cell measures a sine. Raises DataError or FitError if not, or for missing reports."""
    axes, motor = run.header.devices[LOADCELL].columns, run.header.requested.get("motor")
    sines = read_sines([run], channel="arm" if motor and {"Tx", "Ty"} <= set(axes) else "Fz")  # all motors: no torque
    (played,) = align(sines.runs).runs
    if not played.sine.periods:
        return f"a constant command, thrust {1e3 * played.force_n.mean():.1f} mN."
    during = (played.time_s > 0) & (played.time_s < played.duration_s)
    force_n, phase = played.force_n[during], played.frequency_rad_s * played.time_s[during]
    sums = SineSums()
    sums.add(phase, force_n - force_n.mean())
    amplitude_n, std_n = sums.amplitude()
    if amplitude_n < CLEAR * std_n:
        raise FitError(not_felt(amplitude_n, std_n))
    left_out = (
        f" Above the cut-off of {CUTOFF_HZ:g} Hz: `cfid tf identify` leaves it out unless `cutoff_hz` is raised."
        if played.sine.is_above(CUTOFF_HZ)
        else ""
    )
    return f"{1e3 * amplitude_n:.3g} mN at its frequency, {amplitude_n / std_n:.0f} times the noise there.{left_out}"
