"""Draw vehicles from the joint distribution of measured values, for domain randomisation."""

import csv
import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.export.feasibility import impossible
from cfid.export.joint import Joint, joint_of
from cfid.export.render import commented, module
from cfid.export.target import Target, target_named
from cfid.export.vehicle import EXPORTED, ExportQuantity, ExportVehicle
from cfid.records.covariances import covariance_between
from cfid.records.parameters import Parameter, Section, Value
from cfid.records.values import Values
from cfid.units import DEAD_COMMAND, FULL_COMMAND
from cfid.version import __version__

EVERYTHING = Target(name="samples", about="", file_name="samples.csv", comment="", needs=(), uses=EXPORTED, template="")
# By target, the file that lists all drawn vehicles. Its entries are the rows of the target's template.
LISTS = {
    "rotorpy": ("samples_rotorpy.py", "{comments}\nimport numpy as np\n\nQUADS = [\n{entries},\n]\n"),
    "crazyflow": (
        "samples_crazyflow.json",
        '{{"written_by": "cfid {version}", "about": {about}, "drones": [\n{entries}\n]}}\n',
    ),
}
_MOST_REJECTED = 0.5  # of the draws: with more, the remaining draws have another distribution
_FEWEST = 200  # draws by which the rejected share is judged


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Possible vehicles: `numbers` (count, n), their entries by target, the count of all draws, and why some failed."""

    joint: Joint
    numbers: npt.NDArray[np.float64]
    entries: Mapping[str, Sequence[str]]
    draws: int
    reasons: Mapping[str, int]

    @property
    def rejected_share(self) -> float:
        """The share of the draws that was rejected."""
        return sum(self.reasons.values()) / self.draws

    def files(self, vehicle: ExportVehicle, seed: int, warnings: Sequence[str]) -> dict[str, bytes]:
        """Return the files by name: all numbers as CSV and NPZ, and a list for each target."""
        about = [
            f"{counted(len(self.numbers), 'vehicle')} drawn with seed {seed} from what was measured of {vehicle.name}.",
            f"{100 * self.rejected_share:.1f} % of the draws were no possible vehicle and are not in.",
            *warnings,
        ]
        table, packed = io.StringIO(commented(about, "#")), io.BytesIO()
        table.seek(0, io.SEEK_END)
        writer = csv.writer(table, lineterminator="\n")
        writer.writerow(self.joint.names)
        writer.writerows(self.numbers.tolist())
        np.savez_compressed(
            packed,
            names=np.array(self.joint.names),
            values=self.numbers,
            mean=self.joint.mean,
            covariance=self.joint.covariance,
            rejected_share=np.array(self.rejected_share),
            seed=np.array(seed),
            about=np.array(about),
        )
        lists = {LISTS[name][0]: (LISTS[name][1], ",\n".join(entries)) for name, entries in self.entries.items()}
        head = {"comments": commented(about, "#"), "about": json.dumps(about), "version": __version__}
        return {
            "samples.csv": table.getvalue().encode(),
            "samples.npz": packed.getvalue(),
            **{name: form.format(entries=entries, **head).encode() for name, (form, entries) in lists.items()},
        }


def draw(vehicle: ExportVehicle, values: Values, *, count: int, seed: int) -> Samples:
    """Draw until enough vehicles are possible, and suitable for the lists whose needs are measured.

    Raises DataError when over half of the draws are not possible.
    """
    joint = _joint(vehicle, values)
    targets = [target for name in LISTS if not (target := target_named(name, Path())).missing(vehicle)]
    rng, reasons, draws = np.random.default_rng(seed), Counter[str](), 0
    numbers: list[npt.NDArray[np.float64]] = []
    entries: dict[str, list[str]] = {target.name: [] for target in targets}
    while len(numbers) < count:
        for row in joint.draw(max(count, _FEWEST), rng):
            draws += 1
            reason, rendered = _entries(vehicle, joint.shaped(row), targets)
            if reason:
                reasons[reason] += 1
                continue
            numbers.append(row)
            for name, entry in rendered.items():
                entries[name].append(entry)
        if sum(reasons.values()) > _MOST_REJECTED * draws:
            mean_reason, _ = _entries(vehicle, joint.shaped(joint.mean), targets)
            cause = (
                f"The measured values themselves belong to no possible vehicle: {mean_reason}."
                if mean_reason
                else "The uncertainties are too large for a normal distribution: measure these again."
            )
            raise DataError(
                f"samples: nothing was written. {100 * sum(reasons.values()) / draws:.0f} % of {draws} draws are no "
                f"possible vehicle (limit {100 * _MOST_REJECTED:.0f} %): {counts_text(reasons)}. {cause}"
            )
    return Samples(
        joint=joint,
        numbers=np.array(numbers[:count]),
        entries={name: rendered[:count] for name, rendered in entries.items()},
        draws=draws,
        reasons=reasons,
    )


def counts_text(reasons: Mapping[str, int]) -> str:
    """Return reasons with their counts, the most frequent first."""
    return ", ".join(f"{reason} ({times})" for reason, times in Counter(reasons).most_common())


def _entries(
    vehicle: ExportVehicle, values: Mapping[str, Value], targets: Sequence[Target]
) -> tuple[str, dict[str, str]]:
    """Return why a draw is no possible vehicle ("" if it is possible), and its entry in the list of each target."""
    thrust = vehicle.find("motor.thrust_poly")
    low, high = (None if thrust is None else thrust.commands) or (DEAD_COMMAND, FULL_COMMAND)
    if reason := impossible(values, commands=(max(low, DEAD_COMMAND), high)):
        return reason, {}
    drawn = with_values(vehicle, values)
    try:
        rows = {target.name: module(target, drawn).rows for target in targets}
    except DataError as error:
        return str(error).partition(" is ")[0] + " cannot be exported", {}
    return "", {name: "{" + ", ".join(f'"{key}": {text}' for key, text, _ in of) + "}" for name, of in rows.items()}


def with_values(vehicle: ExportVehicle, values: Mapping[str, Value]) -> ExportVehicle:
    """Return a vehicle with other values, given by key; the range of the inverse thrust map follows the map."""
    quantities = {
        key: replace(quantity, value=values.get(key, quantity.value)) for key, quantity in vehicle.quantities.items()
    }
    inverse = quantities.get("motor.command_of_thrust")
    if inverse is not None and "motor.thrust_poly" in values:
        poly = values["motor.thrust_poly"]
        rows = [
            {
                **row,
                **{
                    f"thrust_{end}_n": float(np.polyval(poly, row[f"command_{end}"]))
                    for end in ("min", "max")
                    if f"command_{end}" in row
                },
                "coefficients": [*[0.0] * (3 - len(poly)), *poly],
            }
            for row in inverse.value
        ]
        quantities["motor.command_of_thrust"] = replace(inverse, value=rows)
    return replace(vehicle, quantities=quantities)


def _joint(vehicle: ExportVehicle, values: Values) -> Joint:
    """Return the joint distribution of the quantities that exports use; the inverse thrust map follows from the map."""
    fits: dict[str, tuple[Section, list[str]]] = {}
    for quantity in EVERYTHING.taken(vehicle):
        if quantity.origin == vehicle.quantities["gravity_mps2"].origin:
            fits[quantity.key] = (_stated(quantity), [quantity.key])
        elif quantity.key != "motor.command_of_thrust" and (value := values.find(quantity.key)) is not None:
            fits.setdefault(f"{value.fit.name} {value.fit.stem}", (value.section, []))[1].append(quantity.key)
    return joint_of(list(fits.values()))


def _stated(quantity: ExportQuantity) -> Section:
    """Return a quantity of rig.toml in the form of a fit; mass and arm are common causes of other quantities too."""
    cause = {"mass_kg": "mass", "arm_m": "arm"}.get(quantity.key) if quantity.std is not None else None
    lengths = isinstance(quantity.std, list)  # measured independently of each other
    return Section(
        method="by hand",
        found=datetime.now(UTC),
        cfid_version="",
        accepted=True,
        sources=(),
        parameters={quantity.key: Parameter(value=quantity.value, std=quantity.std, unit=quantity.unit)},
        covariance=covariance_between({quantity.key: quantity.value}, np.diag(np.square(quantity.std)))
        if lengths
        else (),
        common={cause: {quantity.key: [quantity.std]}} if cause else {},
    )
