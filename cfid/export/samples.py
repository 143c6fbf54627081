"""Draw vehicles from the joint distribution of measured values, for domain randomisation.

Within a fit, its covariances apply, and numbers without a covariance are independent. The covariance between fits with
a common cause is the product of their changes per standard uncertainty of the cause. A draw counts if a vehicle can
have its parameters: a possible body, and rising maps that the firmware can invert.
"""

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.counted import counted
from cfid.errors import DataError
from cfid.estimate.voltage_cubic import IDLE, cubic_fault
from cfid.export.render import commented, module
from cfid.export.target import Target, target_named
from cfid.export.vehicle import EXPORTED, ExportQuantity, ExportVehicle, of_flights
from cfid.inertia.matrix import is_consistent
from cfid.records.covariances import covariance_between, names_of, numbers_of, shaped_as
from cfid.records.parameters import Parameter, Section, Value, plain
from cfid.records.values import Values
from cfid.units import DEAD_COMMAND, FULL_COMMAND

Array = npt.NDArray[np.float64]

EVERYTHING = Target(name="samples", about="", file_name="samples.csv", comment="", needs=(), uses=EXPORTED, template="")
# By target, the file of all drawn vehicles. Its entries are the rows of the target's template.
LISTS = {"rotorpy": "samples_rotorpy.py", "crazyflow": "samples_crazyflow.npz"}
# The parameters of crazyflow's worlds, whose arrays have an axis for worlds, one for drones, and often one for motors.
_OF_MOTORS = ("mass", "L", "prop_inertia", "rpm2thrust", "rpm2torque", "rotor_dyn_coef")
_OF_DRONES = ("J", "mixing_matrix", "drag_matrix")
_MOST_REJECTED = 0.5  # of the draws: with more, the remaining draws have another distribution
_FEWEST = 200  # draws by which the rejected share is judged
_ROUNDING = 1e-6  # of the correlations' eigenvalues: smaller negative ones are none
_DIFFERENT = 0.01  # of a standard uncertainty: beyond it, a covariance contradicts the std
_POSITIVE = (
    "mass_kg",
    "arm_m",
    "rotor_inertia_kg_m2",
    "rotor_radius_m",
    "motor.max_thrust_n",
    "motor.thrust_per_speed_squared_n_s2",
    "tf.time_constant_s",
)
_POINTS = 50  # of a range, at which a slope is checked


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A normal distribution of the numbers of parameters: `mean` (n,), `covariance` (n, n) and n `names`.

    `values` contains the parameters as measured, whose numbers are in this order. `exact` names parameters without a
    standard uncertainty, `independent` those with several numbers but no covariance between them.
    """

    values: Mapping[str, Any]
    names: tuple[str, ...]
    mean: Array
    covariance: Array
    exact: tuple[str, ...]
    independent: tuple[str, ...]

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return draws (count, n), whether or not a vehicle can have them.

        Raises DataError when no distribution can have these covariances.
        """
        std = np.sqrt(np.diag(self.covariance))
        unit = np.where(std > 0, std, 1.0)
        correlation = self.covariance / np.outer(unit, unit)
        try:
            draws = rng.multivariate_normal(
                np.zeros(len(std)), correlation, count, check_valid="raise", tol=_ROUNDING, method="eigh"
            )
        except ValueError:
            raise DataError(
                "the covariances and common causes of these fits contradict each other, no numbers can covary so: fit "
                "again."
            ) from None
        return np.asarray(self.mean + unit * draws)

    def shaped(self, numbers: Array) -> dict[str, Any]:
        """Return the parameters of a draw (n,), each in its own shape."""
        parameters, row = {}, numbers.tolist()
        for key, value in self.values.items():
            count = len(numbers_of(key, value))
            parameters[key] = shaped_as(key, row[:count], value)
            row = row[count:]
        return parameters


