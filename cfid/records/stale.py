"""What has become of a fit's recordings since: files of other content, runs that were excluded."""

import hashlib
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from cfid.records.campaign import RUNS_FOLDER
from cfid.records.parameters import Section, Source
from cfid.records.run import Run

Stale = Callable[[Section], tuple[str, ...]]


def stale_in(folder: Path, runs: Sequence[Run]) -> Stale:
    """Return what tells, in sentences, why a section of a campaign in a folder is no longer current.

    A file that is gone says nothing about the numbers that were found from it.
    """
    excluded = {run.folder.name: run.header.excluded for run in runs if run.header.excluded}

    @cache
    def is_other(source: Source) -> bool:
        try:
            with (folder / source.path).open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest() != source.sha256
        except OSError:
            return False

    def tell(section: Section) -> tuple[str, ...]:
        other = [source.path for source in section.sources if is_other(source)]
        paths = [Path(source.path) for source in section.sources]
        names = dict.fromkeys(path.parts[1] for path in paths if path.parts[:1] == (RUNS_FOLDER,) and path.parts[1:])
        left = [f"{name} ({excluded[name]})" for name in names if name in excluded]
        return (
            *([f"Changed since it was fitted: {', '.join(other)}: fit again."] if other else []),
            *([f"Made of what is excluded now: {', '.join(left)}: fit again without."] if left else []),
        )

    return tell
