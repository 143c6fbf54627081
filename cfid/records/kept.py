"""Which files of a campaign no result replaces: what was recorded, typed or fitted, and cannot be made again."""

from pathlib import Path

from cfid.errors import ConfigError
from cfid.records.campaign import FITS_FOLDER, PARAMETERS_FILE
from cfid.records.rig_file import RIG_FILE
from cfid.records.run import RUN_FILE


def refuse_kept(path: Path) -> None:
    """Raise ConfigError for a file among a campaign's fits, and an existing rig.toml, parameters.toml or file of a run.

    Links are followed, as where a file is written. Raises OSError where one cannot be followed.
    """
    target = path.resolve()
    folder = target.parent
    of_fits = folder.name == FITS_FOLDER and (folder.parent / RIG_FILE).exists()
    if target.exists() and (of_fits or target.name in (RIG_FILE, PARAMETERS_FILE) or (folder / RUN_FILE).exists()):
        raise ConfigError(f"{path}: nothing replaces what a campaign keeps of its runs and fits. Name another file.")
    if of_fits:
        raise ConfigError(f"{path}: that folder takes the campaign's fits alone. Name another.")
