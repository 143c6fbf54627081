"""Find runs that complete one another by `--resume`, and the steps of a staircase that they have and lack."""

from collections import Counter
from collections.abc import Sequence

from cfid.recordings.vehicle import COMMANDS, HELD_SHARE, READINGS, TakenBackError, holds, read_commands, read_rows
from cfid.records.files import RUN_FILE
from cfid.records.run import Run, list_runs, read_run

RESUMES = "resumes"  # in run.toml: the name of the run that a run completes


def resumed_by(run: Run) -> str:
    """Return the name of the run that a run completes, "" for none."""
    return str(run.header.requested.get(RESUMES, ""))


def with_completed(run: Run) -> list[Run]:
    """Return the runs that a run completes, oldest first, and the run itself last; the search ends at an excluded run.

    Raises DataError where the run.toml of one of them is invalid.
    """
    parts, names = [run], {run.folder.resolve().name}
    while (before := resumed_by(parts[0])) and before not in names:
        folder = run.folder.resolve().parent / before
        if not (folder / RUN_FILE).is_file() or (part := read_run(folder)).header.excluded:
            break
        parts.insert(0, part)
        names.add(before)
    return parts


def completing(run: Run, among: Sequence[Run]) -> list[Run]:
    """Return the runs in `among` that complete a run, directly or one after another, oldest first."""
    found: dict[str, Run] = {}
    names = {run.folder.resolve().name}
    while names:
        after = {one.folder.resolve().name: one for one in among if resumed_by(one) in names}
        names = after.keys() - found.keys()
        found |= after
    return sorted(found.values(), key=lambda one: one.place)


def recorded_after(run: Run) -> list[Run]:
    """Return the runs in a run's parent folder that complete it, except those excluded or judged not usable."""
    beside = [one for one in list_runs(run.folder.resolve().parent) if isinstance(one, Run)]
    return completing(run, [one for one in beside if not one.header.excluded and one.outcome != "not usable"])


def steps_left(run: Run) -> tuple[int, ...]:
    """Return the commands of a run's staircase that have no typed reading, or were not held to their end.

    Whether they were held counts only where no reading was requested. Raises as `held_steps`.
    """
    done = Counter(_read_steps(run) if READINGS in run.header.devices else held_steps(run))
    return tuple(step for step in map(int, run.header.requested["steps"]) if not _was_done(step, done))


def steps_lacking(run: Run, later: Sequence[Run]) -> tuple[int, ...]:
    """Return the commands that a run lacks and that the runs in `later`, which complete it, have not recorded either.

    Raises as `held_steps`.
    """
    done = sum((recorded_steps(one) for one in later), Counter[int]())
    return tuple(step for step in steps_left(run) if not _was_done(step, done))


def recorded_steps(run: Run) -> Counter[int]:
    """Return the commands that `--resume` would not repeat: all of a complete run. Raises as `held_steps`."""
    steps = Counter(map(int, run.header.requested["steps"]))
    return steps if run.header.state == "complete" else steps - Counter(steps_left(run))


def steps_read_later(run: Run, among: Sequence[Run]) -> frozenset[int]:
    """Return the commands with a typed reading in a run of `among` that completes a run, directly or one after another.

    Raises DataError where their rows cannot be read.
    """
    return frozenset(step for later in completing(run, among) for step in _read_steps(later))


def _read_steps(run: Run) -> list[int]:
    """Return the commands that have a typed reading that was not taken back."""
    try:
        return read_rows(run, READINGS).columns["command"].astype(int).tolist() if holds(run, READINGS) else []
    except TakenBackError:
        return []


def held_steps(run: Run) -> list[int]:
    """Return the commands of a run's staircase that were held to their end, in any order.

    Raises KeyError for a run without a staircase, TypeError or ValueError where the request has anything but
    numbers, DataError where the run's rows cannot be read.
    """
    if not holds(run, COMMANDS):
        return []
    rows, commands = read_commands(run)
    request = run.header.requested
    column = commands[:-1, int(request["motors"][0]) - 1]
    long_enough = rows.time_s[1:] - rows.time_s[:-1] >= HELD_SHARE * float(request["hold_s"])
    done = Counter(column[long_enough].astype(int).tolist())
    return [step for step in map(int, request["steps"]) if _was_done(step, done)]


def _was_done(step: int, done: Counter[int]) -> bool:
    """Return whether a step was done; if so, `done` counts one less of it."""
    if not done[step]:
        return False
    done[step] -= 1
    return True
