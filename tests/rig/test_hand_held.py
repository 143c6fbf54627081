"""Tachometer, scales and typed readings, over pseudo terminals in the loop and on a clock that the test advances."""

import math
import os
import socket
import sys
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.errors import DeviceError
from cfid.records.run import Run
from cfid.rig.clock import HostClock
from cfid.rig.encoder import Receiver
from cfid.rig.hand_held import HandHeld, Readings, ScalesParser, Ut372Parser
from cfid.rig.listening import HidrawPort, Listen, Port, find_ut372, serial_ports, ut372_ports
from cfid.rig.loop import Ending, Loop, run_until_done
from cfid.rig.recorder import Block, Instrument, sleep
from tests.rig.virtual import UNIX_S, Session, rows_of

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo terminals of Unix")

PACKET = b"070?<3=7<60655>607;007885\r\n"  # from a real tachometer, of 1353.7 rpm: see tests/wire/test_ut372.py
HELD = PACKET[:21] + b"7<85\r\n"
COUNTED = PACKET[:23] + b"86\r\n"
LARGEST = PACKET[:23] + b"95\r\n"
SET_UP = PACKET[:23] + b"84\r\n"
LINE = b"ST,GS,+0001.23 kg\r\n"


class Cable:
    """A cable whose far end the test holds."""

    def __init__(self) -> None:
        self.receiver: Receiver | None = None
        self.closed = 0

    def listen(self, port: str, receiver: Receiver) -> Port:
        self.receiver = receiver
        return self

    def send(self, data: bytes) -> None:
        assert self.receiver is not None
        if not self.closed:
            self.receiver.received(data)

    def pull(self) -> None:
        assert self.receiver is not None
        self.receiver.disconnected()

    def close(self) -> None:
        self.closed += 1


def tachometer(session: Session) -> tuple[HandHeld, Cable]:
    cable = Cable()
    return HandHeld("port", Ut372Parser(), listen=cable.listen, loop=session.clock, clock=session.host), cable


def scales(session: Session) -> tuple[HandHeld, Cable]:
    cable = Cable()
    return HandHeld("port", ScalesParser(), listen=cable.listen, loop=session.clock, clock=session.host), cable


def every(period_s: float, act: Callable[[], None], *, until_s: float = math.inf) -> Callable[[float], None]:
    """Return a function for every step of a session, which acts every `period_s`, first after one period."""
    due_s = period_s

    def step(now_s: float) -> None:
        nonlocal due_s
        if due_s <= now_s < until_s:
            due_s += period_s
            act()

    return step


def at_another_speed(data: bytes, *, sent_baud: int, read_baud: int) -> bytes:
    """Return the bytes that a port reads at the wrong speed: it samples the level of the line at its own bit times."""
    levels = [level for byte in data for level in (0, *(byte >> bit & 1 for bit in range(8)), 1)] + [1] * 20
    found, at = [], 0.0
    step = sent_baud / read_baud
    while at < len(levels) - 12:
        if levels[int(at)]:
            at += step / 8
            continue
        bits = [levels[min(int(at + (1.5 + bit) * step), len(levels) - 1)] for bit in range(8)]
        found.append(sum(level << bit for bit, level in enumerate(bits)))
        at += 9.5 * step
    return bytes(found)


def facts(run: Run, device: str) -> dict[str, Any]:
    return dict(run.header.devices[device].model_extra or {})


def test_what_a_tachometer_shows_is_recorded_when_it_comes(session: Session) -> None:
    instrument, cable = tachometer(session)

    run, failure = session.record(instrument, for_s=60, also=every(0.5, lambda: cable.send(PACKET)))
    rows = rows_of(run, "tachometer")

    assert failure is None
    assert list(rows.columns) == ["t", "rpm"]
    assert rows["rpm"].tolist() == [1353.7] * len(rows)
    assert rows["t"].to_numpy() == pytest.approx(UNIX_S + 0.5 * np.arange(1, len(rows) + 1), abs=0.006)
    assert len(rows) in (119, 120)
    assert instrument.latest is not None
    assert instrument.latest == pytest.approx((1353.7, 0.5 * len(rows)), abs=0.006)
    assert facts(run, "tachometer") == {"rejected": 0, "set_aside": 0}
    assert cable.closed == 1


def test_what_scales_say_is_recorded_with_whether_it_is_stable(session: Session) -> None:
    instrument, cable = scales(session)
    lines = iter([LINE, b"US,NT,-  12.3 g\r\n", b"what?\r\n", b"S S     12.34 g\r\n"])

    run, failure = session.record(instrument, for_s=9, also=every(2, lambda: cable.send(next(lines))))
    rows = rows_of(run, "scales")

    assert failure is None
    assert rows[["grams", "stable"]].to_numpy().tolist() == [[1230, 1], [-12.3, 0], [12.34, 1]]
    assert run.header.devices["scales"].lost is None  # scales state neither a rate nor a clock
    assert facts(run, "scales") == {"rejected": 1}


