"""The app's core in the simulated vehicle is compiled once, or an error names what is missing and the alternative."""

import shutil
from pathlib import Path

import pytest

from cfid.errors import DeviceError
from cfid.sim.app_core import CorePacket, compiled, find_source, load_library

WAY_OUT = r'gcc.*firmware = "stock"'


def test_the_source_is_found_beside_the_package() -> None:
    assert find_source().parts[-4:] == ("firmware_patches", "cfid_app", "src", "cfid_core.c")


@pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="there is no C compiler")
def test_with_a_compiler_it_is_compiled_once() -> None:
    assert load_library() is load_library()


def test_without_a_compiler_the_error_names_gcc_and_the_way_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DeviceError, match=WAY_OUT):
        compiled(find_source())


def test_with_a_compiler_that_fails_it_does_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    compiler = tmp_path / "cc"
    compiler.write_text("#!/bin/sh\nexit 1\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DeviceError, match=f"exit 1.*{WAY_OUT}"):
        compiled(find_source())


def test_a_packet_takes_no_more_than_the_link_does() -> None:
    assert CorePacket.of(2, 1, bytes(30)).payload == bytes(30)
    with pytest.raises(ValueError, match="31 bytes"):
        CorePacket.of(2, 1, bytes(31))
