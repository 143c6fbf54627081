"""Read exports back with the parsers of their formats."""

import runpy
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from cfid.export.render import rendered
from cfid.export.target import targets
from cfid.export.vehicle import ExportVehicle

TARGETS, _ = targets(Path())


def export(name: str, vehicle: ExportVehicle) -> str:
    """Return the text of an export."""
    return rendered(TARGETS[name], vehicle)


def toml(name: str, vehicle: ExportVehicle) -> dict[str, Any]:
    """Return an export read as TOML."""
    return tomllib.loads(export(name, vehicle))


def xml(name: str, vehicle: ExportVehicle) -> ET.Element:
    """Return the root of an export read as XML."""
    return ET.fromstring(export(name, vehicle))


def attributes(element: ET.Element | None) -> dict[str, float]:
    """Return an element's attributes as numbers."""
    assert element is not None
    return {key: float(value) for key, value in element.attrib.items()}


def python(name: str, vehicle: ExportVehicle, folder: Path) -> dict[str, Any]:
    """Run an export as Python, and return the parameters that it defines."""
    path = folder / "vehicle_params.py"
    path.write_text(export(name, vehicle))
    found: dict[str, Any] = runpy.run_path(str(path))["quad_params"]
    return found


def drone(vehicle: ExportVehicle) -> dict[str, Any]:
    """Return what an export for crazyflow states of the vehicle."""
    found: dict[str, Any] = {"__name__": "crazyflow_drone"}
    exec(export("crazyflow", vehicle), found)
    own: dict[str, Any] = found["FIRST_PRINCIPLES"]
    return own


def yaml(name: str, vehicle: ExportVehicle) -> Any:
    """Return an export read as YAML."""
    parser = pytest.importorskip("yaml", reason="PyYAML is not installed")
    return parser.safe_load(export(name, vehicle))


def macros(text: str) -> dict[str, float]:
    """Return the numbers that a C header defines."""
    words = [line.split() for line in text.splitlines() if line.startswith("#define")]
    return {word[1]: float(word[2].removesuffix("f")) for word in words}
