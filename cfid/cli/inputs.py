"""What the words on the command line stand for: recordings, axes, numbers, and the rig they belong to."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from cfid.cli.options import RigOptions
from cfid.errors import ConfigError, DataError

if TYPE_CHECKING:
    from cfid.campaign import Campaign, Rig
    from cfid.recording import AngleRecord, Reading

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


def open_workplace(options: RigOptions) -> Workplace:
    """Find the campaign and its rig; --geometry and --gravity-mps2 override, the thesis' rig stands in."""
    from cfid.campaign import find_campaign, load_rig, thesis_rig

    campaign = find_campaign(options.campaign, start=Path.cwd())
    borrowed = options.geometry is None and campaign is None
    if options.geometry is not None:
        rig = load_rig(options.geometry)
    else:
        rig = thesis_rig() if campaign is None else campaign.rig
    if options.gravity_mps2 is not None:
        gravity = positive(options.gravity_mps2, "--gravity-mps2")
        rig = rig.model_copy(update={"site": rig.site.model_copy(update={"gravity_mps2": gravity})})
    if options.mass_kg is not None:
        positive(options.mass_kg, "--mass-kg")
    return Workplace(campaign, rig, borrowed)


def positive(value: float, option: str) -> float:
    """Return a number that has to be above zero.

    Raises ConfigError when it is not.
    """
    if not 0 < value < float("inf"):
        raise ConfigError(f"{option} {value:g}: has to be above zero.")
    return value


def read_recording(word: str, reading: "Reading", workplace: Workplace) -> "AngleRecord":
    """Read a RUN: a file, a run folder, or the name of a run of the campaign."""
    from cfid.recording import read_angle

    path = Path(word)
    if workplace.campaign is not None:
        named = workplace.campaign.runs_folder / word
        path = named if named.is_dir() and not path.exists() else path
        if path.is_file() and reading.counts_per_turn is None:
            reading = replace(reading, counts_per_turn=workplace.campaign.rig.encoder.counts_per_turn)
    return read_angle(path, reading)


def read_named(
    words: Sequence[str], reading: "Reading", workplace: Workplace, *, label: str
) -> list[Named | KnownInertia]:
    """Read NAME=FILE, NAME=NUMBER, NAME=NUMBER:DEVIATION, or a RUN whose label (axis or grams) is its name.

    Raises ConfigError for a word that is none of these, DataError for a run without that label.
    """
    found: list[Named | KnownInertia] = []
    for word in words:
        name, equals, rest = word.partition("=")
        if not equals or Path(word).exists():
            record = read_recording(word, reading, workplace)
            found.append(Named(_label(record, label, word), record))
        elif known := _known_inertia(name, rest):
            found.append(known)
        else:
            found.append(Named(name, read_recording(rest, reading, workplace)))
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


def _label(record: "AngleRecord", label: str, word: str) -> str:
    value = record.label.axis if label == "axis" else record.label.weight_g
    if value is None:
        raise DataError(f"{word}: does not say its {label}: write {label.upper()}={word}.")
    return value if isinstance(value, str) else f"{value:g}"
