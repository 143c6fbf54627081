"""Render a target's template for a vehicle, and put the comments at the head of the file.

Jinja's sandbox keeps a template, which others may have written, from everything but the numbers it is given.
"""

import contextlib
import re
import textwrap
import traceback
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from jinja2 import PackageLoader, StrictUndefined, Template
from jinja2.sandbox import ImmutableSandboxedEnvironment

from cfid.errors import CfidError, ConfigError, DataError
from cfid.export import vehicle_json
from cfid.export.derived import Derived, entries
from cfid.export.target import Target, caveats, check_sense, need_keys
from cfid.export.vehicle import ExportVehicle
from cfid.units import FULL_COMMAND
from cfid.version import __version__

_LINES, _WIDTH = 12, 114  # of the comments at the head of a file, without the signs that begin them


def rendered(target: Target, vehicle: ExportVehicle) -> str:
    """Return the whole file of a target.

    Raises DataError when a quantity that the target needs was not measured or makes no sense there, and ConfigError for
    a fault in a campaign's own template.
    """
    check_sense(target, vehicle)
    body = _own_body(target, vehicle) if target.own else _body(target, vehicle)
    if not target.comment:
        return body
    head = commented(_head(target, vehicle), target.comment)
    if body.startswith(("<?xml", "#!", "#VRML")):  # such a line must stay first
        declaration, _, rest = body.partition("\n")
        return f"{declaration}\n{head}{rest}"
    return head + body


def module(target: Target, vehicle: ExportVehicle) -> Any:
    """Return a rendered template, whose variables are attributes."""
    return _compiled(target.template).make_module(_context(target, vehicle))


def _body(target: Target, vehicle: ExportVehicle) -> str:
    if target.name == "json":
        return vehicle_json.text_of(vehicle)
    return _compiled(target.template).render(_context(target, vehicle))


def _context(target: Target, vehicle: ExportVehicle) -> dict[str, Any]:
    """Return what a template sees: no quantity that its head does not state, since such a one was not judged."""
    taken = {quantity.key: quantity for quantity in target.taken(vehicle)}
    derived = Derived(replace(vehicle, quantities=taken))
    head = [] if target.comment else _head(target, vehicle)  # for a format without comments, which may have a place
    return {"v": _Turned(derived) if target.own else derived, "head": head}


class _Turned:
    """What a campaign's own template sees: nothing in the campaign's frame, which an author may take for the file's."""

    def __init__(self, derived: Derived) -> None:
        self._derived = derived

    def __getitem__(self, key: str) -> Any:
        """Return the value of a quantity that has no direction. Raises DataError for another one."""
        if key.startswith(("inertia.", "drag.")) or key == "centre_of_mass_m":
            raise DataError(f"{key} is in the campaign's frame: take what is derived, such as v.inertia_kg_m2.")
        return self._derived[key]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._derived, name)


def _own_body(target: Target, vehicle: ExportVehicle) -> str:
    try:
        return _body(target, vehicle)
    except CfidError:
        raise
    except Exception as error:  # whatever an expression in a template raises
        rows = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == "<template>"]
        place = f", line {getattr(error, 'lineno', None) or (rows or [1])[-1]}"
        raise ConfigError(f"{target.name}.j2{place}: {type(error).__name__}: {str(error).rstrip('.')}.") from None


