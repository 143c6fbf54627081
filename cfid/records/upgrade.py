"""Rewrite a campaign's files in the current formats, and keep the old ones."""

from collections.abc import Iterator
from pathlib import Path

from cfid.errors import ConfigError
from cfid.records import fits, parameters
from cfid.records.campaign import Campaign
from cfid.records.files import locked_folder, write_whole

KEPT_IN = "before-upgrade"


def upgrade_files(campaign: Campaign) -> list[Path]:
    """Rewrite the files of an older format and return their paths; the old content is kept in `before-upgrade`.

    Every file is read before the first is written. Raises DataError when one cannot be read, ConfigError when one
    cannot be written or another old one is already kept; the files written until then are complete.
    """
    changed = list(_outdated(campaign))
    try:
        with locked_folder(campaign.folder):
            for path, content in changed:
                _keep(campaign.folder, path)
                write_whole(path, content)
    except OSError as error:
        raise ConfigError(f"{error.filename or campaign.folder}: cannot be written: {error.strerror}.") from None
    return [path for path, _ in changed]


def _outdated(campaign: Campaign) -> Iterator[tuple[Path, bytes]]:
    content = parameters.rewritten(campaign.parameters_file)
    if content is not None:
        yield campaign.parameters_file, content
    for path in sorted(campaign.fits_folder.glob("*.json")):
        content = fits.rewritten(path)
        if content is not None:
            yield path, content


def _keep(folder: Path, path: Path) -> None:
    """Copy a file into the folder of old ones, where an earlier failed upgrade may already have put it."""
    kept, content = folder / KEPT_IN / path.relative_to(folder), path.read_bytes()
    folders = kept.parents[: len(kept.relative_to(folder).parts) - 1]
    linked = any(one.is_symlink() for one in (kept, *folders))
    if linked or (kept.exists() and kept.read_bytes() != content):
        raise ConfigError(f"{kept}: exists already. Move {KEPT_IN} away and upgrade again.")
    kept.parent.mkdir(parents=True, exist_ok=True)
    write_whole(kept, content)