def joint_of(fits: Sequence[tuple[Section, Sequence[str]]]) -> Joint:
    """Return the joint distribution of some parameters of fits; each parameter is taken from only one fit.

    Raises DataError for a covariance that contradicts the std of its parameter.
    """
    values = {key: plain(section.parameters[key].value) for section, keys in fits for key in keys}
    stds = {key: _std(section, key) for section, keys in fits for key in keys}
    ends = np.cumsum([len(std) for std in stds.values()])
    places = {key: np.arange(end - len(stds[key]), end) for key, end in zip(stds, ends, strict=True)}
    size = int(ends[-1]) if stds else 0
    covariance = _shared(fits, places, size)
    for key, rows in places.items():  # a parameter's own uncertainty contains its causes
        covariance[np.ix_(rows, rows)] = np.diag(stds[key] ** 2)
    covered: set[str] = set()
    for section, keys in fits:
        for block in section.covariance:
            counts = [len(numbers_of(key, plain(section.parameters[key].value))) for key in block.of]
            taken = np.repeat([key in keys for key in block.of], counts)
            rows = np.concatenate([places[key] for key in block.of if key in keys] or [np.arange(0)])
            covariance[np.ix_(rows, rows)] = np.array(block.matrix)[np.ix_(taken, taken)]
            for key in (key for key in block.of if key in keys):
                covered.add(key)
                diagonal = np.sqrt(np.diag(covariance)[places[key]])
                known = section.parameters[key].std is not None
                if known and not np.allclose(diagonal, stds[key], rtol=_DIFFERENT, atol=0):
                    raise DataError(
                        f"the std of {key} and the diagonal of its covariance contradict each other. Expected the "
                        "square root of the diagonal: fit again."
                    )
    uncertain = [key for key in values if np.any(np.diag(covariance)[places[key]] > 0)]
    return Joint(
        values=values,
        names=tuple(name for key, value in values.items() for name in names_of(key, value)),
        mean=np.array([number for key, value in values.items() for number in numbers_of(key, value)], dtype=np.float64),
        covariance=covariance,
        exact=tuple(key for key in values if key not in uncertain),
        independent=tuple(key for key in uncertain if key not in covered and len(places[key]) > 1),
    )


def _shared(fits: Sequence[tuple[Section, Sequence[str]]], places: Mapping[str, Array], size: int) -> Array:
    """Return the covariance (n, n) by common causes: the sum of the products of their effects on all numbers."""
    effects: dict[str, Array] = {}
    for section, keys in fits:
        for cause, changes in section.common.items():
            for key in (key for key in keys if key in changes):
                effects.setdefault(cause, np.zeros(size))[places[key]] = numbers_of("", changes[key])
    return sum((np.outer(effect, effect) for effect in effects.values()), np.zeros((size, size)))


def _std(section: Section, key: str) -> Array:
    """Return a parameter's standard uncertainties, with zero for unknown ones."""
    parameter = section.parameters[key]
    if parameter.std is None:
        return np.zeros(len(numbers_of(key, plain(parameter.value))))
    return np.array([number or 0.0 for number in numbers_of(key, plain(parameter.std))])


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Possible vehicles: `numbers` (count, n), their entries by target, the count of all draws, and why some failed."""

    joint: Joint
    numbers: Array
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
        lists = {
            LISTS[name]: _worlds(entries) if name == "crazyflow" else _quads(entries, about)
            for name, entries in self.entries.items()
        }
        return {
            "samples.csv": table.getvalue().encode(),
            "samples.npz": packed.getvalue(),
            **lists,
        }


def _quads(entries: Sequence[str], about: Sequence[str]) -> bytes:
    """Return RotorPy's vehicles as a module."""
    listed = ",\n".join(entries)
    return f"{commented(about, '#')}\nimport numpy as np\n\nQUADS = [\n{listed},\n]\n".encode()


def _worlds(entries: Sequence[str]) -> bytes:
    """Return the parameters of crazyflow's worlds by name, with a vehicle in each."""
    drones, packed = [json.loads(entry) for entry in entries], io.BytesIO()
    stacked = {name: np.array([drone[name] for drone in drones], dtype=np.float32) for name in drones[0]}
    worlds: dict[str, Any] = {name: stacked[name][:, np.newaxis, np.newaxis] for name in _OF_MOTORS}
    worlds |= {name: stacked[name][:, np.newaxis] for name in _OF_DRONES}
    np.savez_compressed(packed, **worlds, J_inv=np.linalg.inv(worlds["J"]))
    return packed.getvalue()


def draw(vehicle: ExportVehicle, values: Values, *, count: int, seed: int) -> Samples:
    """Draw until enough vehicles are possible, and suitable for the lists whose needs are measured.

    Raises DataError when over half of the draws are not possible.
    """
    joint = _joint(vehicle, values)
    targets = [target for name in LISTS if not (target := target_named(name, Path())).missing(vehicle)]
    rng, reasons, draws = np.random.default_rng(seed), Counter[str](), 0
    numbers: list[Array] = []
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
    drawn = with_values(vehicle, values)
    found = {key: quantity.value for key, quantity in drawn.quantities.items()}
    if reason := impossible(found, commands=(max(low, DEAD_COMMAND), high)):
        return reason, {}
    try:
        rows = {target.name: module(target, drawn).rows for target in targets}
    except DataError as error:
        return str(error).partition(" is ")[0] + " cannot be exported", {}
    return "", {name: "{" + ", ".join(f'"{key}": {text}' for key, text, _ in of) + "}" for name, of in rows.items()}