def test_scales_that_do_not_say_whether_it_is_stable_are_recorded_so(session: Session) -> None:
    instrument, cable = scales(session)

    run, failure = session.record(instrument, for_s=3, also=every(1, lambda: cable.send(b"\n 12.34 g\r\n")))

    assert failure is None
    assert set(rows_of(run, "scales")["stable"]) == {-1}


@pytest.mark.parametrize("make", [tachometer, scales])
def test_ten_seconds_of_silence_end_a_run_and_keep_its_rows(
    session: Session, make: Callable[[Session], tuple[Instrument, Cable]]
) -> None:
    instrument, cable = make(session)
    sent = {"tachometer": PACKET, "scales": LINE}[instrument.name]

    run, failure = session.record(instrument, for_s=None, also=every(1, lambda: cable.send(sent), until_s=5.5))

    assert isinstance(failure, DeviceError)
    assert f"in 10 s the {instrument.name} sent nothing" in str(failure)
    assert str(failure).count("\n") == 0
    assert len(rows_of(run, instrument.name)) == 5
    assert session.clock.seconds() == pytest.approx(15.05, abs=0.1)
    assert cable.closed == 1


@pytest.mark.parametrize(("make", "sent"), [(tachometer, PACKET), (scales, LINE)])
@pytest.mark.parametrize("factor", [0.25, 0.5, 2, 4, 8])
def test_a_port_at_another_speed_ends_a_run_and_makes_no_row(
    session: Session,
    make: Callable[[Session], tuple[Instrument, Cable]],
    sent: bytes,
    factor: float,
) -> None:
    instrument, cable = make(session)
    received = at_another_speed(sent, sent_baud=2400, read_baud=int(2400 * factor))
    assert received

    run, failure = session.record(instrument, for_s=None, also=every(0.5, lambda: cable.send(received)))

    assert isinstance(failure, DeviceError)
    assert "bytes without a reading" in str(failure)
    assert ("2400 baud" if instrument.name == "tachometer" else "another speed") in str(failure)
    assert len(rows_of(run, instrument.name)) == 0


def test_the_same_port_at_the_right_speed_hears_what_was_sent() -> None:
    assert at_another_speed(PACKET + LINE, sent_baud=2400, read_baud=2400) == PACKET + LINE


@pytest.mark.parametrize("shown", [HELD, COUNTED, LARGEST])
def test_what_is_no_speed_now_is_set_aside_and_said_when_nothing_else_comes(session: Session, shown: bytes) -> None:
    instrument, cable = tachometer(session)
    packets = iter([PACKET] + [shown] * 100)

    run, failure = session.record(instrument, for_s=None, also=every(0.5, lambda: cable.send(next(packets))))

    assert isinstance(failure, DeviceError)
    assert "HOLD" in str(failure)
    assert len(rows_of(run, "tachometer")) == 1
    assert facts(run, "tachometer") == {"rejected": 0, "set_aside": pytest.approx(20, abs=1)}


def test_packets_of_the_open_set_up_are_no_readings(session: Session) -> None:
    instrument, cable = tachometer(session)

    run, failure = session.record(instrument, for_s=None, also=every(0.5, lambda: cable.send(SET_UP)))

    assert isinstance(failure, DeviceError)
    assert "set-up" in str(failure)
    assert facts(run, "tachometer")["rejected"] == pytest.approx(20, abs=1)


def test_a_pulled_plug_ends_a_run_at_once_and_keeps_its_rows(session: Session) -> None:
    instrument, cable = tachometer(session)

    def step(now_s: float) -> None:
        send(now_s)
        pull(now_s)

    send, pull = every(1, lambda: cable.send(PACKET), until_s=3.5), every(3.2, cable.pull, until_s=3.5)
    run, failure = session.record(instrument, for_s=None, also=step)

    assert isinstance(failure, DeviceError)
    assert "unplugged" in str(failure)
    assert session.clock.seconds() < 3.4
    assert len(rows_of(run, "tachometer")) == 3


def test_typed_readings_are_rows_at_the_time_of_typing(session: Session) -> None:
    instrument = Readings("speed", "rpm", loop=session.clock, clock=session.host)
    typed = iter([(2000, 1353.7), (4000, 2711.0)])

    run, failure = session.record(instrument, for_s=50, also=every(20, lambda: instrument.add(*next(typed))))
    rows = rows_of(run, "speed")

    assert failure is None
    assert list(rows.columns) == ["t", "command", "rpm", "withdrawn"]
    assert rows.to_numpy() == pytest.approx(
        np.array([[UNIX_S + 20, 2000, 1353.7, 0], [UNIX_S + 40, 4000, 2711, 0]]), abs=0.01
    )


