"""Judges a dropped weight as soon as it is recorded, with the fit that will use it."""

from cfid.errors import FitError
from cfid.friction.result import fit
from cfid.records.rig_file import thesis_rig
from cfid.records.run import Run


def verdict(run: Run) -> str:
    """Return how a recorded weight fell, whatever rig.toml states. Raises DataError or FitError where it gives nothing.

    That one weight alone gives no friction is no fault of the recording.
    """
    (drop,) = fit([run], rig=thesis_rig()).quantities["friction.runs"].value
    if not drop["settled"]:
        raise FitError("the speed never settles: let the weight fall farther, and see that the axis turns evenly.")
    window = f"from {drop['from_s']:.2f} to {drop['to_s']:.2f} s"
    return (
        f"{drop['weight_g']:g} g: {drop['speed_rad_per_s']:.1f} rad/s {window}, tends to "
        f"{drop['terminal_rad_per_s']:.1f} rad/s."
    )
