"""`cfid parameters` and `cfid set`: list a campaign's parameters, and store parameters measured by hand."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Column, Table

from cfid.console.campaign import here, write_parameters
from cfid.console.messages import echo, note, print_json
from cfid.console.program import program
from cfid.console.tables import print_parameters
from cfid.errors import ConfigError
from cfid.estimate.voltage_cubic import cubic_fault
from cfid.quantities.plausible import implausible
from cfid.quantities.registry import UNITS, Shape, find, unit_of
from cfid.quantities.rounding import value_and_std
from cfid.quantities.values import ENTRIES, shape_error
from cfid.records.parameters import Parameter
from cfid.records.rig_file import change_rig

if TYPE_CHECKING:
    from cfid.quantities.registry import Platform
    from cfid.records.campaign import Campaign
    from cfid.records.parameters import Section
    from cfid.records.values import Values

_MOST = "motor.max_thrust_n"
_CUBIC = "motor.thrust_voltage_poly"  # lowest power first; the firmware's own polynomial may be stored by hand
_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
# These values are changed in rig.toml, so that each has one place: table, key, key of the standard uncertainty.
_IN_RIG = {
    "mass_kg": ("vehicle", "mass_kg", "mass_std_kg"),
    "gravity_mps2": ("site", "gravity_mps2", "gravity_std_mps2"),
}


def list_parameters(
    why: Annotated[
        str | None,
        typer.Option(metavar="KEY", help="List the kept fits that have this parameter, and why each is taken or not."),
    ] = None,
) -> None:
    """List the parameters with standard uncertainty, unit and origin.

    Of all kept fits of a parameter, the most certain of those that are accepted and current counts.

    Example: cfid parameters --why motor.max_thrust_n
    """
    campaign = here()
    values = campaign.values()
    if why is not None:
        _print_candidates(values, why)
        return
    write_parameters(campaign)
    sections = values.sections()
    outdated = {values.label(fit): values.outdated(fit) for fit in values.by_fit}
    (_print_json if program().json else _print_tables)(sections, outdated)


def _print_candidates(values: "Values", key: str) -> None:
    """Print the kept fits that have or rejected a parameter. Raises ConfigError where there are none."""
    candidates = values.candidates(key)
    if not candidates:
        raise ConfigError(f"{key}: no kept fit has it; `cfid parameters` lists the campaign's parameters.")
    parameters = [candidate.fit.section.parameters.get(key, Parameter(value=None)) for candidate in candidates]
    if program().json:
        rows = [
            {
                "fit": candidate.fit.stem, "taken": candidate.taken, "why": candidate.why,
                "std_over_aim": candidate.over_aim,
                "accepted": key not in candidate.fit.section.rejected, "found": candidate.fit.section.found.isoformat(),
                "recordings": sorted(candidate.fit.recordings), **parameter.as_json(),
            }
            for candidate, parameter in zip(candidates, parameters, strict=True)
        ]  # fmt: skip
        print_json({"command": "parameters", "key": key, "candidates": rows})
        return

    table = Table(
        Column("fit", overflow="fold"), "value", "std", "over aim", "taken", "why", box=SIMPLE, pad_edge=False
    )
    for candidate, parameter in zip(candidates, parameters, strict=True):
        texts = [value_and_std(number.value, number.std) for number in parameter.numbers(key)]
        value, std = ("\n".join(column) for column in zip(*texts, strict=True)) if texts else ("-", "-")
        over_aim = "-" if candidate.over_aim is None else f"{candidate.over_aim:.2g}"
        table.add_row(candidate.fit.stem, value, std, over_aim, "yes" if candidate.taken else "no", candidate.why)
    Console().print(table)


def set_by_hand(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="Name of the parameter, with its unit at the end, like mass_kg or arm_m, or one that a fit gives.",
        ),
    ],
    value: Annotated[
        str,
        typer.Argument(
            metavar="VALUE[:STD],...",
            help="A number and its standard uncertainty, or several separated by commas: coefficients, or xx, yy, zz, "
            "xy, xz, yz of a matrix; -- stands before a negative one.",
        ),
    ],
    *,
    force: Annotated[bool, typer.Option("--force", help="Store an implausible value anyway.")] = False,
) -> None:
    """Store a value measured by hand.

    Values that belong in rig.toml, such as the mass, are changed there. A thrust over motor voltage is
    stored only if the firmware can invert it.

    Example: cfid set motor.max_thrust_n 0.15:0.01
    """
    campaign = here()
    numbers, stds = _typed(name, value)
    several = (row := find(name)) is not None and row.shape not in (Shape.NUMBER, Shape.NUMBER_OR_LIST)
    if len(numbers) > 1 or several:
        of_matrix = row is not None and row.shape is Shape.MATRIX and len(numbers) == len(ENTRIES)
        parameter = Parameter(
            value=_matrix(numbers) if of_matrix else numbers,
            std=None if stds is None else _matrix(stds) if of_matrix else stds,
        )
    else:
        parameter = Parameter(value=numbers[0], std=None if stds is None else stds[0])
    _check(name, parameter, numbers, campaign, platform="other" if force else campaign.rig.vehicle.platform)
    if name in _IN_RIG:
        where = _into_rig(campaign, name, numbers[0], None if stds is None else stds[0])
    else:
        where = _into_parameters(campaign, name, parameter)
    spreads = [""] * len(numbers) if stds is None else [f" +- {std:g}" for std in stds]
    stated = ", ".join(f"{number:g}{spread}" for number, spread in zip(numbers, spreads, strict=True))
    echo(f"{name} is {stated}: {where}")


def _typed(name: str, words: str) -> tuple[list[float], list[float] | None]:
    """Return the numbers and their standard uncertainties; None where none has one. Raises ConfigError."""
    pairs = [word.partition(":") for word in words.split(",")]
    try:
        numbers = [float(number) for number, _, _ in pairs]
        stds = [float(std) for _, colon, std in pairs if colon]
    except ValueError:
        raise ConfigError(f"{name}: '{words}' is not VALUE[:STD], or several of them separated by commas.") from None
    if not all(map(math.isfinite, (*numbers, *stds))):
        raise ConfigError(f"{name}: a value and its standard uncertainty must be finite numbers.")
    if stds and len(stds) < len(numbers):
        raise ConfigError(f"{name}: state the standard uncertainty of each number, or of none.")
    if min(stds, default=1.0) <= 0:
        raise ConfigError(
            f"{name}: a standard uncertainty of {min(stds):g} is not above zero, and nothing measured is exact: state "
            "it, or leave it out where it is unknown."
        )
    return numbers, stds or None


def _matrix(numbers: Sequence[float]) -> list[list[float]]:
    """Return the symmetric matrix (3, 3) of its entries xx, yy, zz, xy, xz, yz."""
    matrix = [[0.0] * 3 for _ in range(3)]
    for number, (i, j) in zip(numbers, ENTRIES.values(), strict=True):
        matrix[i][j] = matrix[j][i] = number
    return matrix


def _check(
    name: str, parameter: Parameter, numbers: Sequence[float], campaign: "Campaign", *, platform: "Platform"
) -> None:
    """Raise ConfigError for a name that cannot be stored, another shape, and what no vehicle of the platform has."""
    row = find(name)
    if not _NAME.fullmatch(name) and (row is None or row.of_the_run or row.shape is Shape.ROWS):
        raise ConfigError(
            f"'{name}': no parameter that can be set. A name of yours has small letters, digits and single "
            "underscores, like arm_m."
        )
    if name == "centre_of_mass_m":
        raise ConfigError(f"{name}: vehicle.centre_of_mass_mm in rig.toml states it: change it there.")
    if fault := shape_error(name, parameter.value, parameter.std):
        entries = f": {','.join(ENTRIES)}" if row is not None and row.shape is Shape.MATRIX else ""
        raise ConfigError(f"{name} {fault}, and {len(numbers)} given: write them with commas{entries}.")
    if name == _CUBIC:
        most = campaign.values().find(_MOST)
        if fault := cubic_fault(numbers, max_thrust_n=None if most is None else most.parameter.value):
            raise ConfigError(f"{fault} Nothing was changed.")
    senseless = name in _IN_RIG and numbers[0] <= 0  # rig.toml's own check names the key
    if not senseless and (fault := implausible(name, parameter.value, std=parameter.std, platform=platform)):
        raise ConfigError(f"{fault} Nothing was changed; --force stores it anyway.")


def _into_rig(campaign: "Campaign", name: str, value: float, std: float | None) -> str:
    table, key, std_key = _IN_RIG[name]
    path = change_rig(campaign.folder, table, {key: value} | ({} if std is None else {std_key: std}))
    if std is None and (kept := getattr(getattr(campaign.rig, table), std_key)):
        note(f"the standard uncertainty in rig.toml stays {kept:g}: VALUE:STD changes it.")
    return f"{path}, {table}.{key}. Earlier fits used the old number: fit again."


def _into_parameters(campaign: "Campaign", name: str, parameter: Parameter) -> str:
    unit = unit_of(name)
    if not unit:
        units = ", ".join(UNITS)
        raise ConfigError(f"'{name}': its unit is unknown: end the name with one ({units}).")
    write_parameters(campaign)
    path = campaign.keep_by_hand(name, replace(parameter, unit=unit))
    return f"{path}. It counts before all fits."


def _print_json(sections: "dict[str, Section]", outdated: "Mapping[str, Sequence[str]]") -> None:
    content = {
        "command": "parameters",
        "sections": {
            name: {
                "method": section.method,
                "found": section.found.isoformat(),
                "accepted": section.accepted,
                "parameters": {key: parameter.as_json() for key, parameter in section.parameters.items()},
                "covariance": [asdict(covariance) for covariance in section.covariance],
                "common": section.common,
                "rejected": section.rejected,
                "outdated": list(outdated.get(name, ())),
            }
            for name, section in sections.items()
        },
    }
    print_json(content)


def _print_tables(sections: "dict[str, Section]", outdated: "Mapping[str, Sequence[str]]") -> None:
    if not sections:
        echo("no parameters yet: `cfid fit --help` lists the fits, `cfid set` stores a value.")
    for name, section in sections.items():
        verdict = ("" if section.accepted else ", REJECTED") + (", OUTDATED" if outdated.get(name) else "")
        method = "" if section.method in ("default", "") else f", {section.method}"
        print_parameters(section.parameters, title=f"{name} ({section.found:%Y-%m-%d %H:%M}{method}{verdict})")
        for text in outdated.get(name, ()):
            note(f"{name}: {text}")
        for key in section.parameters:
            if section.accepted and key in section.rejected:
                note(f"{key} was rejected: {section.rejected[key]}")
