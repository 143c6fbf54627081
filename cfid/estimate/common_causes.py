"""Propagate causes of error that all values of a fit share, such as the scales of instruments, to a result.

A scale error e with relative standard uncertainty s multiplies the instrument's readings by 1 + e, in every fit on this
rig alike. A quantity that is proportional to the n-th power of the instrument's unit changes by n s times its value per
standard uncertainty: this is its effect. The effects add to standard uncertainties in squares, and their outer product
adds to covariances; `common` stores them by the name of the cause, so that the covariance of two fits is known.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.findings import note
from cfid.quantities.registry import Shape, find
from cfid.records.covariances import Covariance, numbers_of, shaped_as
from cfid.records.parameters import Parameter, plain
from cfid.records.result import Dependent, Result
from cfid.records.rig_file import LoadCellMount, RigFacts

Array = npt.NDArray[np.float64]

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


class Cause(NamedTuple):
    """A cause of error: the name under which fits share it, and its standard uncertainty, None where not stated."""

    name: str
    std: float | None


Effects = Mapping[Cause, Mapping[str, Array]]  # of one standard uncertainty, on each value of a key
Measured = Mapping[str, Mapping[Cause, float]]  # by unit: the powers with which its readings depend on causes
Powers = Mapping[str, Mapping[str, float]]  # by key or pattern: the powers with which it depends on units


def force_scales(rigs: Sequence[RigFacts]) -> dict[Cause, float]:
    """Return the causes that a thrust on the load cells of rigs depends on, with their powers."""
    return _powers({gain(rigs, "Fz"): 1, linearity(rigs): 1}, rigs)


def torque_scales(rigs: Sequence[RigFacts]) -> dict[Cause, float]:
    """Return the causes that a torque about z on the load cells of rigs depends on, with their powers."""
    return _powers({gain(rigs, "Tz"): 1, linearity(rigs): 1}, rigs)


def gain(rigs: Sequence[RigFacts], *axes: str) -> Cause:
    """Return as one cause the gain of axes of the rigs' load cells, for axes with a common error."""
    stated = [rig.loadcell.gain_std for rig in rigs]
    stds = [None if std is None else max(std[AXES.index(axis)] for axis in axes) for std in stated]
    return _widest(f"gain of {' and '.join(axes)}", stds)


def arm_scales(rigs: Sequence[RigFacts]) -> dict[Cause, float]:
    """Return the causes of a force computed as torque over an arm, which contains cross-talk of the force, with powers.

    Each rig states its arm.
    """

    def over_arm(cell: LoadCellMount, std: float | None) -> float | None:
        return None if std is None or cell.arm_mm is None else std / cell.arm_mm

    cells = [rig.loadcell for rig in rigs]
    arm = _widest("arm", [over_arm(cell, cell.arm_std_mm) for cell in cells])
    talk = _widest(
        "cross-talk of Fz into Tx and Ty",
        [None if (part := over_arm(cell, cell.cross_talk_std_nm_per_n)) is None else 1e3 * part for cell in cells],
    )
    return _powers({gain(rigs, "Tx", "Ty"): 1, linearity(rigs): 1, arm: -1, talk: 1}, rigs)


def thrust_in_torque(rigs: Sequence[RigFacts], *, key: str, count: int) -> Effects:
    """Return the effect on a polynomial (count,) of torque over thrust of the cell's cross-talk from thrust to torque.

    The cross-talk adds to the slope, in N m per N; the highest power comes first.
    """
    talk = _widest("cross-talk of Fz into Tz", [rig.loadcell.cross_talk_std_nm_per_n for rig in rigs])
    return {talk: {key: (talk.std or 0.0) * np.eye(count)[-2]}} if rigs else {}


def tachometer_scales(rigs: Sequence[RigFacts]) -> dict[Cause, float]:
    """Return the causes that a speed from the tachometers of rigs depends on, with their powers."""
    return _powers({_widest("tachometer", [rig.tachometer.scale_std for rig in rigs]): 1}, rigs)


