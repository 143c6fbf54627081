"""What a check of the rig finds, and that it always comes back with what it found."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from cfid.rig import check
from cfid.rig.check import DeviceAnswer, check_loadcell
from tests.rig.streaming_rig import ServedRig, served_rig


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[ServedRig]:
    with served_rig(tmp_path) as rig:
        yield rig


def about(asked: str, findings: list[DeviceAnswer]) -> DeviceAnswer:
    (finding,) = [finding for finding in findings if finding.asked == asked]
    return finding


def test_a_receive_buffer_that_the_system_caps_is_told(rig: ServedRig, monkeypatch: pytest.MonkeyPatch) -> None:
    sound = check_loadcell(rig.devices.loadcell)
    monkeypatch.setattr(check, "RECEIVE_BUFFER_BYTES", 1 << 40)  # which no system grants
    capped = about("receive buffer", check_loadcell(rig.devices.loadcell))

    assert about("RDT, UDP", sound).state == "ok"
    assert capped.state == "warning"
    assert "the system caps it: `sysctl net.core.rmem_max=" in capped.advice
