"""The first screen of a report: the main numbers in plain units, the weakest, what matters, and what comes next."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from cfid.console.tables import value_and_deviation
from cfid.guide.status import TaskStatus, next_of, percent
from cfid.quantities.lookup import find
from cfid.quantities.values import Number
from cfid.records.tables.times import SIMULATED
from cfid.report.experiments import Experiment
from cfid.report.known import Known

_MOST_FINDINGS = 5


@dataclass(frozen=True)
class MainNumber:
    """A number in plain units with its standard uncertainty, both as text; `std` is relative, "" where unknown."""

    title: str
    value: str
    std: str


@dataclass(frozen=True)
class FirstScreen:
    """What a reader wants to know first; `weakest` is the least sure of those that are for something."""

    numbers: tuple[MainNumber, ...]
    weakest: str
    findings: tuple[str, ...]
    more_findings: int
    next_command: str
    next_why: str


class _Main(NamedTuple):
    """A number of a quantity, by its key and place, and the plain unit: so many of the quantity's own."""

    title: str
    key: str
    place: str
    scale: float
    unit: str


_MAIN = (
    _Main("Inertia about x", "inertia.matrix_kg_m2", "xx", 1e6, "10⁻⁶ kg m²"),
    _Main("Inertia about y", "inertia.matrix_kg_m2", "yy", 1e6, "10⁻⁶ kg m²"),
    _Main("Inertia about z", "inertia.matrix_kg_m2", "zz", 1e6, "10⁻⁶ kg m²"),
    _Main("Largest thrust of one motor", "motor.max_thrust_n", "", 1e3, "mN"),
    _Main("Mass that hovers at most", "motor.hover_mass_kg", "", 1e3, "g"),
    _Main("Time constant of motor and rotor", "tf.time_constant_s", "", 1e3, "ms"),
    _Main("Round trip to the vehicle", "latency.rtt_mean_s", "", 1e3, "ms"),
)


def summary_of(known: Known, experiments: Sequence[Experiment], statuses: Sequence[TaskStatus]) -> FirstScreen:
    """Return the first screen of a campaign whose tasks stand as given."""
    step = next_of(statuses)
    findings = tuple(_findings(experiments))
    return FirstScreen(
        numbers=tuple(_numbers(known)),
        weakest=_weakest(statuses),
        findings=findings[:_MOST_FINDINGS],
        more_findings=max(len(findings) - _MOST_FINDINGS, 0),
        next_command=f"cfid {' '.join(step.words)}",
        next_why=step.why,
    )


def _numbers(known: Known) -> Iterator[MainNumber]:
    vehicle = known.rig.vehicle
    yield _main("Mass", vehicle.mass_kg, vehicle.mass_std_kg or None, 1e3, "g")
    arm = known.rig.loadcell
    if arm.arm_mm is not None:
        yield _main("Arm", arm.arm_mm, arm.arm_std_mm or None, 1.0, "mm")
    for one in _MAIN:
        found = known.find(one.key)
        if found is None:
            continue
        numbers: Iterable[Number] = found.parameter.numbers(one.key)
        number = next((number for number in numbers if number.place == one.place), None)
        if found.rejected:
            yield MainNumber(one.title, "rejected", "")
        elif number is not None and number.value is not None:
            yield _main(one.title, number.value, number.std, one.scale, one.unit)


def _main(title: str, value: float, std: float | None, scale: float, unit: str) -> MainNumber:
    shown, spread = value_and_deviation(scale * value, None if std is None else scale * std)
    relative = "" if std is None or value == 0 else percent(std / abs(value))
    return MainNumber(title, f"{shown} {unit}" if spread == "-" else _with_spread(shown, spread, unit), relative)


def _with_spread(shown: str, spread: str, unit: str) -> str:
    power, _, plain = unit.rpartition("⁻⁶ ")
    return f"({shown} ± {spread})·{power}⁻⁶ {plain}" if power else f"{shown} ± {spread} {unit}"


def _weakest(statuses: Sequence[TaskStatus]) -> str:
    """Return the number that is least sure for what it is for, "" where none can be judged."""
    worst = max((found for one in statuses for found in one.found), key=lambda found: found.short_by, default=None)
    if worst is None or not worst.short_by:
        return ""
    enough = "enough for" if worst.short_by <= 1 else "too little for"
    return f"{_title(worst.aim.key)} is known to {percent(worst.std)}, {enough} {worst.aim.purpose}."


def _title(key: str) -> str:
    """Return what the registry calls a quantity, as a sentence begins."""
    quantity = find(key)
    return quantity.title[0].upper() + quantity.title[1:] if quantity else key


def _findings(experiments: Sequence[Experiment]) -> Iterator[str]:
    """Yield what was rejected, then what was warned of, each sentence once with the experiments that it is about.

    That runs are simulated stands above, once for all.
    """
    for severity in ("rejection", "warning"):
        about: dict[str, list[str]] = {}
        for one in experiments:
            for finding in one.findings:
                if finding.severity == severity and not finding.sentence.endswith(SIMULATED):
                    about.setdefault(finding.sentence, []).append(one.title)
        yield from (f"{', '.join(dict.fromkeys(titles))}: {sentence}" for sentence, titles in about.items())
