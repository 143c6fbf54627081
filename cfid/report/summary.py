"""The first screen of a report: main numbers in plain units, the weakest number, main findings and the next step."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from cfid.console.tables import value_and_deviation
from cfid.counted import counted
from cfid.findings import CODES
from cfid.guide.certainty import percent
from cfid.guide.status import Next, TaskStatus
from cfid.quantities.registry import find
from cfid.records.covariances import numbers_of
from cfid.records.parameters import plain
from cfid.records.rig_file import Rig
from cfid.records.values import Values, judging_weights
from cfid.report.experiments import Experiment
from cfid.report.sheet import BARELY
from cfid.wire.app import MIDDLE

_MOST_FINDINGS = 5
_RECORDINGS = frozenset({"recording", *CODES})  # codes of findings about runs
_LOSSES = ("samples-lost", "samples-not-taken")
_STALE = "stale"  # the code of findings about a fit that is no longer current
_MILLIONTH = "10⁻⁶ "
_DRAG = f"{_MILLIONTH}kg/rad"


@dataclass(frozen=True)
class MainNumber:
    """A number in plain units with its standard uncertainty, as text; `std` is the relative one, "" if unknown."""

    title: str
    value: str
    std: str


@dataclass(frozen=True)
class FirstScreen:
    """What a reader wants to know first; `weakest` is a sentence on the number that is least certain for its purpose.

    `remarks` are those of `cfid status`: what to fit again, to record again or to record once more.
    """

    numbers: tuple[MainNumber, ...]
    weakest: str
    findings: tuple[str, ...]
    more_findings: int
    next_command: str
    next_why: str
    remarks: tuple[str, ...] = ()


Weights = Callable[[int, Rig], Sequence[float]]  # from the count of a quantity's numbers, and the rig


class _Main(NamedTuple):
    """A weighted sum of a quantity's numbers; `scale` converts it from the quantity's unit to the plain `unit`."""

    title: str
    key: str
    weights: Weights
    scale: float
    unit: str


def _only(place: int) -> Weights:
    """Return the weights that select one number."""
    return lambda count, _: [float(number == place) for number in range(count)]


def _where_it_is_used(key: str) -> Weights:
    """Return the weights by which a polynomial is judged."""
    return lambda count, rig: judging_weights(key, count, rig) or [0.0] * count


_MAIN = (
    _Main("Inertia about x", "inertia.matrix_kg_m2", _only(0), 1e6, "10⁻⁶ kg m²"),
    _Main("Inertia about y", "inertia.matrix_kg_m2", _only(1), 1e6, "10⁻⁶ kg m²"),
    _Main("Inertia about z", "inertia.matrix_kg_m2", _only(2), 1e6, "10⁻⁶ kg m²"),
    _Main("Viscous friction of the axis", "friction.viscous_nms_per_rad", _only(0), 1e6, "10⁻⁶ N m s/rad"),
    _Main("Largest thrust of one motor", "motor.max_thrust_n", _only(0), 1e3, "mN"),
    _Main("Mass that hovers at most", "motor.hover_mass_kg", _only(0), 1e3, "g"),
    _Main(
        f"Rotor speed at command {MIDDLE:.0f}", "motor.speed_poly", _where_it_is_used("motor.speed_poly"), 1.0, "rad/s"
    ),
    _Main(
        "Torque over thrust of a rotor, in hover",
        "motor.torque_poly",
        _where_it_is_used("motor.torque_poly"),
        1e3,
        "mN m/N",
    ),
    _Main("Time constant of motor and rotor", "tf.time_constant_s", _only(0), 1e3, "ms"),
    _Main("Round trip to the vehicle", "latency.rtt_mean_s", _only(0), 1e3, "ms"),
    *(
        _Main(f"Drag along {axis}, over speeds of rotors and wind", "drag.simple_kg_per_rad", _only(place), 1e6, _DRAG)
        for place, axis in enumerate("xyz")
    ),
)


def summary_of(
    known: Values,
    experiments: Sequence[Experiment],
    statuses: Sequence[TaskStatus],
    step: Next,
    remarks: Sequence[str] = (),
) -> FirstScreen:
    """Return the first screen of a campaign from its tasks' status, its next step and the guide's remarks."""
    if step.words[0] == "report":  # the reader has the report already
        step = replace(step, words=("export",), why=f"{step.why} Hand it to firmware and simulators.")
    findings = tuple(_findings([one for one in experiments if not _is_replaced(one, experiments)]))
    return FirstScreen(
        numbers=tuple(_numbers(known)),
        weakest=_weakest(statuses),
        findings=findings[:_MOST_FINDINGS],
        more_findings=max(len(findings) - _MOST_FINDINGS, 0),
        next_command=step.command,
        next_why=step.why,
        remarks=tuple(remarks),
    )


def _numbers(known: Values) -> Iterator[MainNumber]:
    vehicle = known.rig.vehicle
    yield _main("Mass", vehicle.mass_kg, vehicle.mass_std_kg or None, 1e3, "g")
    arm, stated = known.rig.loadcell, known.find("arm_m")
    if stated is not None:
        yield _main("Arm", stated.parameter.value, stated.parameter.std, 1e3, "mm")
    elif arm.arm_mm is not None:
        yield _main("Arm", arm.arm_mm, arm.arm_std_mm or None, 1.0, "mm")
    for one in _MAIN:
        found = known.find(one.key)
        if found is None:
            continue
        if not found.accepted:
            yield MainNumber(one.title, "rejected", "")
            continue
        count = len(numbers_of(one.key, plain(found.parameter.value)))
        number = found.number(one.weights(count, known.rig))
        if math.isfinite(number.nominal_value):
            yield _main(one.title, number.nominal_value, number.std_dev or None, one.scale, one.unit)


def _main(title: str, value: float, std: float | None, scale: float, unit: str) -> MainNumber:
    shown, spread = value_and_deviation(scale * value, None if std is None else scale * std)
    relative = "" if std is None or value == 0 else percent(std / abs(value))
    if std is not None and abs(value) < BARELY * std:
        relative = "consistent with zero"
    text = shown if spread == "-" else f"{shown} ± {spread}"
    if unit.startswith(_MILLIONTH):
        return MainNumber(title, f"{text if spread == '-' else f'({text})'}·{unit}", relative)
    return MainNumber(title, f"{text} {unit}", relative)


def _weakest(statuses: Sequence[TaskStatus]) -> str:
    """Return a sentence on the number least certain for its purpose, with the main cause; "" if none can be judged."""
    worst = max((found for one in statuses for found in one.found), key=lambda found: found.short_by, default=None)
    if worst is None or not worst.short_by:
        return ""
    enough = "enough for" if worst.short_by <= 1 else "too little for"
    reason = f" (mostly by the {worst.mostly})" if worst.mostly else ""
    return f"{_title(worst.key)} is known to {percent(worst.std)}{reason}, {enough} {worst.aim.purpose}."


def _title(key: str) -> str:
    """Return the registered title of a quantity, for the beginning of a sentence."""
    quantity = find(key)
    return quantity.title[0].upper() + quantity.title[1:] if quantity else key


def _is_replaced(experiment: Experiment, others: Iterable[Experiment]) -> bool:
    """Return whether a later fit of this kind replaces an experiment, as it used all its recordings and more.

    An experiment that is no longer current is replaced by any later accepted fit, which is what its findings request.
    """
    own = {source.sha256 for source in experiment.sources}
    stale = any(finding.code == _STALE for finding in experiment.findings)
    return any(
        (own and own < {one.sha256 for one in other.sources}) or (stale and other.accepted)
        for other in others
        if other.name == experiment.name and other.found > experiment.found
    )


def _findings(experiments: Sequence[Experiment]) -> Iterator[str]:
    """Yield rejections, then warnings on results, then on recordings, each sentence once with its experiments.

    Runs often lose samples, which must not hide the faults of a result, so all such losses of accepted fits are one
    sentence at the end. That runs are simulated is stated once, above the findings.
    """
    bearable: dict[str, set[str]] = {}  # names of recordings that lost samples, by the accepted experiment
    for severity, recordings in (("rejection", False), ("rejection", True), ("warning", False), ("warning", True)):
        about: dict[str, list[str]] = {}
        for one in experiments:
            for finding in one.findings:
                if finding.severity != severity or (finding.code in _RECORDINGS) is not recordings:
                    continue
                if one.accepted and finding.code in _LOSSES:
                    bearable.setdefault(one.title, set()).update(finding.where)
                elif finding.code != "recording-simulated":
                    about.setdefault(finding.sentence, []).append(one.title)
        yield from (f"{', '.join(dict.fromkeys(titles))}: {sentence}" for sentence, titles in about.items())
    if bearable:
        count = counted(len(set[str]().union(*bearable.values())), "recording")
        yield f"{', '.join(bearable)}: {count} lost samples or missed some; the fits are accepted nevertheless."
