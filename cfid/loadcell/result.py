"""Gain, cross-talk and linearity of the load cell: quantities, findings, lines, and keys of rig.toml."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import ConfigError, DataError
from cfid.estimate.common_causes import Cause, power_law, scales_of_weights, with_common_causes
from cfid.findings import Finding, note, rejection
from cfid.loadcell.data import LoadedRun, loads_of, read_load
from cfid.loadcell.estimation import AXES, AxisFit, fit_axes
from cfid.records.covariances import Covariance, covariance_between
from cfid.records.parameters import Parameter
from cfid.records.result import Result
from cfid.records.run import Run
from cfid.units import MM, USUAL_GRAVITY_MPS2

Array = npt.NDArray[np.float64]

AT_STD_MM = 0.2  # of a place marked with a calliper
_OFF = 0.05  # of the gain: beyond, the wrong calibration is active or a label is wrong
_SCATTER = 5.0  # misfit in standard uncertainties: beyond, a label is wrong or something touches
_BENT = 3.0  # standard uncertainties: beyond, a bend is reported
_OF_A_LOAD = {"kg": -1.0, "m/s^2": -1.0}
_POWERS = {"loadcell.gain.*": _OF_A_LOAD, "loadcell.cross_talk*": _OF_A_LOAD}


def fit(
    runs: Sequence[LoadedRun | Run | Path | str],
    *,
    gravity_mps2: float = USUAL_GRAVITY_MPS2,
    gravity_std_mps2: float = 0.0,
    at_std_m: float = MM * AT_STD_MM,
) -> Result:
    """Fit what the load cell shows of known weights hung at known places, in one orientation or several.

    Each run's label has the weight, the axis of the cell along which gravity points, and the place. `at_std_m` is the
    standard uncertainty of each place whose label states none. Raises ConfigError for no run, DataError for a run
    without such a label or named twice, FitError where the loads determine no gain.
    """
    loaded = [run if isinstance(run, LoadedRun) else read_load(run) for run in runs]
    if not loaded:
        raise ConfigError("no loaded run to read: give runs of `cfid log loadcell` with `pull`.")
    for place, run in enumerate(loaded):
        if any(run.source.sha256 == before.source.sha256 for before in loaded[:place]):
            raise DataError(f"{run.name}: the same recording as before: name each run once.")
    found = fit_axes(loads_of(loaded, gravity_mps2=gravity_mps2, at_std_m=at_std_m))
    result = Result(
        command="fit loadcell",
        method="default",
        quantities={key: one for fit in found.values() for key, one in _quantities(fit).items()},
        wanted=("loadcell.gain.*",),
        covariances=tuple(one for fit in found.values() for one in _covariances(fit)),
        merits={"runs": len(loaded), "misfit": {axis: fit.misfit for axis, fit in found.items()}},
        findings=(
            *(finding for run in loaded for finding in run.findings),
            *(finding for fit in found.values() for finding in _findings(fit)),
            *_not_determined(found),
        ),
        sources=tuple(run.source for run in loaded),
        rests_on=("site",),
        lines=tuple(_line(run, gravity_mps2) for run in loaded),
    )
    gravity = {Cause("gravity", gravity_std_mps2 / gravity_mps2): 1.0}
    measured = {"kg": scales_of_weights([run.rig for run in loaded]), "m/s^2": gravity}
    return with_common_causes(result, power_law(result.quantities, measured, _POWERS))


def rig_keys(result: Result, *, gain: Sequence[float] | None, gain_std: Sequence[float] | None) -> dict[str, Any]:
    """Return the keys of rig.toml's table of the load cell that an accepted result replaces.

    Axes that were not measured keep the `gain` (6,) and `gain_std` (6,) that rig.toml states, else 1 and 0. Cross-talk
    is not corrected for: its size counts as standard uncertainty, and so does that of a bend.
    """
    given = {key: one for key, one in result.quantities.items() if key not in result.rejected}
    gains, stds = list(gain or np.ones(6).tolist()), list(gain_std or np.zeros(6).tolist())
    for place, axis in enumerate(AXES):
        if (found := given.get(f"loadcell.gain.{axis}")) is not None:
            gains[place], stds[place] = round(float(found.value), 6), _shortened(float(found.std) / float(found.value))
    sizes = {
        "linearity_std": [one / math.sqrt(3) for one in _sizes(given, "loadcell.linearity.")],  # 0 to its whole size
        "cross_talk_std": _sizes(given, "loadcell.cross_talk_force."),
        "cross_talk_std_nm_per_n": _sizes(given, "loadcell.cross_talk_nm_per_n."),
    }
    keys = {key: _shortened(float(np.sqrt(np.mean(np.square(each))))) for key, each in sizes.items() if each}
    return {"gain": gains, **({"gain_std": stds} if all(stds) else {}), **keys}


def _sizes(given: Mapping[str, Parameter], prefix: str) -> list[float]:
    return [math.hypot(float(one.value), float(one.std)) for key, one in given.items() if key.startswith(prefix)]


def _shortened(number: float) -> float:
    return float(f"{number:.2g}")


def _quantities(fit: AxisFit) -> dict[str, Parameter]:
    std = np.sqrt(np.diag(fit.covariance)).tolist()
    found = zip(_keys(fit), fit.values.tolist(), std, strict=True)
    return {key: Parameter(value=value, std=one) for key, value, one in found}


def _keys(fit: AxisFit) -> list[str]:
    bend = [] if math.isnan(fit.linearity) else [f"loadcell.linearity.{fit.axis}"]
    return [f"loadcell.gain.{fit.axis}", *bend, *(_talk_key(acting, fit.axis) for acting in fit.acting)]


def _talk_key(acting: str, shown: str) -> str:
    kinds = {"ff": "force", "ft": "nm_per_n", "tf": "n_per_nm", "tt": "torque"}
    return f"loadcell.cross_talk_{kinds[acting[0] + shown[0]]}.{acting}_into_{shown}"


def _covariances(fit: AxisFit) -> tuple[Covariance, ...]:
    return covariance_between(dict(zip(_keys(fit), fit.values.tolist(), strict=True)), fit.covariance)


def _findings(fit: AxisFit) -> list[Finding]:
    key, found = f"loadcell.gain.{fit.axis}", list[Finding]()
    if abs(fit.gain - 1) > _OFF:
        text = (
            f"{fit.axis.capitalize()} shows {100 * fit.gain:.1f} % of the load (limit {100 * _OFF:.0f} % from 100 %): "
            "check the weight, the place and the axis of each run, and which calibration is active in the box."
        )
        found.append(rejection("loadcell-gain-off", text, key))
    if fit.misfit > _SCATTER:
        text = (
            f"{fit.axis.capitalize()} scatters {fit.misfit:.1f} times as far as stated about its line (limit "
            f"{_SCATTER:g}): a weight or a place is wrong, or something touches."
        )
        found.append(rejection("loadcell-misfit", text, *_keys(fit)))
    std = math.nan if math.isnan(fit.linearity) else math.sqrt(fit.covariance[1, 1])
    if abs(fit.linearity) > _BENT * std:
        text = (
            f"the gain of {fit.axis.capitalize()} changes by {100 * fit.linearity:.2g} % up to the largest load; it is "
            "given for small loads."
        )
        found.append(note("loadcell-bent", text, key))
    return found


def _not_determined(found: Mapping[str, AxisFit]) -> list[Finding]:
    missing = [axis.capitalize() for axis in AXES if axis not in found]
    if not missing:
        return []
    text = (
        f"the loads do not determine the gain of {', '.join(missing)}: hang weights at other places, and turn the cell "
        "on its side."
    )
    return [note("loadcell-axes-missing", text)]


def _line(run: LoadedRun, gravity_mps2: float) -> str:
    place = ", ".join(f"{1e3 * each:g}" for each in run.at_m.tolist())
    force, torque = (np.linalg.norm(part) for part in np.split(run.load(gravity_mps2), 2))
    return (
        f"{run.name}: {1e3 * run.weight_kg:g} g along {run.pull} at {place} mm: {force:.4g} N, {1e3 * torque:.4g} N mm"
    )