def anemometer_scales(rigs: Sequence[RigFacts]) -> dict[Cause, float]:
    """Return the causes that a wind speed from the anemometers of rigs depends on, with their powers."""
    return _powers({_widest("anemometer", [rig.wind.speed_scale_std for rig in rigs]): 1}, rigs)


def linearity(rigs: Sequence[RigFacts]) -> Cause:
    """Return the linearity of the load cells of rigs as a cause."""
    return _widest("linearity of the load cell", [rig.loadcell.linearity_std for rig in rigs])


def scales_of_weights(rigs: Sequence[RigFacts]) -> dict[Cause, float]:
    """Return the causes that a mass from the scales of rigs depends on, with their powers."""
    return _powers({_widest("scales", [rig.scales.linearity_std for rig in rigs]): 1}, rigs)


def force_cross_talk(rigs: Sequence[RigFacts]) -> list[tuple[Cause, tuple[int, int]]]:
    """Return the causes of cross-talk between forces, each with its two axes: first the one that shows it."""
    stds = [rig.loadcell.cross_talk_std for rig in rigs]
    return [
        (_widest(f"cross-talk of F{'xyz'[acting]} into F{'xyz'[shown]}", stds), (shown, acting))
        for shown, acting in permutations(range(3), 2)
    ]


def angles(rigs: Sequence[RigFacts]) -> tuple[Cause, Cause]:
    """Return the load cell's yaw and the wind generator's azimuth as causes, in degrees."""
    yaw = _widest("yaw of the load cell", [rig.loadcell.yaw_std_deg for rig in rigs])
    return yaw, _widest("azimuth of the wind", [rig.wind.azimuth_std_deg for rig in rigs])


def moved_by(found: Mapping[str, Parameter], moved: Mapping[str, Parameter]) -> dict[str, Array]:
    """Return the effects of a cause that changes quantities to `moved`, on those with a standard uncertainty."""
    return {
        key: np.subtract(numbers_of(key, plain(moved[key].value)), numbers_of(key, plain(quantity.value)))
        for key, quantity in found.items()
        if quantity.std is not None and key in moved
    }


def power_law(quantities: Mapping[str, Parameter], measured: Measured, powers: Powers) -> Effects:
    """Return the effects on quantities: on polynomials by the registry's `of` and `over`, on others by `powers`."""
    effects: dict[Cause, dict[str, Array]] = {}
    for key, quantity in quantities.items():
        if quantity.std is None:
            continue
        values = np.array(numbers_of(key, plain(quantity.value)), dtype=np.float64)
        for unit, exponents in _exponents(key, len(values), powers).items():
            for cause, power in measured.get(unit, {}).items():
                moved = effects.setdefault(cause, {})
                moved[key] = moved.get(key, np.zeros(len(values))) + power * exponents * values * (cause.std or 0.0)
    return effects


def with_common_causes(result: Result, *effects: Effects) -> Result:
    """Return a result with the effects of causes added to its uncertainties, covariances, budget and lines.

    A cause without a stated uncertainty has no effect, and a note names it. Quantities without a standard uncertainty
    do not change.
    """
    together: dict[Cause, dict[str, Array]] = {}
    for cause, key, numbers in ((c, k, n) for part in effects for c, moved in part.items() for k, n in moved.items()):
        moved = together.setdefault(cause, {})
        moved[key] = moved[key] + numbers if key in moved else numbers
    common = {
        cause.name: changes
        for cause, moved in together.items()
        if cause.std and (changes := {key: numbers for key, numbers in moved.items() if np.any(numbers)})
    }
    exact = [cause.name for cause in together if cause.std is None]
    text = f"taken as exact: {', '.join(exact)}: no standard uncertainty is stated."
    return replace(
        result,
        quantities={key: _widened(key, quantity, common) for key, quantity in result.quantities.items()},
        covariances=tuple(_with_outer(block, result.quantities, common) for block in result.covariances),
        common={
            **result.common,
            **{name: {key: numbers.tolist() for key, numbers in moved.items()} for name, moved in common.items()},
        },
        merits={**result.merits, "common_causes": _budget(result.quantities, common)} if common else result.merits,
        findings=(*result.findings, *([note("scale-taken-as-exact", text)] if exact else [])),
        lines=(*result.lines, *_lines(result, common)),
    )


