"""Protect files of a campaign that cannot be made again: what was recorded, typed or fitted."""

import os
from pathlib import Path

from cfid.errors import ConfigError
from cfid.records.campaign import FITS_FOLDER, PARAMETERS_FILE
from cfid.records.files import resolved
from cfid.records.rig_file import RIG_FILE
from cfid.records.run import RUN_FILE


def refuse_kept(path: Path) -> None:
    """Raise ConfigError for a file in a fits folder, or an existing rig.toml, parameters.toml or file of a run.

    Links are followed, as they are when a file is written. Raises OSError where one cannot be followed.
    """
    target, named = resolved(path), Path(os.path.normpath(path.absolute()))
    folders = {folder for place in (target, named) for folder in place.parents}
    of_fits = any(folder.name == FITS_FOLDER and (folder.parent / RIG_FILE).exists() for folder in folders)
    of_run = target.name in (RIG_FILE, PARAMETERS_FILE) or (target.parent / RUN_FILE).exists()
    if target.exists() and (of_fits or of_run):
        raise ConfigError(f"{path}: nothing replaces what a campaign keeps of its runs and fits. Name another file.")
    if of_fits:
        raise ConfigError(f"{path}: that folder takes the campaign's fits alone. Name another.")
