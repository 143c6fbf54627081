"""Tachometer, scales and typed readings: each present reading is a row when it came, all else is set aside."""

import os
import pty
import termios
import tty
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.errors import DeviceError
from cfid.rig.hand_held import HandHeld, Readings, Scales, Ut372
from cfid.rig.hardware import Real
from cfid.rig.loop import Ending
from cfid.rig.ports import hid_nodes
from cfid.wire.ut372 import USB_PRODUCT, USB_VENDOR
from tests.virtual_lab import STARTED_S, UNIX_S, Board, Lab, Recorded, recorded

PACKET = b"070?<3=7<60655>607;007885\r\n"  # from a real tachometer, of 1353.7 rpm: see tests/wire/test_ut372.py
HELD = PACKET[:21] + b"7<85\r\n"
COUNTED = PACKET[:23] + b"86\r\n"
LARGEST = PACKET[:23] + b"95\r\n"
SET_UP = PACKET[:23] + b"84\r\n"
LINE = b"ST,GS,+0001.23 kg\r\n"


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path)


scales = partial(Scales, baud=9600)


class Log(Recorded):
    """A recording of an instrument that sends something at each period; things happen `at` seconds from its start."""

    def __init__(
        self,
        lab: Lab,
        make: Callable[[str], HandHeld],
        sent: Callable[[int], bytes] | bytes,
        *,
        for_s: float | None = None,
        period_s: float = 0.5,
        port: str = "ttyUSB0",
        at: dict[float, Callable[[], object]] | None = None,
    ) -> None:
        board = Board(sent if callable(sent) else lambda n: sent, rate_hz=1 / period_s)
        instrument = make(lab.plug_in(board, f"{lab.port}/{port}"))
        for seconds, act in (at or {}).items():
            lab.hardware.at(seconds, act)
        begun_s = lab.hardware.seconds()
        run, self.error, _ = recorded(lab.hardware, lab.folder, instrument, for_s=for_s)
        self.took_s = lab.hardware.seconds() - begun_s
        super().__init__(run, instrument.name, begun_s=begun_s)


@pytest.mark.parametrize("port", ["ttyUSB0", "hidraw0"])
def test_what_a_tachometer_shows_is_a_row_when_it_comes(lab: Lab, port: str) -> None:
    """Behind its USB bridge the bytes come in reports, of which the first byte counts the others."""

    def report(n: int) -> bytes:
        part = PACKET[7 * (n % 4) :][:7]
        return bytes([0xF0 + len(part)]) + part.ljust(7, b"\0")

    is_serial = port == "ttyUSB0"
    log = Log(lab, Ut372, PACKET if is_serial else report, for_s=20, period_s=0.5 if is_serial else 0.125, port=port)

    assert log.error is None
    assert list(log.rows.columns) == ["t", "rpm"]
    assert set(log.rows["rpm"]) == {1353.7}
    assert np.diff(log.times_s) == pytest.approx(0.5, abs=0.002)
    assert len(log.rows) in (39, 40)
    assert log.device.lost is None
    assert (log.facts["rejected"], log.facts["set_aside"]) == (0, 0)


@pytest.mark.parametrize(
    ("lines", "shown", "rejected"),
    [
        ([LINE, b"US,NT,-  12.3 g\r\n", b"what?\r\n", b"S S     12.34 g\r\n"], [[1230, 1], [-12.3, 0], [12.34, 1]], 1),
        ([b"\n 12.34 g\r\n"] * 3, [[12.34, -1]] * 3, 0),
    ],
)
def test_what_scales_say_is_a_row_with_whether_it_is_stable(
    lab: Lab, lines: list[bytes], shown: list[list[float]], rejected: int
) -> None:
    log = Log(lab, scales, lambda n: lines[n] if n < len(lines) else b"", for_s=9, period_s=2)

    assert log.error is None
    assert log.rows[["grams", "stable"]].to_numpy().tolist() == shown
    assert log.device.lost is None  # scales state neither a rate nor a clock
    assert (log.facts["rejected"], log.facts["baud"]) == (rejected, 9600)


INSTRUMENTS = [(Ut372, PACKET), (scales, LINE)]


