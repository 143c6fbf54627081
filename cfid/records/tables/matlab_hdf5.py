"""Read a MATLAB file of version 7.3 with h5py: it is HDF5 whose attributes distinguish MATLAB's types."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cfid.errors import DataError
from cfid.large import empty
from cfid.records.tables.matlab_elements import check_size

Tree = Any

_NODE_BYTES = 1 << 10  # what a struct, a cell or an array has in addition to its numbers


class Hdf5Tree:
    """The variables of an open file. The size that it states for each is counted before that is read."""

    def __init__(self, path: Path, file: Any) -> None:
        """Start with nothing read from a file."""
        self._path, self._file = path, file
        self._bytes = 0

    def content(self) -> dict[str, Tree]:
        """Return the variables by name. Raises DataError for more than the file can hold, or arrays in other files."""
        return {name: self._tree(self._member(self._file, name)) for name in self._file if not name.startswith("#")}

    def _tree(self, node: Any) -> Tree:
        """Return a struct as a dict, a cell array or an array of structs as lists, text as str, numbers as an array."""
        self._count(_NODE_BYTES)
        if not hasattr(node, "dtype"):
            return {name: self._tree(self._member(node, name)) for name in node}
        if node.external or node.is_virtual:
            raise DataError(f"{self._path}: its arrays are in other files, which are not read.")
        self._count(int(node.size or 0) * node.dtype.itemsize)
        if node.dtype == object:  # references
            return [self._tree(self._file[each]) for each in np.ravel(node[()])]
        if "MATLAB_empty" in node.attrs:
            return np.zeros(0)
        values = np.squeeze(_numbers(node))
        if values.dtype.names == ("real", "imag"):
            values = values["real"] + 1j * values["imag"]
        if node.attrs.get("MATLAB_class") == b"char":
            return "".join(map(chr, np.ravel(values)))
        return values.T  # MATLAB's arrays are stored column by column

    def _member(self, group: Any, name: str) -> Any:
        if type(group.get(name, getlink=True)).__name__ == "ExternalLink":
            raise DataError(f"{self._path}: its arrays are in other files, which are not read.")
        return group[name]

    def _count(self, content_bytes: int) -> None:
        self._bytes += content_bytes
        check_size(self._path, self._bytes)


def _numbers(node: Any) -> npt.NDArray[Any]:
    if node.dtype != np.float64 or not node.shape:
        return np.asarray(node[()])
    values = empty(*node.shape)
    if values.size:
        node.read_direct(values)
    return values
