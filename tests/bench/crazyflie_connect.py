"""How soon unmodified cflib is fully connected with the simulated vehicle, and what serving that vehicle costs.

A peer that only echoes each packet gives the round trip that computer and sockets need in any case. The server's
processor time is measured at rest, connected, with motors and with a log, then also with the load cell at 7 kHz, while
the rotors turn steadily and while they follow a sine of 500 commands a second.
"""

import logging
import os
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crtp.crtpstack import CRTPPacket
from cflib.crtp.udpdriver import UdpDriver

from cfid.records.rig_file import new_rig_text
from cfid.rig.sim_file import SIM_FILE
from cfid.sim.link import RadioTruth
from cfid.wire import app
from cfid.wire.rdt import Command, Request, encode_request

CONNECTS = int(os.environ.get("BENCH_CONNECTS", "20"))
SECONDS = float(os.environ.get("BENCH_SECONDS", "5"))
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
PORTS = app.AppPorts()


def main() -> None:
    cflib.crtp.CLASSES[:] = [UdpDriver]  # do not search USB
    logging.getLogger("cflib").setLevel(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as name, serving(Path(name)) as (devices, process):
        tell_connects(devices["crazyflie"]["uri"])
        print(f"at rest: {core_percent(process):.2f} %  (goal: below 2 % of a core)")
        tell_cost(devices, process)


@contextmanager
def serving(folder: Path) -> Iterator[tuple[dict[str, Any], int]]:
    """Run `cfid rig sim` in a campaign; yield the addresses of its devices, and its process number."""
    (folder / "rig.toml").write_text(new_rig_text())
    words = (sys.executable, "-m", "cfid.cli.main", "rig", "sim")
    with subprocess.Popen(words, cwd=folder, stderr=subprocess.DEVNULL) as server:
        try:
            while not (folder / SIM_FILE).exists():
                time.sleep(0.1)
            time.sleep(1)
            yield tomllib.loads((folder / SIM_FILE).read_text())["devices"], server.pid
        finally:
            server.terminate()


class Connected:
    """A fully connected link of cflib."""

    def __init__(self, uri: str) -> None:
        self.answers = 0
        complete = threading.Event()
        self.cf = Crazyflie()
        self.cf.packet_received.add_callback(self._count)
        self.cf.fully_connected.add_callback(lambda uri: complete.set())
        began_s = time.perf_counter()
        self.cf.open_link(uri)
        if not complete.wait(10):
            raise SystemExit("cflib did not connect within 10 s")
        self.took_s = time.perf_counter() - began_s

    def send(self, port: int, channel: int, payload: bytes) -> None:
        packet = CRTPPacket()
        packet.set_header(port, channel)
        packet.data = payload
        self.cf.send_packet(packet)

    def drive(self, enable: int) -> None:
        """Set motorPowerSet."""
        for number, value in ((1, struct.pack("<H", 30000)), (0, bytes([enable]))):
            self.send(2, 2, struct.pack("<H", number) + value)

    def log(self, period_ms: int) -> None:
        """Log the battery and all four motors."""
        names = ("pm.vbat", "motor.m1", "motor.m2", "motor.m3", "motor.m4")
        numbers = [self.cf.log.toc.get_element_id(name) for name in names]
        entries = [struct.pack("<BH", kind, number) for kind, number in zip((7, 2, 2, 2, 2), numbers, strict=True)]
        self.send(5, 1, b"\x05")
        self.send(5, 1, bytes([6, 200]) + b"".join(entries))
        self.send(5, 1, struct.pack("<BBH", 8, 200, period_ms))

    def play_sine(self) -> None:
        """Keep the app alive and let it play for longer than any measurement takes."""

        def keep_alive() -> None:
            while self.cf.link is not None:
                self.send(PORTS.ping, app.PingChannel.ALIVE, app.encode_alive(0))
                time.sleep(0.1)

        threading.Thread(target=keep_alive, daemon=True).start()
        time.sleep(0.2)
        sine = app.SineRequest(0, 20000, app.omega_of(1000, 100_000), 100_000)
        self.send(PORTS.sine, app.SineChannel.START, app.encode_sine(sine))

    def _count(self, packet: CRTPPacket) -> None:
        self.answers += 1


def tell_connects(uri: str) -> None:
    links = []
    for _ in range(CONNECTS):
        links.append(Connected(uri))
        links[-1].cf.close_link()
    times_ms, answers = [1e3 * link.took_s for link in links], links[0].answers
    print(f"fully connected, median of {CONNECTS}: {statistics.median(times_ms):.0f} ms  (goal: below 300 ms)")
    print(f"fully connected, largest of {CONNECTS}: {max(times_ms):.0f} ms")
    echo_ms = 1e3 * statistics.median(echo_round_trips())
    bare_ms = answers * (echo_ms + 2e3 * RadioTruth().latency_s)
    print(
        f"  {answers} round trips, which with a peer that echoes ({echo_ms:.3f} ms) and the radio's latency would ",
        end="",
    )
    print(f"take {bare_ms:.0f} ms: ratio {statistics.median(times_ms) / bare_ms:.2f}")


def echo_round_trips() -> list[float]:
    """Return 1000 round-trip times in seconds of a packet over the loopback, to a thread that sends it back."""
    with socket.socket(type=socket.SOCK_DGRAM) as peer, socket.socket(type=socket.SOCK_DGRAM) as own:
        peer.bind(("127.0.0.1", 0))
        own.connect(peer.getsockname())

        def echo() -> None:
            packet, client = peer.recvfrom(64)
            while packet:
                peer.sendto(packet, client)
                packet, client = peer.recvfrom(64)

        thread = threading.Thread(target=echo)
        thread.start()
        times_s = []
        for _ in range(1000):
            began_s = time.perf_counter()
            own.send(bytes(10))
            own.recv(64)
            times_s.append(time.perf_counter() - began_s)
        own.send(b"")
        thread.join()
    return times_s


def tell_cost(devices: dict[str, Any], process: int) -> None:
    link = Connected(devices["crazyflie"]["uri"])
    states: list[tuple[str, Callable[[], None]]] = [
        ("connected", lambda: None),
        ("motors running", lambda: link.drive(2)),
        ("motors running, a log every 10 ms", lambda: link.log(10)),
        ("motors running, a log every 1 ms", lambda: link.log(1)),
    ]
    for name, begin in states:
        begin()
        print(f"{name}: {core_percent(process):.1f} %  (goal: below 15 % of a core)")
    link.send(5, 1, b"\x05")
    with socket.socket(type=socket.SOCK_DGRAM) as cell:
        cell.sendto(encode_request(Request(Command.REAL_TIME)), ("127.0.0.1", devices["loadcell"]["rdt_port"]))
        print(f"motors running, load cell at 7 kHz: {core_percent(process):.1f} % of a core")
        link.drive(0)
        link.play_sine()
        print(f"a sine playing, load cell at 7 kHz: {core_percent(process):.1f} % of a core")
    link.cf.close_link()


def core_percent(process: int) -> float:
    """Return the share of a core that a process uses during SECONDS, after a short delay."""
    time.sleep(0.5)
    before = _ticks(process)
    time.sleep(SECONDS)
    return 100 * (_ticks(process) - before) / TICKS_PER_S / SECONDS


def _ticks(process: int) -> int:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


if __name__ == "__main__":
    main()
