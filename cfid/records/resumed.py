"""Find runs that complete one another: an interrupted run, and those that `--resume` recorded after it."""

from collections.abc import Sequence

from cfid.records.run import RUN_FILE, Run, list_runs, read_run

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
    """Return the runs in `among` that complete a run, directly or one after another, in the order of their names."""
    found: dict[str, Run] = {}
    names = {run.folder.resolve().name}
    while names:
        after = {one.folder.resolve().name: one for one in among if resumed_by(one) in names}
        names = after.keys() - found.keys()
        found |= after
    return [found[name] for name in sorted(found)]


def recorded_after(run: Run) -> list[Run]:
    """Return the runs in a run's parent folder that complete it, except those excluded or judged not usable."""
    beside = [one for one in list_runs(run.folder.resolve().parent) if isinstance(one, Run)]
    return completing(run, [one for one in beside if not one.header.excluded and one.outcome != "not usable"])
