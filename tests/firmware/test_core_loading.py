"""The app's core in the simulated vehicle is compiled once, or an error names what is missing and the alternative."""

from pathlib import Path

import pytest

from cfid.errors import DeviceError
from cfid.sim.app_core import compiled, find_source

WAY_OUT = r'gcc.*firmware = "stock"'


def test_without_a_compiler_the_error_names_gcc_and_the_way_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DeviceError, match=WAY_OUT):
        compiled(find_source())
