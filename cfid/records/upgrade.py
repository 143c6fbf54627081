"""A campaign's files brought to the formats of today; the old ones stay beside them."""

import shutil
from collections.abc import Iterator
from pathlib import Path

from cfid.errors import ConfigError
from cfid.records import fits, parameters
from cfid.records.campaign import Campaign
from cfid.records.files import alone_in, write_whole

KEPT_IN = "before-upgrade"


def upgrade(campaign: Campaign) -> list[Path]:
    """Rewrite what is in an older format and return the files, whose old content lies in `before-upgrade`.

    Every file is read before the first is written. Raises DataError when one cannot be read, ConfigError when one
    cannot be written or an old one is kept already; what was written until then is whole.
    """
    changed = list(_outdated(campaign))
    try:
        with alone_in(campaign.folder):
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
    kept = folder / KEPT_IN / path.relative_to(folder)
    if kept.exists():
        raise ConfigError(f"{kept}: is there already. Move {KEPT_IN} away and upgrade again.")
    kept.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy2(path, kept)
