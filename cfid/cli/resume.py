"""What an interrupted run of a sweep lacks."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from cfid.rig.procedures import Staircase


def missing(stairs: "Staircase", folder: Path) -> "Staircase":
    """Return the staircase of a run without the steps that it held to their end.

    Raises ConfigError when the run is no staircase, or lacks nothing.
    """
    import pandas as pd

    from cfid.run import read_run

    run = read_run(folder)
    try:
        asked = run.header.asked
        before = replace(
            stairs,
            steps=tuple(asked["steps"]),
            motors=tuple(asked["motors"]),
            hold_s=asked["hold_s"],
            rest_s=asked["rest_s"],
        )
    except KeyError:
        raise ConfigError(f"{folder}: is no staircase that could be resumed.") from None
    try:
        rows = pd.read_csv(run.device_file("commands"))
    except (OSError, ValueError):
        raise DataError(f"{run.device_file('commands')}: cannot be read.") from None
    column = f"m{before.motors[0]}"
    held_s = rows["t"].shift(-1) - rows["t"]
    done = Counter(rows.loc[held_s >= 0.98 * before.hold_s, column].astype(int))
    left = tuple(step for step in before.steps if not _was_held(step, done))
    if run.header.state == "complete" or not left:
        raise ConfigError(f"{folder}: lacks nothing.")
    return replace(before, steps=left)


def _was_held(step: int, done: Counter[int]) -> bool:
    """Return whether a step was held and take it off; a step of zero is like the rests, and is held again."""
    if step == 0 or not done[step]:
        return False
    done[step] -= 1
    return True