def _widest(name: str, stds: Sequence[float | None]) -> Cause:
    return Cause(name, max((std for std in stds if std is not None), default=None))


def _powers(found: dict[Cause, float], rigs: Sequence[RigFacts]) -> dict[Cause, float]:
    """Return the causes; none if no rig's instrument was used."""
    return found if rigs else {}


def _exponents(key: str, count: int, powers: Powers) -> dict[str, Array]:
    """Return the powers (count,) with which the values of a key depend on each unit."""
    found = find(key)
    if found is not None and found.shape is Shape.POLYNOMIAL:
        over = np.arange(count) if found.lowest_first else np.arange(count)[::-1]
        return {found.of: np.ones(count), found.over: -over.astype(np.float64)}
    stated = next((one for pattern, one in powers.items() if fnmatchcase(key, pattern)), {})
    return {unit: np.full(count, float(power)) for unit, power in stated.items()}


def _widened(key: str, quantity: Parameter, common: Mapping[str, Mapping[str, Array]]) -> Parameter:
    effects = [moved[key] for moved in common.values() if key in moved]
    if quantity.std is None or not effects:
        return quantity
    own = np.array([math.nan if one is None else one for one in numbers_of(key, plain(quantity.std))])
    std = np.sqrt(own**2 + np.sum(np.square(effects), axis=0))
    return replace(quantity, std=shaped_as(key, std.tolist(), plain(quantity.value)))


def _with_outer(
    block: Covariance, quantities: Mapping[str, Parameter], common: Mapping[str, Mapping[str, Array]]
) -> Covariance:
    sizes = [len(numbers_of(key, plain(quantities[key].value))) for key in block.of]
    matrix = np.array(block.matrix)
    for moved in common.values():
        effect = np.concatenate([moved.get(key, np.zeros(size)) for key, size in zip(block.of, sizes, strict=True)])
        matrix += np.outer(effect, effect)
    return replace(block, matrix=tuple(tuple(row) for row in matrix.tolist()))


def _budget(quantities: Mapping[str, Parameter], common: Mapping[str, Mapping[str, Array]]) -> dict[str, Any]:
    """Return for each quantity the standard uncertainty of the fit itself and the contribution of each cause."""
    keys = dict.fromkeys(key for moved in common.values() for key in moved)
    return {
        key: Dependent(
            {
                "fit": plain(quantities[key].std),
                **{
                    name: shaped_as(key, np.abs(moved[key]).tolist(), plain(quantities[key].value))
                    for name, moved in common.items()
                    if key in moved
                },
            },
            key,
        )
        for key in keys
    }


def _lines(result: Result, common: Mapping[str, Mapping[str, Array]]) -> list[Dependent]:
    """Return one line per cause: the change of the wanted quantities by one standard uncertainty of it."""
    wanted = [key for key in result.quantities if any(fnmatchcase(key, one) for one in result.wanted or ("*",))]
    lines = []
    for name, moved in common.items():
        parts = {key: _percent(moved[key], result.quantities[key].value, key) for key in wanted if key in moved}
        if parts:
            lines.append(Dependent(f"  {name}: {', '.join(f'{key} {part}' for key, part in parts.items())}", *parts))
    head = "systematic effects, their part of the standard uncertainties:"
    return [Dependent(head, *lines[0].quantities), *lines] if lines else []


def _percent(moved: Array, value: Any, key: str) -> str:
    """Return the relative change of a value by a cause; for several coefficients, the largest below 100 %.

    Any cause changes a constant near 0 by thousands of per cent, which has no meaning for the curve.
    """
    values = np.array(numbers_of(key, plain(value)), dtype=np.float64)
    part = np.abs(moved[values != 0] / values[values != 0]) if np.any(values) else np.zeros(1)
    clear = part[part < 1] if np.any(part < 1) else part
    most = 100 * float(clear.max())
    text = f"{most:.2g} %" if most < 100 else f"{most:.0f} %"
    if len(clear) < len(part):
        return f"up to {text} of a coefficient that is not near 0"
    return text if np.ptp(part) < 1e-9 else f"up to {text} of a coefficient"