def with_values(vehicle: ExportVehicle, values: Mapping[str, Value]) -> ExportVehicle:
    """Return a vehicle with other values, given by key, which the inverse thrust map's range and flights' follow."""
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
    return replace(vehicle, quantities=quantities | of_flights(quantities, vehicle.frame))


def _joint(vehicle: ExportVehicle, values: Values) -> Joint:
    """Return the joint distribution of the quantities that exports use; the inverse thrust map follows from the map."""
    fits: dict[str, tuple[Section, list[str]]] = {}
    for quantity in EVERYTHING.taken(vehicle):
        if quantity.origin == vehicle.quantities["gravity_mps2"].origin:
            fits[quantity.key] = (_stated(quantity), [quantity.key])
            continue
        for key in quantity.made_of or (quantity.key,):
            if key != "motor.command_of_thrust" and (value := values.find(key)) is not None:
                fits.setdefault(f"{value.fit.name} {value.fit.stem}", (value.section, []))[1].append(key)
    return joint_of(list(fits.values()))


_CAUSES = {  # the names that fits have for the errors of what rig.toml states
    "mass_kg": ("mass",),
    "arm_m": ("arm",),
    "gravity_mps2": ("gravity",),
    "centre_of_mass_m": ("centre x", "centre y", "centre z"),
}


def _stated(quantity: ExportQuantity) -> Section:
    """Return a quantity of rig.toml in the form of a fit; each of its numbers is a common cause of fits, too."""
    lengths = isinstance(quantity.std, list)  # measured independently of each other
    stds = np.atleast_1d([] if quantity.std is None else np.array(quantity.std, dtype=np.float64))
    causes = {
        cause: {quantity.key: (stds * (np.arange(len(stds)) == place)).tolist()}
        for place, cause in enumerate(_CAUSES.get(quantity.key, ())[: len(stds)])
        if stds[place]
    }
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
        common=causes,
    )


def impossible(values: Mapping[str, Any], *, commands: tuple[float, float] = (DEAD_COMMAND, FULL_COMMAND)) -> str:
    """Return the first reason why no vehicle can have the parameters, given by key, or "" if a vehicle can.

    `commands` is the range in which the maps of the command were measured; the other maps are checked over the values
    that these maps reach. The firmware must be able to invert thrust over motor voltage, see `cubic_fault`. How far its
    motor commands may fall by rounding is no property of the vehicle and is not judged.
    """
    for key in _POSITIVE:
        if key in values and not values[key] > 0:
            return f"{key} is not above zero"
    if "inertia.matrix_kg_m2" in values and not is_consistent(np.array(values["inertia.matrix_kg_m2"])):
        return "inertia.matrix_kg_m2 is that of no possible body"
    command = np.linspace(*commands, _POINTS)
    thrust_n = _reached_n(values, command)
    square = values.get("motor.thrust_per_speed_squared_n_s2", math.nan)
    speed_rad_s = np.sqrt(np.maximum(thrust_n, 0.0) / square)
    speed_rad_s = speed_rad_s[np.isfinite(speed_rad_s)]
    maps = {
        "motor.thrust_poly": command,
        "motor.speed_poly": command,
        "motor.torque_poly": thrust_n,
        "motor.thrust_speed_poly": speed_rad_s,
    }
    for key, x in maps.items():
        if key in values and not np.all(np.polyval(np.polyder(np.array(values[key])), x) > 0):
            return f"{key} does not rise"
    most_n = values.get("motor.max_thrust_n")
    cubic: Sequence[float] | None = values.get("motor.thrust_voltage_poly")
    if cubic is not None and cubic_fault(cubic, max_thrust_n=most_n, fall=math.inf):
        return "motor.thrust_voltage_poly has no inverse in the firmware"
    for key in ("dynamics.rising", "dynamics.falling"):
        if key in values and not np.all(values[key][0] + 2 * values[key][1] * speed_rad_s > 0):
            return f"{key} is no lag"
    return ""


def _reached_n(values: Mapping[str, Any], command: Array) -> Array:
    """Return the thrusts (m,) above the idle thrust, in rising order, from a map or the largest thrust; else none."""
    if "motor.thrust_poly" in values:
        thrust_n = np.polyval(values["motor.thrust_poly"], command)
        return np.asarray(thrust_n[thrust_n >= IDLE * thrust_n[-1]])
    most_n = values.get("motor.max_thrust_n")
    return np.empty(0) if most_n is None else np.linspace(IDLE * most_n, most_n, _POINTS)
