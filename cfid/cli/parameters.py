"""`cfid parameters` and `cfid set`: list a campaign's parameters, and store parameters measured by hand."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
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
    """List the campaign's parameters, each with its standard uncertainty, unit and origin.

    Of all kept fits of a parameter, the most certain of those that are accepted and current counts.

    Example: [bold]cfid parameters --why motor.max_thrust_n[/bold]
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
            metavar="VALUE[:STD]",
            help="A number and its standard uncertainty; motor.thrust_voltage_poly takes four numbers, separated by "
            "commas.",
        ),
    ],
    *,
    force: Annotated[bool, typer.Option("--force", help="Store an implausible value anyway.")] = False,
) -> None:
    """Store a value measured by hand. Values that belong in rig.toml, such as the mass, are changed there.

    A thrust over motor voltage is stored only if the firmware can invert it.

    Example: [bold]cfid set mass_kg 0.0280:0.0001[/bold]
    """
    campaign = here()
    words, colon, spread = value.partition(":")
    numbers = _numbers(words, name)
    if "," in spread or (len(numbers) > 1 and (colon or name != _CUBIC)):
        raise ConfigError(f"{name}: '{value}' is not a number, alone or with its standard uncertainty.")
    std = _numbers(spread, name)[0] if colon else None
    if std is not None and std <= 0:
        raise ConfigError(
            f"{name}: a standard uncertainty of {std:g} is not above zero, and nothing measured is exact: state it, or "
            "leave it out where it is unknown."
        )
    if name == _CUBIC:
        most = campaign.values().find(_MOST)
        if fault := cubic_fault(numbers, max_thrust_n=None if most is None else most.parameter.value):
            raise ConfigError(f"{fault} Nothing was changed.")
        where = _into_parameters(campaign, name, numbers, None)
    else:
        _check(name, numbers[0], std, platform="other" if force else campaign.rig.vehicle.platform)
        into = _into_rig if name in _IN_RIG else _into_parameters
        where = into(campaign, name, numbers[0], std)
    stated = ", ".join(f"{number:g}" for number in numbers)
    echo(f"{name} is {stated}{f' +- {std:g}' if std is not None else ''}: {where}")


def _numbers(words: str, name: str) -> list[float]:
    try:
        return [float(word) for word in words.split(",")]
    except ValueError:
        raise ConfigError(f"{name}: '{words}' is not a number.") from None


def _check(name: str, value: float, std: float | None, *, platform: "Platform") -> None:
    row = find(name)
    is_single = row is not None and row.shape is Shape.NUMBER and not row.of_the_run
    if not _NAME.fullmatch(name) and not is_single:
        raise ConfigError(f"'{name}': a name has small letters, digits and single underscores, like arm_m.")
    if not math.isfinite(value) or (std is not None and not math.isfinite(std)):
        raise ConfigError(f"{name}: a value and its standard uncertainty must be finite numbers.")
    senseless = value <= 0 and name in _IN_RIG  # rig.toml's own check names the key
    if not senseless and (fault := implausible(name, value, platform=platform)):
        raise ConfigError(f"{fault} Nothing was changed; --force stores it anyway.")


def _into_rig(campaign: "Campaign", name: str, value: float, std: float | None) -> str:
    table, key, std_key = _IN_RIG[name]
    path = change_rig(campaign.folder, table, {key: value} | ({} if std is None else {std_key: std}))
    if std is None and (kept := getattr(getattr(campaign.rig, table), std_key)):
        note(f"the standard uncertainty in rig.toml stays {kept:g}: VALUE:STD changes it.")
    return f"{path}, {table}.{key}. Earlier fits used the old number: fit again."


def _into_parameters(campaign: "Campaign", name: str, value: float | list[float], std: float | None) -> str:
    unit = unit_of(name)
    if not unit:
        units = ", ".join(UNITS)
        raise ConfigError(f"'{name}': its unit is unknown: end the name with one ({units}).")
    write_parameters(campaign)
    path = campaign.keep_by_hand(name, Parameter(value=value, std=std, unit=unit))
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
