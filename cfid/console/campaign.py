"""Create a campaign folder, and find the campaign that a command works in."""

from contextlib import suppress
from pathlib import Path
from secrets import randbelow
from typing import TYPE_CHECKING

from cfid.console.messages import note
from cfid.console.program import program
from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from cfid.quantities.registry import Platform
    from cfid.records.campaign import Campaign
    from cfid.records.rig_file import Preset

_SEEDS = 10**6


def make_campaign(
    folder: Path, *, seed: int | None = None, kind: "Preset" = "rig", platform: "Platform | None" = None
) -> Path:
    """Create a campaign folder and return the path of its rig.toml, which keeps the `seed` of the plan's order.

    `kind` and `platform` are those of `new_rig_text`.

    Raises ConfigError when the folder has a rig.toml already, or cannot be created.
    """
    from cfid.records.files import RIG_FILE, RUNS_FOLDER, write_new
    from cfid.records.rig_file import new_rig_text

    try:
        (folder / RUNS_FOLDER).mkdir(parents=True, exist_ok=True)
        text = new_rig_text(seed=randbelow(_SEEDS) if seed is None else seed, kind=kind, platform=platform)
        write_new(folder / RIG_FILE, text.encode())
    except FileExistsError:
        raise ConfigError(f"{folder / RIG_FILE} exists already: nothing was changed.") from None
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be created: {error.strerror}.") from None
    return folder / RIG_FILE


def here() -> "Campaign":
    """Return the campaign of the program's options, or else that at or above the current folder.

    Raises ConfigError when there is none.
    """
    from cfid.records.campaign import open_campaign

    return open_campaign(program().campaign)


def write_parameters(campaign: "Campaign") -> int:
    """Write parameters.toml from the fits, with a note on what it was; in a folder that is read-only, it stays.

    Fits that cannot be read are named, since their values are missing then; returns how many there are.
    """
    unreadable = note_unreadable_fits(campaign)
    with suppress(ConfigError):
        if was := campaign.write_parameters():
            note(
                f"{campaign.parameters_file.name} {was}: it is written anew from the fits, and no command reads it. "
                "`cfid set` stores a number."
            )
    return unreadable


def note_unreadable_fits(campaign: "Campaign") -> int:
    """Print a note on each kept fit that cannot be read, and return how many there are."""
    from cfid.records.fits import list_fits

    faults = [fault for fault in list_fits(campaign.fits_folder) if isinstance(fault, DataError)]
    for fault in faults:
        note(f"{fault} Its values do not count.")
    return len(faults)
