"""Find the recordings that a command's arguments name, and the rig that recorded them."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.console.lists import NOT_GIVEN, Measured
from cfid.console.program import program
from cfid.console.selection import name_other_folders, note_left_out, readable_runs
from cfid.records.choose import LAST, Matches, choose_one, is_glob, is_last
from cfid.records.rig_file import NONE_STATED, RigFacts

if TYPE_CHECKING:
    from cfid.recordings.angle import AxisRecord, CountsPerTurn
    from cfid.recordings.recording import Recording
    from cfid.records.campaign import Campaign
    from cfid.records.rig_file import Rig


@dataclass(frozen=True)
class Workplace:
    """The campaign that a command runs in, if any, and its rig; `borrowed` means that the rig is that of the thesis."""

    campaign: "Campaign | None"
    rig: "Rig"
    borrowed: bool

    @property
    def facts(self) -> RigFacts:
        """How devices are mounted, as rig.toml states it; a borrowed rig states nothing."""
        return NONE_STATED if self.borrowed else self.rig.facts


def open_workplace(geometry: Path | None = None, *, gravity: Measured = NOT_GIVEN) -> Workplace:
    """Find the campaign and its rig; without either, the thesis' is borrowed.

    The file `geometry`, or the word thesis for that of the thesis, replaces the rig, and `gravity` in m/s^2 the gravity
    of its site.
    """
    from cfid.records.campaign import find_campaign
    from cfid.records.rig_file import load_rig, thesis_rig

    campaign = find_campaign(program().campaign)
    borrowed = geometry is None and campaign is None
    if geometry is not None:
        rig = thesis_rig() if str(geometry) == "thesis" else load_rig(geometry)
    else:
        rig = thesis_rig() if campaign is None else campaign.rig
    given = {"gravity_mps2": gravity.value, "gravity_std_mps2": gravity.std}
    stated = {key: number for key, number in given.items() if number is not None}
    if stated:
        rig = rig.model_copy(update={"site": rig.site.model_copy(update=stated)})
    return Workplace(campaign, rig, borrowed)


def split_label(word: str, workplace: Workplace) -> tuple[str, str]:
    """Return LABEL and RUN of LABEL=RUN or LABEL:last; the label is "" if there is none.

    A file or run may have `=` in its own name.
    """
    label, equals, run = word.partition("=")
    campaign = workplace.campaign
    if Path(word).exists() or (campaign is not None and (campaign.runs_folder / word).is_dir()):
        return "", word
    if not equals and word.endswith(f":{LAST}"):
        return word.removesuffix(f":{LAST}"), LAST
    return (label, run) if equals else ("", word)


def find_recording(word: str, workplace: Workplace, suits: Matches = lambda _run: True) -> Path:
    """Return the path of a RUN, which is a path, or names a run of the campaign by its name, a glob or `last`.

    Without a campaign, runs are those in the current folder, where `cfid import` then writes them. `suits` describes
    the runs that the command takes. Raises ConfigError when a glob matches no run or several, or `last` finds none.
    """
    path = Path(word)
    if path.exists():
        return path
    folder = Path() if workplace.campaign is None else workplace.campaign.runs_folder
    if (folder / word).is_dir():
        return folder / word  # also where its name looks like a pattern
    if not is_last(word) and not is_glob(word):
        return path
    name_other_folders(folder, [word])
    choice = choose_one(word, readable_runs(folder), suits=suits)
    note_left_out(word, choice)
    return choice.runs[0].folder


def read_recording(word: str, workplace: Workplace, suits: Matches = lambda _run: True) -> "AxisRecord":
    """Read the angle, or the periods, of a RUN: a file, a run folder, or a run of the campaign, as `find_recording`."""
    from cfid.recordings import read
    from cfid.recordings.periods import axis_record

    recording = read.read_recording(find_recording(word, workplace, suits))
    return axis_record(recording, rig_counts_per_turn=counts_of_rig(recording, workplace))


def counts_of_rig(recording: "Recording", workplace: Workplace) -> "CountsPerTurn | None":
    """Return the rig's counts per turn for a file, which may not state any; None for a run, which states its own."""
    return None if workplace.borrowed or recording.run is not None else workplace.rig.encoder.counts_per_turn
