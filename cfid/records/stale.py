"""Find out whether a fit is still current: whether its recordings or the facts in rig.toml have changed since."""

from collections.abc import Callable, Sequence
from functools import cache
from math import isclose
from pathlib import Path
from typing import Any

from cfid.errors import DataError
from cfid.records.files import RIG_FILE, RUN_FILE, RUNS_FOLDER, sha256_of
from cfid.records.parameters import Section, Source, runs_of
from cfid.records.rig_file import Rig, stated
from cfid.records.run import Run, read_run

Stale = Callable[[Section], tuple[str, ...]]


def stale_in(folder: Path, runs: Sequence[Run], rig: Rig) -> Stale:
    """Return a function that gives, as sentences, why a section of a campaign is no longer current.

    A missing file is not a reason; a run.toml that cannot be read is one, since it may exclude the run. `rig` is the
    campaign's rig.toml as it is now.
    """
    excluded = {run.folder.name: run.header.excluded for run in runs if run.header.excluded}
    now_states = {run.folder.name: run.header.stated_sha256 for run in runs}

    @cache
    def has_changed(source: Source) -> bool:
        path = folder / source.path
        try:
            state = path.stat()
            return _hash_of(path, state.st_size, state.st_mtime_ns, state.st_ino) != source.sha256
        except (DataError, OSError, ValueError):
            return False

    @cache
    def is_torn(run: Path) -> bool:
        try:
            return (run / RUN_FILE).exists() and not read_run(run)
        except (DataError, OSError):
            return True

    def present(section: Section) -> dict[str, str]:
        """Return the present names of a section's runs by those that they had: a folder may have been renamed."""
        names = {state: name for name, state in now_states.items()}
        return {name: name if name in now_states else names.get(was, name) for name, was in section.runs.items()}

    def reasons(section: Section) -> tuple[str, ...]:
        names = present(section)
        other = [source.path for source in section.sources if has_changed(source)]
        other += [f"{RUNS_FOLDER}/{n}/{RUN_FILE}" for n, was in section.runs.items() if now_states.get(n, was) != was]
        unread = [name for name in section.runs if name not in now_states]
        other += [f"{RUNS_FOLDER}/{name}/{RUN_FILE}" for name in unread if is_torn(folder / RUNS_FOLDER / name)]
        fitted = [names.get(name, name) for name in runs_of(section.sources)]
        left = [f"{name} ({excluded[name]})" for name in fitted if name in excluded]
        now = stated(rig, section.rig)
        facts = [f"{key} {_change(was, now.get(key))}" for key, was in section.rig.items() if now.get(key) != was]
        return (
            *([f"Made with another {RIG_FILE}: {'; '.join(facts)}: fit again."] if facts else []),
            *([f"Changed since it was fitted: {', '.join(other)}: fit again."] if other else []),
            *([f"Fitted to runs that are now excluded: {', '.join(left)}: fit again without them."] if left else []),
        )

    return reasons


@cache
def _hash_of(path: Path, *state: int) -> str:
    """Return the hash of a file, which is read again only in another state."""
    return sha256_of(path)


def other_facts(section: Section, rig: Rig) -> str:
    """Return a sentence on the facts of a fit that rig.toml now states differently, "" where it states the same.

    Such a fit is not stale: recordings keep what rig.toml stated at the time, so fitting them again changes nothing.
    """
    now = stated(rig, section.facts)
    other = {key: (was, now[key]) for key, was in section.facts.items() if key in now and not isclose(was, now[key])}
    if not other:
        return ""
    differing = ", ".join(f"{key} {was:g}, where {RIG_FILE} states {number:g}" for key, (was, number) in other.items())
    options = " ".join(f"--{key.rpartition('.')[2].replace('_', '-')} {number:g}" for key, (_, number) in other.items())
    return (
        f"fitted with {differing}. Recordings keep what {RIG_FILE} stated when they were made: if that was wrong, fit "
        f"again with {options}."
    )


def _change(was: Any, now: Any) -> str:
    """Return how a fact changed: a number with both values, while a table is too long for a sentence."""
    if now is None:
        return "is gone"
    return f"was {was:g}, is {now:g}" if isinstance(was, float) and isinstance(now, float) else "has changed"
