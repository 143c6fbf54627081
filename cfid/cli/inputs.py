"""What the words on the command line stand for: recordings, axes, numbers, and the rig they belong to."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.cli.options import RigOptions, positive
from cfid.cli.run_words import LAST, RUN_FILE, is_glob
from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from cfid.campaign import Campaign, Rig
    from cfid.recording import AngleRecord, Reading

FIXTURE = "fixture"
NO_RIG = "no rig.toml here: the thesis' Crazyflie 2.0, cube and test body are taken (--geometry FILE for yours)."


@dataclass(frozen=True)
class KnownInertia:
    """An axis inertia given as a number, `x=3.12e-05:4e-08`."""

    name: str
    value_kg_m2: float
    std_kg_m2: float


@dataclass(frozen=True)
class Named:
    """A recording and the name it goes by: a mount, or grams."""

    name: str
    record: "AngleRecord"


@dataclass(frozen=True)
class Workplace:
    """The campaign a command runs in, if any, and the rig that holds; `borrowed` when it is the thesis'."""

    campaign: "Campaign | None"
    rig: "Rig"
    borrowed: bool

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be said when the rig's numbers are used."""
        return (NO_RIG,) if self.borrowed else ()

    def figures_beside(self, files: Sequence[Path]) -> Path:
        """Return where figures of several recordings go: into the campaign, else beside the first file."""
        if self.campaign is not None:
            return self.campaign.folder / "figures"
        return files[0].parent if files else Path()


def open_workplace(options: RigOptions, *, gravity_mps2: float | None = None) -> Workplace:
    """Find the campaign and its rig; --geometry and --gravity-mps2 override, the thesis' rig stands in."""
    from cfid.campaign import find_campaign, load_rig, thesis_rig

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
    from cfid.recording import read_angle

    path = find_recording(word, workplace)
    if path.is_file() and not workplace.borrowed and reading.counts_per_turn is None:
        reading = replace(reading, counts_per_turn=workplace.rig.encoder.counts_per_turn)
    return read_angle(path, reading)


def read_swings(
    words: Sequence[str], reading: "Reading", workplace: Workplace, *, body: str
) -> list[Named | KnownInertia]:
    """Read AXIS=FILE, AXIS=NUMBER, AXIS=NUMBER:DEVIATION, or a RUN whose label says axis and body.

    A run labelled as the empty fixture is the fixture's swing, whatever its axis.

    Raises ConfigError for a word that is none of these, and for a run of another body; DataError for a run
    without an axis.
    """
    found: list[Named | KnownInertia] = []
    for word in words:
        name, equals, rest = word.partition("=")
        if not equals or Path(word).exists():
            name, rest = "", word
        elif known := _known_inertia(name, rest):
            found.append(known)
            continue
        record = read_recording(rest, reading, workplace)
        found.append(Named(_axis(record, name, rest, body), record))
    return found


def read_weights(words: Sequence[str], reading: "Reading", workplace: Workplace) -> list[tuple[float, "AngleRecord"]]:
    """Read GRAMS=FILE, or a RUN whose label says its weight; return grams and recordings.

    Raises ConfigError for what is no weight, DataError for a run without one.
    """
    found = []
    for word in words:
        name, equals, rest = word.partition("=")
        if not equals or Path(word).exists():
            name, rest = "", word
        record = read_recording(rest, reading, workplace)
        if not name and record.label.weight_g is None:
            raise DataError(f"{word}: does not say its weight in grams: write GRAMS={word}.")
        found.append((_grams(name) if name else record.label.weight_g or 0.0, record))
    return found


def check_mounts(names: Iterable[str], mounts: Mapping[str, object], *, table: str) -> None:
    """Check that every name is a mount.

    Raises ConfigError naming the mounts there are.
    """
    for name in names:
        if name not in mounts:
            there = ", ".join(mounts) or "none"
            raise ConfigError(f"'{name}' is no mount of this rig.toml (it has: {there}): add [{table}.{name}].")


def _known_inertia(name: str, text: str) -> KnownInertia | None:
    value, colon, std = text.partition(":")
    try:
        known = KnownInertia(name, float(value), float(std) if colon else 0.0)
    except ValueError:
        return None
    positive(known.value_kg_m2, f"{name}=")
    if not 0 <= known.std_kg_m2 < float("inf"):
        raise ConfigError(f"{name}={text}: a standard deviation is a number of zero or more.")
    return known


def _axis(record: "AngleRecord", name: str, word: str, body: str) -> str:
    """Return the mount a recording was swung on: the name given, else its label."""
    label = record.label
    if label.body == FIXTURE:
        return FIXTURE
    if label.body is not None and label.body != body and name != FIXTURE:
        raise ConfigError(f"{word}: is labelled as a swing of the {label.body}, not of the {body}.")
    if not name and label.axis is None:
        raise DataError(f"{word}: does not say its axis: write AXIS={word}.")
    return name or label.axis or ""


def _grams(text: str) -> float:
    try:
        return positive(float(text), "GRAMS=")
    except ValueError:
        raise ConfigError(f"'{text}' is no weight in grams: write GRAMS=FILE.") from None
