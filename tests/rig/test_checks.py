"""What a check of the rig finds, and that it always returns its findings."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from cfid.records.rig_file import LoadCellBox
from cfid.rig.check import DeviceAnswer, check_loadcell, judge_buffer
from cfid.rig.rdt_port import RECEIVE_BUFFER_BYTES, enlarge
from tests.rig.streaming_rig import ServedRig, served_rig


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[ServedRig]:
    with served_rig(tmp_path) as rig:
        yield rig


def about(asked: str, findings: list[DeviceAnswer]) -> DeviceAnswer:
    (finding,) = [finding for finding in findings if finding.asked == asked]
    return finding


def test_a_receive_buffer_that_the_system_caps_is_reported(rig: ServedRig) -> None:
    assert isinstance(rig.devices.loadcell, LoadCellBox)
    sound = check_loadcell(rig.devices.loadcell)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        assert about("receive buffer", sound) == judge_buffer(enlarge(line))
    capped = judge_buffer(RECEIVE_BUFFER_BYTES - 1)

    assert about("RDT, UDP", sound).state == "ok"
    assert judge_buffer(RECEIVE_BUFFER_BYTES).state == "ok"
    assert capped.state == "warning"
    assert "the system caps it: `sysctl net.core.rmem_max=" in capped.advice
