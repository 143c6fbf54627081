"""Verification of the thrust map with scales under the vehicle (section 3.3.1, figure 3.9)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError, FitError
from cfid.estimate.common_causes import force_scales, scales_of_weights
from cfid.findings import Finding, warning
from cfid.motors.maps.data import Stand
from cfid.motors.maps.estimation import MotorMap
from cfid.motors.weighing import Weighing, weighing_of
from cfid.recordings.stand import holds_stand, read_stand, stand_of
from cfid.records.rig_file import RigFacts
from cfid.records.run import run_at
from cfid.units import DEAD_COMMAND

Array = npt.NDArray[np.float64]

_DIFFERS = 0.1  # rms over the map's largest thrust there; different batteries cause a few hundredths


def read_scales(path: Path, stand: Stand) -> Weighing:
    """Read a run of scales with the runs that it completes, or a table. Raises DataError."""
    run = run_at(path)
    if run is not None and not holds_stand(path):
        return weighing_of(run)
    table = stand_of(read_stand(path))
    if table.grams is None:
        raise DataError(f"{path}: no column 'grams': the scales' display at each cmd.")
    return Weighing(command=table.command, grams=table.grams, motors=stand.motors or 1, facts=stand.facts)


@dataclass(frozen=True, kw_only=True)
class ScalesCheck:
    """Thrusts (n,) of one motor by another instrument, and by the map, whose thrust is zero up to command 1000.

    `difference_n` is instrument less map. `rms_n` and `rms_percent`, relative to the map, are over the points of a
    running motor. `gain` is the instrument's thrust over the map's, by least squares. Its standard uncertainty contains
    the scatter of the points and the scales of both instruments; it is nan for fewer than three points.
    """

    command: Array
    thrust_n: Array
    map_n: Array
    difference_n: Array
    rms_n: float
    rms_percent: float
    gain: float
    gain_std: float

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A warning where scales and map differ by more than batteries and scales explain: one of them is wrong."""
        largest_n = float(np.abs(self.map_n).max())
        if self.rms_n <= _DIFFERS * largest_n:
            return ()
        text = (
            f"the scales differ from the map by {1e3 * self.rms_n:.3g} mN rms, {100 * self.rms_n / largest_n:.0f} % of "
            f"its largest thrust there (limit {100 * _DIFFERS:.0f} %), and show {self.gain:.2f} times the map's "
            "thrust: one of the two is wrong. Check the number of motors, the batteries, and that nothing touched the "
            "scales."
        )
        return (warning("scales-differ", text, "motor.thrust_poly"),)


def verify_thrust(
    thrust_map: MotorMap, *, command: Array, thrust_n: Array, scale_stds: Sequence[float] = ()
) -> ScalesCheck:
    """Compare thrusts (n,) of one motor with the map at their commands (n,).

    `scale_stds` are the relative standard uncertainties of the scales of both instruments.

    Raises FitError when no motor ran.
    """
    running = command > DEAD_COMMAND
    if not running.any():
        raise FitError(f"nothing to verify the map with: no reading above command {DEAD_COMMAND}.")
    expected = np.where(running, thrust_map.fit.at(command), 0.0)
    ours, theirs = expected[running], thrust_n[running]
    gain = float(ours @ theirs / (ours @ ours))
    free = len(ours) - 1
    scatter = float(np.sum((theirs - gain * ours) ** 2)) / free if free > 1 else math.nan
    return ScalesCheck(
        command=command,
        thrust_n=thrust_n,
        map_n=expected,
        difference_n=thrust_n - expected,
        rms_n=float(np.sqrt(np.mean((theirs - ours) ** 2))),
        rms_percent=100 * float(np.sqrt(np.mean((theirs / ours - 1) ** 2))),
        gain=gain,
        gain_std=math.hypot(math.sqrt(scatter / float(ours @ ours)), *(gain * std for std in scale_stds)),
    )


def verified(
    mapped: MotorMap, scales: Sequence[Path], stand: Stand, loadcells: Sequence[RigFacts], gravity_mps2: float
) -> tuple[ScalesCheck | None, Sequence[Finding]]:
    """Compare a map with scales, from runs or tables; a run that another one completes is taken with that one.

    Raises DataError.
    """
    weighings = [read_scales(path, stand) for path in dict.fromkeys(scales)]
    parts = [set(weighing.parts) for weighing in weighings]
    weighings = [
        one
        for one, names in zip(weighings, parts, strict=True)
        if not (names and any(names < other for other in parts))
    ]
    if not weighings:
        return None, ()
    causes = [*scales_of_weights([weighing.facts for weighing in weighings]), *force_scales(loadcells)]
    stds = [cause.std for cause in causes if cause.std is not None]
    try:
        thrust_n = np.concatenate([weighing.thrust_n(gravity_mps2) for weighing in weighings])
        command = np.concatenate([weighing.command for weighing in weighings])
        check = verify_thrust(mapped, command=command, thrust_n=thrust_n, scale_stds=stds)
    except FitError as error:
        return None, (warning("scales-not-comparable", f"the map is not verified: {error}"),)
    return check, check.findings
