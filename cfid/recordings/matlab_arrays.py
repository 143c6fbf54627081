"""Store the arrays of numbers of a MATLAB file in a folder: run as a process of its own, which imports little.

SciPy trusts the types that a file states: a damaged one ends the process that reads it, and no error can be caught.
"""

import json
import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

VERSION_5 = b"MATLAB 5.0 MAT-file"

_NO_NAME = str.maketrans(dict.fromkeys(',;\t\r\n"', " "))


def is_version_5(path: Path) -> bool:
    """Return whether a MATLAB file is of version 5 to 7.2."""
    with path.open("rb") as file:
        return file.read(len(VERSION_5)) == VERSION_5


def main(path: str, folder: str) -> None:
    """Store each array of numbers of a file in a folder, and their names."""
    names: list[str] = []
    for name, values in _leaves(_loaded(Path(path)), ""):
        np.save(Path(folder) / f"{len(names)}.npy", values)
        names.append(name)
    (Path(folder) / "names.json").write_text(json.dumps(names), encoding="utf-8")


def _loaded(path: Path) -> dict[str, Any]:
    if is_version_5(path):
        content = import_module("scipy.io").loadmat(path, simplify_cells=True)
        return {name: value for name, value in content.items() if name[0] != "_"}
    with import_module("h5py").File(path, "r") as file:
        return {name: _of_hdf5(file, file[name]) for name in file if not name.startswith("#")}


def _of_hdf5(file: Any, node: Any) -> Any:
    """Return a struct as a dict, an array of structs or a cell array as a list, text as str, numbers as an array."""
    if not hasattr(node, "dtype"):
        return {name: _of_hdf5(file, node[name]) for name in node}
    if node.dtype == object:  # references
        return [_of_hdf5(file, file[one]) for one in np.ravel(node[()])]
    values = np.squeeze(node[()])
    if node.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, np.ravel(values)))
    return np.zeros(0) if "MATLAB_empty" in node.attrs else values.T  # MATLAB's arrays are stored column by column


def _leaves(tree: Mapping[str, Any], place: str) -> list[tuple[str, npt.NDArray[Any]]]:
    """Return the arrays of one or two dimensions in a struct at a place, "" for the file, and in the structs inside."""
    if "signals" in tree:
        return _of_simulink(tree, place)
    found = []
    for key, value in tree.items():
        name = f"{place}.{key}" if place else key
        if isinstance(value, Mapping):
            found += _leaves(value, name)
        elif _is_numeric(value):
            found.append((name, np.squeeze(value)))
    return found


def _of_simulink(tree: Mapping[str, Any], place: str) -> list[tuple[str, npt.NDArray[Any]]]:
    """Return the arrays of a struct with `time` and `signals`, each of which has `values` and perhaps a `label`."""
    signals = tree["signals"]
    if isinstance(signals, Mapping) and isinstance(signals.get("values"), list):  # as HDF5 has several
        signals = [dict(zip(signals, one, strict=True)) for one in zip(*signals.values(), strict=True)]
    signals = [signals] if isinstance(signals, Mapping) else list(signals)
    found = [("time", np.squeeze(tree["time"]))] if _is_numeric(tree.get("time")) else []
    for number, signal in enumerate(signals, start=1):
        label = signal.get("label")
        own = label if isinstance(label, str) and label else place if len(signals) == 1 else f"{place}_{number}"
        if _is_numeric(signal.get("values")):
            found.append((_printable(own), np.squeeze(signal["values"])))
    return found


def _is_numeric(value: Any) -> bool:
    return (
        isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size > 1 and np.squeeze(value).ndim < 3
    )


def _printable(label: str) -> str:
    """Return a label as the name of a column."""
    return "".join(letter if letter.isprintable() else " " for letter in label.translate(_NO_NAME)).strip()


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except Exception as fault:  # a damaged file may make these libraries raise anything
        raise SystemExit(str(fault) or type(fault).__name__) from None  # with code 1
