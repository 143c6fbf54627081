"""The thesis' wind campaign: which 112 runs it is made of (section 4.4.2), and which of them are still missing."""

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

THESIS_COMMANDS = (0, 10000, 20000, 30000, 37300, 40000, 50000)


class WindSetting(NamedTuple):
    """One place and voltage of the wind generator, and the lowest and highest wind the thesis read there."""

    angle_deg: float
    fan_v: float
    min_mps: float
    max_mps: float


class PlannedRun(NamedTuple):
    """One run of a campaign; a reference, without wind, has neither angle nor voltage."""

    command: int
    angle_deg: float | None = None
    fan_v: float = 0.0


# C.3.1, v_abs; the first two were read once.
THESIS_WINDS = (
    WindSetting(0.0, 5, 1.5, 1.5),
    WindSetting(0.0, 6, 2.25, 2.25),
    WindSetting(0.0, 8, 2.8, 3.6),
    WindSetting(0.0, 10, 3.1, 4.2),
    WindSetting(0.0, 12, 3.7, 5.1),
    WindSetting(48.4, 5, 1.0, 1.8),
    WindSetting(48.4, 6, 1.6, 2.8),
    WindSetting(48.4, 8, 2.0, 3.7),
    WindSetting(48.4, 10, 2.8, 4.3),
    WindSetting(48.4, 12, 3.3, 5.0),
    WindSetting(77.9, 5, 1.4, 1.8),
    WindSetting(77.9, 6, 1.8, 2.5),
    WindSetting(77.9, 8, 2.2, 3.4),
    WindSetting(77.9, 10, 2.6, 4.0),
    WindSetting(77.9, 12, 3.0, 4.5),
)


def thesis_plan() -> tuple[PlannedRun, ...]:
    """Return the 112 runs in the order of section 4.4.2: seven references, then setting by setting."""
    references = [PlannedRun(command) for command in THESIS_COMMANDS]
    winds = [
        PlannedRun(command, setting.angle_deg, setting.fan_v) for setting in THESIS_WINDS for command in THESIS_COMMANDS
    ]
    return (*references, *winds)


def missing_runs(done: Iterable[PlannedRun], plan: Iterable[PlannedRun] = thesis_plan()) -> tuple[PlannedRun, ...]:
    """Return what of a plan, in its order, has not been recorded; runs beside the plan do not count."""
    left = Counter(done)
    missing = []
    for run in plan:
        if left[run] > 0:
            left[run] -= 1
        else:
            missing.append(run)
    return tuple(missing)
