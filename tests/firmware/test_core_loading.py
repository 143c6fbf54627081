"""Which core runs on this machine: the C one where it can be compiled, else its twin in Python."""

import shutil
from pathlib import Path

import pytest

from cfid.sim import app_core
from cfid.sim.app_core import Packet, find_source, load_core, load_library


def test_the_source_is_found_beside_the_package() -> None:
    source = find_source()
    assert source is not None
    assert source.parts[-4:] == ("firmware_patches", "cfid_app", "src", "cfid_core.c")


@pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="there is no C compiler")
def test_with_a_compiler_it_is_the_c_core_compiled_once() -> None:
    assert load_core().implementation == "C"
    assert load_library() is load_library()


def uncached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app_core, "load_library", load_library.__wrapped__)


def test_without_a_compiler_it_is_the_python_core(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    uncached(monkeypatch)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert load_core().implementation == "Python"


def test_without_the_source_it_is_the_python_core(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    uncached(monkeypatch)
    monkeypatch.setattr(app_core, "_PLACES", (tmp_path,))
    assert load_core().implementation == "Python"


def test_with_a_compiler_that_fails_it_is_the_python_core(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    uncached(monkeypatch)
    compiler = tmp_path / "cc"
    compiler.write_text("#!/bin/sh\nexit 1\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert load_core().implementation == "Python"


def test_a_packet_takes_no_more_than_the_link_does() -> None:
    assert Packet.of(2, 1, bytes(30)).payload == bytes(30)
    with pytest.raises(ValueError, match="31 bytes"):
        Packet.of(2, 1, bytes(31))
