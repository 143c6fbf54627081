"""Runs that complete one another: an interrupted run, and those that `--resume` recorded after it."""

from cfid.records.run import RUN_FILE, Run, read_run

RESUMES = "resumes"  # in run.toml: the name of the run that a run completes


def resumed_by(run: Run) -> str:
    """Return the name of the run that a run completes, "" for none."""
    return str(run.header.requested.get(RESUMES, ""))


def with_completed(run: Run) -> list[Run]:
    """Return a run after those that it completes, the first one first; an excluded one ends them.

    Raises DataError where the run.toml of one is invalid.
    """
    parts, names = [run], {run.folder.resolve().name}
    while (before := resumed_by(parts[0])) and before not in names:
        folder = run.folder.resolve().parent / before
        if not (folder / RUN_FILE).is_file() or (part := read_run(folder)).header.excluded:
            break
        parts.insert(0, part)
        names.add(before)
    return parts
