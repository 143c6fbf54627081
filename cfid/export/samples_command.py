"""`cfid export samples`: draw vehicles from the joint distribution of measured values, for domain randomisation."""

import io
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cfid.console.messages import echo, note
from cfid.counted import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cfid.export.command import ExportInput
    from cfid.export.joint import Joint
    from cfid.export.target import Target
    from cfid.export.vehicle import ExportQuantity
    from cfid.records.covariances import Covariance
    from cfid.records.parameters import Section

MOST_REJECTED = 0.5  # of the draws: with more, the remaining draws have another distribution
_FEWEST = 200  # draws by which the rejected share is judged


class Drawn(NamedTuple):
    """Possible vehicles: numbers, renderings by target, the count of all draws, and why some were rejected."""

    numbers: list[Any]
    rendered: "dict[str, list[Any]]"
    draws: int
    reasons: Counter[str]

    @property
    def rejected_share(self) -> float:
        """The share of the draws that was rejected."""
        return sum(self.reasons.values()) / self.draws


def write_samples(known: "ExportInput", folder: Path, *, count: int, seed: int, force: bool) -> None:
    """Draw vehicles and write them as CSV and NPZ, and as lists for RotorPy and crazyflow if their needs are measured.

    Raises DataError for quantities that should not be exported, and when over half of the draws are no possible
    vehicle.
    """
    from cfid.export.command import refuse
    from cfid.export.samples import CRAZYFLOW, FILES, ROTORPY, listed, warnings_of
    from cfid.export.target import missing, need_text

    targets = [target for target in (ROTORPY, CRAZYFLOW) if not missing(target, known.vehicle)]
    paths = [folder / name for name in ("samples.csv", "samples.npz", *(FILES[target.name] for target in targets))]
    _refuse_to_replace(folder, paths, force=force)
    everything = _everything(known)
    refuse(everything, known, force=force)
    joint = _joint(known)
    drawn = draw(joint, known, targets, count=count, seed=seed)
    comments = [
        f"{counted(count, 'vehicle')} drawn with seed {seed} from what was measured of {known.vehicle.name}.",
        f"{100 * drawn.rejected_share:.1f} % of the draws were no possible vehicle and are not in.",
        *warnings_of(everything, known.vehicle),
    ]
    texts = {FILES[target.name]: listed(target, drawn.rendered[target.name], comments).encode() for target in targets}
    _write(folder, {**_tables(joint, drawn, seed, comments), **texts})
    for path in paths:
        echo(str(path))
    _report(joint, drawn, count)
    for sentence in warnings_of(everything, known.vehicle):
        note(sentence)
    for target in (ROTORPY, CRAZYFLOW):
        if target not in targets:
            needs = "; ".join(need_text(need) for need in missing(target, known.vehicle))
            note(f"no list for {target.name}, which needs what is not measured yet: {needs}.")


def _refuse_to_replace(folder: Path, paths: "Sequence[Path]", *, force: bool) -> None:
    from cfid.errors import ConfigError

    try:
        if folder.exists() and not folder.is_dir():
            raise ConfigError(f"{folder}: is a file, where samples are several: name a folder with --out.")
        there = [] if force else [path for path in paths if path.exists()]
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}.") from None
    if there:
        raise ConfigError(
            f"{there[0]} exists already: nothing was changed. --force overwrites it, --out names another folder."
        )


def draw(joint: "Joint", known: "ExportInput", targets: "list[Target]", *, count: int, seed: int) -> Drawn:
    """Draw until enough vehicles are possible and suitable for the targets.

    Raises DataError when over half of the draws are not possible.
    """
    import numpy as np

    from cfid.errors import DataError

    rng, reasons, drawn = np.random.default_rng(seed), Counter[str](), 0
    numbers: list[Any] = []
    rendered: dict[str, list[Any]] = {target.name: [] for target in targets}
    while len(numbers) < count:
        for row in joint.draw(max(count, _FEWEST), rng):
            drawn += 1
            reason, made = _vehicle(joint.shaped(row), known, targets)
            if reason:
                reasons[reason] += 1
                continue
            numbers.append(row)
            for name, one in made.items():
                rendered[name].append(one)
        if sum(reasons.values()) > MOST_REJECTED * drawn:
            itself, _ = _vehicle(joint.shaped(joint.mean), known, targets)
            cause = (
                f"The measured values themselves belong to no possible vehicle: {itself}."
                if itself
                else "The uncertainties are too large for a normal distribution: measure these again."
            )
            raise DataError(
                f"samples: nothing was written. {100 * sum(reasons.values()) / drawn:.0f} % of {drawn} draws are no "
                f"possible vehicle (limit {100 * MOST_REJECTED:.0f} %): {_told(reasons)}. {cause}"
            )
    return Drawn(numbers[:count], {name: made[:count] for name, made in rendered.items()}, drawn, reasons)


