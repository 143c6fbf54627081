"""Readings of scales under a vehicle, in runs and tables, compared with a thrust map (section 3.3.1, figure 3.9)."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cfid.errors import DataError, FitError
from cfid.estimate.common_causes import force_scales, scales_of_weights
from cfid.findings import Finding, note, warning
from cfid.motors.maps.estimation import MotorMap
from cfid.motors.maps.evidence import Stand
from cfid.motors.maps.scales import ScalesCheck, scales_findings, scales_thrust_n, verify_thrust
from cfid.motors.points import Array
from cfid.recordings.resumed import with_completed
from cfid.recordings.stand import holds_stand, read_stand, stand_of
from cfid.recordings.vehicle import READINGS, SCALES, TakenBackError, holds, read_rows, shown_at_commands
from cfid.records.rig_file import RigFacts
from cfid.records.run import Run, run_at
from cfid.units import DEAD_COMMAND


@dataclass(frozen=True, kw_only=True)
class Weighing:
    """Commands (n,), grams (n,) that scales showed, how many motors ran, and the facts of the rig.

    `rest_g` (n,) is the weight at rest with which each reading is compared, None where that is the mean of the readings
    at rest. `parts` maps the name of each run to its commands.
    """

    command: Array
    grams: Array
    motors: int
    facts: RigFacts
    rest_g: Array | None = None
    parts: Mapping[str, Array] = field(default_factory=dict)

    def thrust_n(self, gravity_mps2: float) -> Array:
        """Return one motor's thrusts (n,). Raises as `scales_thrust_n`."""
        return scales_thrust_n(
            self.command, self.grams, motors=self.motors, gravity_mps2=gravity_mps2, rest_g=self.rest_g
        )


def read_scales(path: Path, stand: Stand) -> Weighing:
    """Read a run of scales with the runs that it completes, or a table. Raises DataError."""
    run = run_at(path)
    if run is not None and not holds_stand(path):
        return weighing_of(run)
    table = stand_of(read_stand(path))
    if table.grams is None:
        raise DataError(f"{path}: no column 'grams': the scales' display at each cmd.")
    return Weighing(command=table.command, grams=table.grams, motors=stand.motors or 1, facts=stand.facts)


def weighing_of(run: Run) -> Weighing:
    """Return what scales showed in a run and in those that it completes.

    Each part is compared with its own weight at rest, since the vehicle may have been set down anew; a part without a
    reading at rest is compared with that of the part before. Raises DataError.
    """
    shown: dict[str, tuple[Array, Array]] = {}
    for part in with_completed(run)[:-1]:
        with suppress(TakenBackError):
            if holds(part, READINGS) or holds(part, SCALES):
                shown[part.folder.resolve().name] = _shown_by_scales(part)
    shown[run.folder.resolve().name] = _shown_by_scales(run)
    command, grams = (np.concatenate(column) for column in zip(*shown.values(), strict=True))
    return Weighing(
        command=command,
        grams=grams,
        motors=len(run.header.requested.get("motors", ())) or 1,
        facts=run.header.rig,
        rest_g=_rest_g(list(shown.values())),
        parts={name: own for name, (own, _) in shown.items()},
    )


def _rest_g(parts: Sequence[tuple[Array, Array]]) -> Array:
    """Return the weight at rest (n,) for each reading of some parts, nan where no part has one."""
    own = [float(grams[at].mean()) if (at := command <= DEAD_COMMAND).any() else None for command, grams in parts]
    rest_g, found = next((one for one in own if one is not None), np.nan), list[Array]()
    for one, (command, _) in zip(own, parts, strict=True):
        rest_g = rest_g if one is None else one
        found.append(np.full(len(command), rest_g))
    return np.concatenate(found)


def _shown_by_scales(run: Run) -> tuple[Array, Array]:
    """Return commands (n,) and grams (n,): typed readings, or means of those in the second half of each step."""
    if holds(run, READINGS):
        rows = read_rows(run, READINGS)
        if "grams" not in rows.columns:
            raise DataError(f"{rows.source.path}: no column 'grams': this is no run of `cfid log scales`.")
        return rows.columns["command"], rows.columns["grams"]
    if not holds(run, SCALES):
        raise DataError(f"{run.folder}: holds no scales: `cfid log scales` records them.")
    _, command, grams = shown_at_commands(run, SCALES, "grams")
    return command, grams


def verified(
    mapped: MotorMap, scales: Sequence[Path], stand: Stand, loadcells: Sequence[RigFacts], gravity_mps2: float
) -> tuple[ScalesCheck | None, Sequence[Finding]]:
    """Compare a map with scales, from runs or tables; a run that another one completes is taken with that one.

    Raises DataError.
    """
    read = [read_scales(path, stand) for path in dict.fromkeys(scales)]
    read = [one for one in read if not (one.parts and any(set(one.parts) < set(other.parts) for other in read))]
    if not read:
        return None, ()
    causes = [*scales_of_weights([one.facts for one in read]), *force_scales(loadcells)]
    stds = [cause.std for cause in causes if cause.std is not None]
    together = [
        note("scales-together", f"{', '.join(one.parts)}: parts of one staircase of scales, taken together.")
        for one in read
        if len(one.parts) > 1
    ]
    try:
        thrust_n = np.concatenate([one.thrust_n(gravity_mps2) for one in read])
        command = np.concatenate([one.command for one in read])
        check = verify_thrust(mapped, command=command, thrust_n=thrust_n, scale_stds=stds)
    except FitError as error:
        return None, (*together, warning("scales-not-comparable", f"the map is not verified: {error}"))
    return check, (*together, *scales_findings(check))
