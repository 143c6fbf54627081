"""What the words on the command line stand for: recordings, axes, numbers, and the rig they belong to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.console.options import RigOptions, positive
from cfid.console.selection import LAST, RUN_FILE, is_glob
from cfid.errors import ConfigError
from cfid.records.facts import NONE_STATED, RigFacts

if TYPE_CHECKING:
    from cfid.records.campaign import Campaign, Rig
    from cfid.records.tables.angle import AngleRecord, Reading


@dataclass(frozen=True)
class Workplace:
    """The campaign a command runs in, if any, and the rig that holds; `borrowed` when it is the thesis'."""

    campaign: "Campaign | None"
    rig: "Rig"
    borrowed: bool

    @property
    def facts(self) -> RigFacts:
        """How things are mounted as rig.toml states it; a borrowed rig states nothing."""
        return NONE_STATED if self.borrowed else self.rig.facts

    def figures_beside(self, files: Sequence[Path]) -> Path:
        """Return where figures of several recordings go: into the campaign, else beside the first file."""
        if self.campaign is not None:
            return self.campaign.folder / "figures"
        return files[0].parent if files else Path()


def open_workplace(options: RigOptions, *, gravity_mps2: float | None = None) -> Workplace:
    """Find the campaign and its rig; --geometry and --gravity-mps2 override, the thesis' rig stands in."""
    from cfid.records.campaign import find_campaign, load_rig, thesis_rig

    campaign = find_campaign(options.campaign, start=Path.cwd())
    borrowed = options.geometry is None and campaign is None
    if options.geometry is not None:
        rig = load_rig(options.geometry)
    else:
        rig = thesis_rig() if campaign is None else campaign.rig
    if gravity_mps2 is not None:
        gravity = positive(gravity_mps2, "--gravity-mps2")
        rig = rig.model_copy(update={"site": rig.site.model_copy(update={"gravity_mps2": gravity})})
    return Workplace(campaign, rig, borrowed)


def find_recording(word: str, workplace: Workplace) -> Path:
    """Return the path that a RUN stands for: as it is, or a run of the campaign by its name, a glob, or as the last.

    Raises ConfigError when a glob is that of several runs, or `last` of none.
    """
    path = Path(word)
    if workplace.campaign is None or path.exists():
        return path
    folder = workplace.campaign.runs_folder
    if word != LAST and not is_glob(word):
        return folder / word if (folder / word).is_dir() else path
    pattern = "*" if word == LAST else word
    found = sorted(at.parent for at in folder.glob(f"*/{RUN_FILE}") if fnmatch(at.parent.name, pattern))
    if not found or (word != LAST and len(found) > 1):
        told = "nothing is recorded yet" if word == LAST else f"{len(found) or 'no'} runs are called so, one is wanted"
        raise ConfigError(f"{word}: {told} ({folder}).")
    return found[-1]


def read_recording(word: str, reading: "Reading", workplace: Workplace) -> "AngleRecord":
    """Read the encoder of a RUN: a file, a run folder, or the name of a run of the campaign."""
    from cfid.records.tables.angle import read_angle

    path = find_recording(word, workplace)
    if path.is_file() and not workplace.borrowed and reading.counts_per_turn is None:
        reading = replace(reading, counts_per_turn=workplace.rig.encoder.counts_per_turn)
    return read_angle(path, reading)