def _vehicle(values: dict[str, Any], known: "ExportInput", targets: "list[Target]") -> tuple[str, dict[str, Any]]:
    """Return why a draw is no possible vehicle ("" if it is possible), and its rendering for each target."""
    from cfid.errors import DataError
    from cfid.export.possible import impossible
    from cfid.export.samples import rendered, with_values

    if reason := impossible(values, commands=_commands(known)):
        return reason, {}
    vehicle = with_values(known.vehicle, values)
    try:
        return "", {target.name: rendered(target, vehicle) for target in targets}
    except DataError as error:
        return str(error).partition(" is ")[0] + " cannot be exported", {}


def _commands(known: "ExportInput") -> tuple[float, float]:
    """Return the range of measured commands above the dead zone."""
    from cfid.units import DEAD_COMMAND, FULL_COMMAND

    found = known.vehicle.quantities.get("thrust_of_command")
    low, high = (found.commands if found is not None else None) or (DEAD_COMMAND, FULL_COMMAND)
    return max(low, float(DEAD_COMMAND)), high


def _everything(known: "ExportInput") -> "Target":
    """Return a target that uses every quantity, so that the samples are judged like any other target."""
    from cfid.export.target import Target

    return Target(
        name="samples",
        file_name="samples.csv",
        about="",
        comment="",
        needs=(),
        uses=tuple(known.vehicle.quantities),
        write=lambda _: "",
    )


def _joint(known: "ExportInput") -> "Joint":
    from cfid.export.joint import joint_of

    vehicle = known.vehicle
    fits: dict[str, tuple[Section, list[str]]] = {
        quantity.key: (_stated(quantity), [quantity.key])
        for quantity in (*vehicle.quantities.values(), vehicle.centre, vehicle.gravity)
        if quantity.origin == vehicle.gravity.origin  # stated by rig.toml
    }
    for quantity in vehicle.quantities.values():
        if quantity.key in fits or quantity.key == "motor.command_of_thrust":  # the latter follows from the map
            continue
        value = known.values.find(quantity.key)
        if value is not None:
            fits.setdefault(f"{value.fit.name} {value.fit.stem}", (value.section, []))[1].append(quantity.key)
    return joint_of(list(fits.values()))


def _stated(quantity: "ExportQuantity") -> "Section":
    """Return a quantity of rig.toml in the form of a fit; mass and arm are common causes of other quantities too."""
    from datetime import UTC, datetime

    from cfid.records.parameters import Parameter, Section

    cause = {"mass_kg": "mass", "arm_m": "arm"}.get(quantity.key) if quantity.std is not None else None
    return Section(
        method="by hand",
        found=datetime.now(UTC),
        cfid_version="",
        accepted=True,
        sources=(),
        parameters={quantity.key: Parameter(value=quantity.value, std=quantity.std, unit=quantity.unit)},
        covariance=_independent(quantity),
        common={cause: {quantity.key: [quantity.std]}} if cause else {},
    )


def _independent(quantity: "ExportQuantity") -> "tuple[Covariance, ...]":
    """Return the covariance of a list of lengths that were measured independently, nothing for other quantities."""
    import numpy as np

    from cfid.records.covariances import covariance_between

    if not isinstance(quantity.std, list):
        return ()
    return covariance_between({quantity.key: quantity.value}, np.diag(np.square(quantity.std)))


def _tables(joint: "Joint", drawn: Drawn, seed: int, comments: list[str]) -> dict[str, bytes]:
    import csv

    import numpy as np

    from cfid.export.wording import HASH, commented

    table, packed = io.StringIO(), io.BytesIO()
    table.write(commented(comments, HASH))
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(joint.names)
    writer.writerows(row.tolist() for row in drawn.numbers)
    np.savez_compressed(
        packed,
        names=np.array(joint.names),
        values=np.array(drawn.numbers),
        mean=joint.mean,
        covariance=joint.covariance,
        rejected_share=np.array(drawn.rejected_share),
        seed=np.array(seed),
        about=np.array(comments),
    )
    return {"samples.csv": table.getvalue().encode(), "samples.npz": packed.getvalue()}


def _write(folder: Path, files: dict[str, bytes]) -> None:
    from cfid.errors import ConfigError
    from cfid.records.files import refuse_kept, write_whole

    try:
        for name in files:
            refuse_kept(folder / name)
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            write_whole(folder / name, content)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}. --out names another folder.") from None


def _report(joint: "Joint", drawn: Drawn, count: int) -> None:
    why = f": {_told(drawn.reasons)}" if drawn.reasons else ""
    echo(f"{counted(count, 'vehicle')}; {100 * drawn.rejected_share:.1f} % of {drawn.draws} draws rejected{why}.")
    if joint.exact:
        note(f"no uncertainty is known of {', '.join(joint.exact)}: the same in every vehicle.")
    if joint.independent:
        note(
            f"no covariance is kept of {', '.join(joint.independent)}: their numbers are drawn independently. Fit "
            "again to have it."
        )


def _told(reasons: Counter[str]) -> str:
    return ", ".join(f"{reason} ({times})" for reason, times in reasons.most_common())