@pytest.mark.parametrize(("make", "sent"), INSTRUMENTS)
def test_ten_seconds_of_silence_or_a_pulled_plug_end_a_run_and_keep_its_rows(
    lab: Lab, make: Callable[[str], HandHeld], sent: bytes
) -> None:
    silent = Log(lab, make, lambda n: sent if n < 6 else b"", period_s=1)
    pulled = Log(lab, make, sent, period_s=1, at={3.2: partial(lab.unplug, f"{lab.port}/ttyUSB0")})

    for log, rows, took_s in ((silent, 6, 15.05), (pulled, 4, 3.25)):
        assert isinstance(log.error, DeviceError)
        assert log.run.header.state == "failed"
        assert len(log.rows) == rows
        assert log.took_s == pytest.approx(took_s, abs=0.1)
    assert lab.hardware.ports[f"{lab.port}/ttyUSB0"].receiver is None


@pytest.mark.parametrize(("shown", "word"), [(HELD, "HOLD"), (COUNTED, "HOLD"), (LARGEST, "HOLD"), (SET_UP, "set-up")])
def test_what_is_no_present_speed_is_set_aside_and_said_when_nothing_else_comes(
    lab: Lab, shown: bytes, word: str
) -> None:
    packets = chain([PACKET], repeat(shown))
    log = Log(lab, Ut372, lambda n: next(packets))

    assert word in str(log.error)
    assert len(log.rows) == 1
    assert log.facts["rejected" if shown == SET_UP else "set_aside"] == pytest.approx(20, abs=1)


def test_typed_readings_are_rows_at_the_time_of_typing_and_a_withdrawn_one_is_repeated(lab: Lab) -> None:
    readings = Readings("rpm")
    lab.hardware.at(20, readings.add, 2000, 1353.7)
    lab.hardware.at(40, readings.add, 4000, 2711.0)
    lab.hardware.at(45, readings.withdraw)
    begun_s = lab.hardware.seconds()
    run, error, _ = recorded(lab.hardware, lab.folder, readings, for_s=50)
    rows = pd.read_csv(run.device_file("readings")).to_numpy()

    assert error is None
    times_s = UNIX_S - STARTED_S + begun_s + np.array([20, 40, 45])
    assert rows[:, 0] == pytest.approx(times_s, abs=0.01)
    assert rows[:, 1:].tolist() == [[2000, 1353.7, 0], [4000, 2711, 0], [4000, 2711, 1]]
    assert (readings.commands, readings.values) == ([2000], [1353.7])


# Ports of this computer


@pytest.fixture
def ends() -> Iterator[tuple[int, str]]:
    """The device's end of a serial port, and the path of the other."""
    device, host = pty.openpty()
    tty.setraw(host)
    yield device, os.ttyname(host)
    os.close(device)
    os.close(host)


@pytest.mark.parametrize(("make", "baud", "sent"), [(Ut372, 2400, PACKET), (scales, 9600, LINE)])
def test_ports_run_at_their_instruments_speed(
    ends: tuple[int, str], make: Callable[[str], HandHeld], baud: int, sent: bytes
) -> None:
    device, path = ends
    hardware, instrument = Real(), make(path)

    async def main(_: Ending) -> tuple[list[Any], int]:
        instrument.start(hardware)
        settings = termios.tcgetattr(device)
        os.write(device, sent)
        rows = 0
        while not rows:
            await hardware.sleep(0.01)
            rows = len(instrument.take().columns[0])
        instrument.close()
        return settings, rows

    settings, rows = hardware.run(main)
    assert rows == 1
    assert settings[4] == settings[5] == getattr(termios, f"B{baud}")
    assert settings[2] & termios.CSIZE == termios.CS8
    assert not settings[2] & (termios.PARENB | termios.CSTOPB)


def add_hidraw(root: Path, name: str, hid_id: str) -> None:
    """Add a device as Linux presents it: its node, and the properties of the HID device behind that node."""
    folder = root / "sys/class/hidraw" / name / "device"
    folder.mkdir(parents=True)
    (folder / "uevent").write_text(f"DRIVER=hid-generic\nHID_ID={hid_id}\nHID_NAME=device\nHID_UNIQ=\n")


def test_the_tachometer_is_found_among_other_devices_by_its_usb_number(tmp_path: Path) -> None:
    add_hidraw(tmp_path, "hidraw0", "0003:0000046D:0000C52B")
    add_hidraw(tmp_path, "hidraw1", "0003:00001A86:0000E008")
    add_hidraw(tmp_path, "hidraw2", "0005:00001A86:0000E429")

    assert hid_nodes(USB_VENDOR, USB_PRODUCT, tmp_path) == [str(tmp_path / "dev/hidraw1")]
