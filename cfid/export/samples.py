"""Lists of vehicles drawn from the uncertainties, for RotorPy and crazyflow; each vehicle is an export of its own."""

import ast
import json
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from cfid.export import crazyflow, rotorpy
from cfid.export.hover import value_of
from cfid.export.target import Target, caveats, simulated, unaccepted
from cfid.export.vehicle import ExportVehicle
from cfid.export.wording import HASH, commented
from cfid.records.parameters import Value
from cfid.version import __version__

ROTORPY, CRAZYFLOW = rotorpy.TARGET, crazyflow.TARGET
FILES: Mapping[str, str] = {ROTORPY.name: "samples_rotorpy.py", CRAZYFLOW.name: "samples_crazyflow.json"}

_QUAD = "quad_params"


def with_values(vehicle: ExportVehicle, values: Mapping[str, Value]) -> ExportVehicle:
    """Return a vehicle with other values, given by key; the range of the inverse thrust map follows the map."""
    quantities = {
        name: replace(quantity, value=values.get(quantity.key, quantity.value))
        for name, quantity in vehicle.quantities.items()
    }
    if "thrust_of_command" in quantities and "thrust_range" in quantities:
        poly, known = quantities["thrust_of_command"].value, quantities["thrust_range"]
        quantities["thrust_range"] = replace(known, value=[_of_map(row, poly) for row in known.value])
    gravity, centre = (
        replace(known, value=values.get(known.key, known.value)) for known in (vehicle.gravity, vehicle.centre)
    )
    return replace(vehicle, quantities=quantities, gravity=gravity, centre=centre)


def rendered(target: Target, vehicle: ExportVehicle) -> Any:
    """Return one vehicle as its target exports it: Python source for RotorPy, tables for crazyflow.

    Raises DataError when the target cannot take the vehicle.
    """
    text = target.write(vehicle)
    return _dictionary(text) if target is ROTORPY else next(iter(tomllib.loads(text).values()))


def warnings_of(target: Target, vehicle: ExportVehicle) -> tuple[str, ...]:
    """Return warnings about the sampled quantities that are simulated, implausible, rejected or outdated."""
    of_no_vehicle = simulated(target, vehicle)
    marks = [f"SIMULATED, no vehicle was measured: {', '.join(of_no_vehicle)}."] if of_no_vehicle else []
    marks_of = [f"REJECTED by its fit: {key}." for key in unaccepted(target, vehicle)]
    return (*marks, *caveats(target, vehicle), *marks_of)


def listed(target: Target, drawn: Sequence[Any], comments: Iterable[str]) -> str:
    """Return the file that lists all drawn vehicles."""
    if target is ROTORPY:
        head = commented(comments, HASH)
        return f"{head}\nimport numpy as np\n\nQUADS = [\n{''.join(f'{text},{chr(10)}' for text in drawn)}]\n"
    return json.dumps({"written_by": f"cfid {__version__}", "about": list(comments), "drones": list(drawn)}) + "\n"


def _of_map(row: Mapping[str, Value], poly: Sequence[float]) -> Mapping[str, Value]:
    ends = {
        f"thrust_{end}_n": value_of(poly, row[f"command_{end}"]) for end in ("min", "max") if f"command_{end}" in row
    }
    return {**row, **ends, "coefficients": [*[0.0] * (3 - len(poly)), *poly]}


def _dictionary(text: str) -> str:
    """Return the source text of RotorPy's dictionary in a module."""
    named = {
        node.targets[0].id: node.value
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    return ast.unparse(named[_QUAD])