def _head(target: Target, vehicle: ExportVehicle) -> list[str]:
    """Return the comments: what the file is and of what, its frame, hovering, and what it leaves out."""
    since = f", values of {vehicle.measured}" if vehicle.measured else ""
    published = vehicle.published
    origin = f"campaign {vehicle.campaign}{since}" if published is None else f"published set {published.name}"
    above = textwrap.wrap(f"{target.about}: {vehicle.name}, {origin}, by cfid {__version__}.", _WIDTH, max_lines=2)
    lines = textwrap.wrap(target.note, _WIDTH)
    if target.frame != "none":
        axes = f"forward {vehicle.frame.forward}, left {vehicle.frame.left}, up {vehicle.frame.up}"
        where = "campaign" if published is None else "set"
        lines.append(f"Axes: x forward, y left, z up, from the centre of mass. In the {where}: {axes}.")
    with contextlib.suppress(DataError):
        lines.append(_hovering(vehicle))
    left_out = {
        "NOT MEASURED" if published is None else "NOT STATED": map(need_keys, target.not_measured(vehicle)),
        "No place in this format": target.no_place(vehicle),
    }
    sentences = [f"{reason}: {names}." for reason, of in left_out.items() if (names := ", ".join(of))]
    lines += textwrap.wrap(" ".join(sentences), _WIDTH, max_lines=4)
    lines += textwrap.wrap(_origins(target, vehicle), _WIDTH, max_lines=2)
    marks: dict[str, list[str]] = {}
    for caveat, keys in caveats(target, vehicle).items():
        marks.setdefault(caveat.mark, []).extend(keys)
    warnings = " ".join(f"{mark}: {', '.join(dict.fromkeys(keys))}." for mark, keys in marks.items())
    above += textwrap.wrap(warnings, _WIDTH, max_lines=_LINES - len(above) - len(lines), placeholder=" ...")
    return above + lines


def _origins(target: Target, vehicle: ExportVehicle) -> str:
    """Return where uncertainties and origins are, or what a published set states of them."""
    if vehicle.published is None:
        return "Uncertainties and origins: `cfid parameters`, and as numbers `cfid export json`."
    stated = [quantity.key for quantity in target.taken(vehicle) if quantity.std is not None]
    of = f"uncertainties of {', '.join(stated)} alone" if stated else "no uncertainties"
    return f"Nothing was measured here, and the source states {of}: {vehicle.published.source}."


def _hovering(vehicle: ExportVehicle) -> str:
    """Return what hovering takes, to check a simulation; the rotor speed comes from two maps if both are known."""
    v = Derived(vehicle)
    parts = [f"Hovering: {v.hover_thrust_n:.4g} N a motor"]
    if v.has("motor.thrust_poly"):
        parts.append(f"command {v.hover_command:.0f} of {FULL_COMMAND}")
        if v.has("motor.speed_poly"):
            parts.append(f"{v.hover_command_speed_rad_s:.1f} rad/s by that command")
    if v.has("motor.thrust_per_speed_squared_n_s2"):
        parts.append(f"{v.hover_speed_rad_s:.1f} rad/s by that thrust")
    return f"{', '.join(parts)}."


def commented(lines: Iterable[str], style: str) -> str:
    """Return lines as comments, whatever they contain, since names come from files that people write."""
    safe = ["".join(c if c.isprintable() else "?" for c in line).rstrip("\\ ") for line in lines]
    if style == "<!--":
        return "<!-- " + "\n     ".join(re.sub("-(?=-)", "- ", line) for line in safe) + " -->\n"
    return "".join(f"{style} {line}".rstrip() + "\n" for line in safe)


def number(value: float) -> str:
    """Return a number that C, TOML, YAML, JSON, XML and Python all read as a floating-point number."""
    mantissa, exponent_mark, exponent = f"{value + 0.0:.10g}".partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}{exponent_mark}{exponent}"


def numbers(values: Iterable[float], separator: str = ", ") -> str:
    """Return numbers with a separator between them."""
    return separator.join(map(number, values))


def matrix(rows: Iterable[Sequence[float]]) -> str:
    """Return a matrix as a nested list of TOML, JSON and Python."""
    return f"[{', '.join(f'[{numbers(row)}]' for row in rows)}]"


def identifier(name: str) -> str:
    """Return a name reduced to letters, digits and underscores."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in name).strip("_") or "vehicle"


_ENVIRONMENT = ImmutableSandboxedEnvironment(
    loader=PackageLoader("cfid.export", "targets"),  # to include what templates of the package share
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_ENVIRONMENT.filters |= {"n": number, "ns": numbers, "matrix": matrix, "entries": entries, "identifier": identifier}


@cache
def _compiled(template: str) -> Template:
    return _ENVIRONMENT.from_string(template)