class Pty:
    """A serial port whose device end the test holds."""

    def __init__(self) -> None:
        self.device, self._host = os.openpty()
        tty.setraw(self._host)
        self.path = os.ttyname(self._host)

    def send(self, data: bytes) -> None:
        os.write(self.device, data)

    def unplug(self) -> None:
        for end in (self.device, self._host):
            if end >= 0:
                os.close(end)
        self.device = self._host = -1


@pytest.fixture
def pty() -> Iterator[Pty]:
    pty = Pty()
    yield pty
    pty.unplug()


def listened(
    make: Callable[[Loop], HandHeld], acts: list[Callable[[], None]], *, step_s: float = 0.25
) -> tuple[list[Block], HandHeld]:
    """Start an instrument in a real loop, take a block after each act, and close the instrument twice."""

    async def main(loop: Loop, ending: Ending) -> tuple[list[Block], HandHeld]:
        instrument = make(loop)
        blocks = []
        instrument.start()
        try:
            for act in acts:
                act()
                await sleep(loop, step_s)
                blocks.append(instrument.take())
            await instrument.stop()
        finally:
            instrument.close()
            instrument.close()
        return blocks, instrument

    return run_until_done(main)


def on(port: str, listen: Callable[[Loop], Listen] = ut372_ports) -> Callable[[Loop], HandHeld]:
    return lambda loop: HandHeld(port, Ut372Parser(), listen=listen(loop), loop=loop, clock=HostClock.now())


def test_packets_on_a_serial_port_are_readings_in_unix_time(pty: Pty) -> None:
    began_s = time.time()
    (whole, begun, rest), instrument = listened(
        on(pty.path),
        [lambda: pty.send(PACKET * 2), lambda: pty.send(PACKET[:11]), lambda: pty.send(PACKET[11:] + b"?")],
    )
    assert whole.columns[1].tolist() == [1353.7, 1353.7]
    assert len(begun.columns[0]) == 0
    assert rest.columns[1].tolist() == [1353.7]
    assert began_s <= whole.columns[0][0] < rest.columns[0][0] <= time.time()
    assert instrument.latest is not None
    assert instrument.latest[1] == pytest.approx(time.monotonic(), abs=5)


@pytest.mark.skipif(sys.platform != "linux", reason="reads the speed of the other end")
@pytest.mark.parametrize(
    ("listen", "baud"), [(ut372_ports, 2400), (serial_ports, 9600), (lambda loop: serial_ports(loop, baud=4800), 4800)]
)
def test_ports_run_at_their_instruments_speed(pty: Pty, listen: Callable[[Loop], Listen], baud: int) -> None:
    import termios

    found: list[Any] = []
    listened(on(pty.path, listen), [lambda: found.extend(termios.tcgetattr(pty.device))])

    assert found[4] == found[5] == getattr(termios, f"B{baud}")
    assert found[2] & termios.CSIZE == termios.CS8
    assert not found[2] & (termios.PARENB | termios.CSTOPB)


def test_lines_on_a_serial_port_are_weights(pty: Pty) -> None:
    (block, *_), instrument = listened(
        lambda loop: HandHeld(pty.path, ScalesParser(), listen=serial_ports(loop), loop=loop, clock=HostClock.now()),
        [lambda: pty.send(b"0.5 g\r\n" + LINE + b"US,NT,-  12.3 g\r\n")],
    )
    assert [column.tolist() for column in block.columns[1:]] == [[1230.0, -12.3], [1, 0]]
    assert block.lost is None
    assert instrument.facts() == {"rejected": 1}
    assert instrument.latest is not None
    assert instrument.latest[0] == -12.3


def test_an_unplugged_serial_port_is_said(pty: Pty) -> None:
    with pytest.raises(DeviceError, match="unplugged"):
        listened(on(pty.path), [lambda: pty.send(PACKET), pty.unplug, lambda: None])


@pytest.mark.parametrize("listen", [ut372_ports, serial_ports])
def test_a_port_that_cannot_be_opened_is_said(tmp_path: Path, listen: Callable[[Loop], Listen]) -> None:
    with pytest.raises(DeviceError, match="no such port"):
        listened(on(str(tmp_path / "none"), listen), [])
    (tmp_path / "file").touch()
    with pytest.raises(DeviceError, match="not a serial port"):
        listened(on(str(tmp_path / "file"), listen), [])


def test_a_hidraw_device_that_is_none_or_another_is_said(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="No such file"):
        listened(on(str(tmp_path / "hidraw0")), [])
    (tmp_path / "hidraw0").touch()
    (tmp_path / "tachometer").symlink_to("hidraw0")
    for name in ("hidraw0", "tachometer"):
        with pytest.raises(DeviceError, match="this is not a UT372"):
            listened(on(str(tmp_path / name)), [])


class Bridge:
    """A device from which each read returns a report, as from a hidraw file."""

    def __init__(self) -> None:
        self._device, self._host = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._host.setblocking(False)

    def listen(self, loop: Loop) -> Listen:
        return lambda port, receiver: HidrawPort(self._host.detach(), receiver, loop=loop)

    def send(self, data: bytes, *, sizes: tuple[int, ...] = (1, 0, 7, 2)) -> None:
        count = 0
        while data:
            size = sizes[count % len(sizes)]
            part, data = data[:size], data[size:]
            self._device.send(bytes([0xF0 + len(part)]) + part.ljust(7, b"\0"))
            count += 1

    def send_report(self, report: bytes) -> None:
        self._device.send(report)

    def unplug(self) -> None:
        self._device.close()


@pytest.fixture
def bridge() -> Iterator[Bridge]:
    if not hasattr(socket, "SOCK_SEQPACKET"):
        pytest.skip("there are no sockets here that keep reports apart")
    bridge = Bridge()
    yield bridge
    bridge.unplug()


def test_reports_of_the_bridge_are_readings(bridge: Bridge) -> None:
    (block, *_), instrument = listened(on("hidraw0", bridge.listen), [lambda: bridge.send(PACKET * 3)])
    assert block.columns[1].tolist() == [1353.7] * 3
    assert instrument.facts()["rejected"] == 0


def test_a_report_that_is_not_the_bridges_is_a_lost_packet_and_no_reading(bridge: Bridge) -> None:
    def send() -> None:
        bridge.send(PACKET[:14])
        bridge.send_report(b"\x01" + PACKET[14:21])
        bridge.send(PACKET[21:] + PACKET)

    (block, *_), instrument = listened(on("hidraw0", bridge.listen), [send])
    assert block.columns[1].tolist() == [1353.7]
    assert instrument.facts()["rejected"] == 1


def test_an_unplugged_bridge_is_said(bridge: Bridge) -> None:
    with pytest.raises(DeviceError, match="unplugged"):
        listened(on("hidraw0", bridge.listen), [lambda: bridge.send(PACKET), bridge.unplug, lambda: None])


def add_hidraw(root: Path, name: str, hid_id: str, *, node: bool = True) -> None:
    """Add a device as Linux presents it: its node, and the properties of the HID device behind that node."""
    folder = root / "sys/class/hidraw" / name / "device"
    folder.mkdir(parents=True)
    (folder / "uevent").write_text(f"DRIVER=hid-generic\nHID_ID={hid_id}\nHID_NAME=device\nHID_UNIQ=\n")
    (root / "dev").mkdir(exist_ok=True)
    if node:
        (root / "dev" / name).touch()


def test_the_tachometer_is_found_among_other_devices(tmp_path: Path) -> None:
    add_hidraw(tmp_path, "hidraw0", "0003:0000046D:0000C52B")
    add_hidraw(tmp_path, "hidraw1", "0003:00001A86:0000E008")
    add_hidraw(tmp_path, "hidraw2", "0005:00001A86:0000E429")
    assert find_ut372(tmp_path) == str(tmp_path / "dev/hidraw1")


def test_no_tachometer_is_said_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"no USB device 1a86:e008.*Plug it in"):
        find_ut372(tmp_path)
    add_hidraw(tmp_path, "hidraw0", "0003:0000046D:0000C52B")
    with pytest.raises(DeviceError, match=r"no USB device 1a86:e008.*Plug it in"):
        find_ut372(tmp_path)


def test_two_devices_that_may_be_it_are_named(tmp_path: Path) -> None:
    for name in ("hidraw1", "hidraw3"):
        add_hidraw(tmp_path, name, "0003:00001A86:0000E008")
    with pytest.raises(DeviceError, match="/dev/hidraw1, /dev/hidraw3"):
        find_ut372(tmp_path)


def test_a_tachometer_that_may_not_be_opened_is_said_with_the_rule_that_allows_it(tmp_path: Path) -> None:
    add_hidraw(tmp_path, "hidraw1", "0003:00001A86:0000E008", node=False)
    with pytest.raises(DeviceError) as raised:
        find_ut372(tmp_path)
    rule = 'SUBSYSTEM=="hidraw", ATTRS{idVendor}=="1a86", ATTRS{idProduct}=="e008", TAG+="uaccess"'
    assert rule in str(raised.value)
    assert "/etc/udev/rules.d/" in str(raised.value)
