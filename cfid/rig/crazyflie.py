"""Opens the link to a vehicle: handles cflib and its threads, and adds the time-outs that cflib lacks.

Packets arrive on cflib's thread and get their times there.
"""

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Self

from cflib.crazyflie import Crazyflie
from cflib.crtp.crtpstack import CRTPPacket

from cfid.errors import DeviceError
from cfid.rig.cflib_drivers import prepare_cflib, table_cache
from cfid.wire.crtp import ECHO_CHANNEL, ECHO_PORT, Packet, Variable, encode_echo

Arrived = tuple[Packet, float]

OLDEST_PROTOCOL = 4  # from 2018 on: the first with 16-bit tables

_SILENT_S = 2.0  # without any packet
_STUCK_S = 0.7  # without a further packet while the tables are read: one was lost, and nothing repeats it
_CONNECT_S = 30.0  # tables of a real vehicle come in a second, and in twenty where one packet in ten is lost
_FOREIGN_TRIES = 5  # connections in which something answered, but never as a Crazyflie does
_ECHO = Packet(ECHO_PORT, ECHO_CHANNEL, encode_echo(0))
_NAME = Packet(15, 1, b"Bitcraze Crazyflie")  # the beginning of a vehicle's answer to cflib's first request
_CLOSE_S = 2.5
_SEND_S = 0.5  # in which cflib hands a packet to a driver that accepts it
# The steps in which cflib connects, each taken when the previous one has been answered. An answer that arrives twice,
# as datagrams may, would repeat them, among them a reset of the vehicle's log, after cfid has begun its own log.
_STEPS = ("_platform_info_fetched", "_log_toc_updated_cb", "_mems_updated_cb", "_param_toc_updated_cb")
_CHECK_EVERY_S = 0.02
_ECHO_EVERY_S = 0.1
_LONGEST_QUEUE = 64  # packets that wait for the driver


class QueuedPacket:
    """A packet on its way out; `at_s` is when the driver took it, on the monotonic clock."""

    def __init__(self, packet: Packet) -> None:
        """Start as not yet sent."""
        self.packet = packet
        self.at_s: float | None = None


class Link:
    """An open link to a vehicle, whose tables have been read. Made by `connect`."""

    def __init__(self, uri: str, cf: Crazyflie) -> None:
        """Take a Crazyflie of cflib that is about to open its link."""
        self.uri = uri
        self.fault = ""
        self.received_s = 0.0
        self._named = False
        self._cf = cf
        self._arrived: queue.SimpleQueue[Arrived] = queue.SimpleQueue()
        self._leaving: queue.Queue[QueuedPacket | None] = queue.Queue(_LONGEST_QUEUE)
        self._wake: Callable[[], None] = lambda: None

    @classmethod
    def connect(cls, uri: str) -> Self:
        """Open the link and read the vehicle's tables.

        An attempt that a lost packet stopped is repeated while time remains. Raises DeviceError naming how far the
        attempts got: no such address, no radio, no answer, not a Crazyflie, too old, a link that loses packets.
        """
        prepare_cflib()
        begun_s, answered, named, foreign = time.monotonic(), False, False, 0
        while True:
            link = cls(uri, Crazyflie(rw_cache=str(table_cache())))
            try:
                if link._opened(begun_s + _CONNECT_S):
                    return link
                answered = answered or bool(link.received_s)
                named = named or link._named
                foreign += bool(link.received_s)
                link._give_up(
                    time.monotonic() - begun_s,
                    answered=answered,
                    foreign=foreign >= _FOREIGN_TRIES and not named,
                )
            except BaseException:
                link.close()
                raise
            link.close()

    @property
    def firmware_protocol(self) -> int:
        """The version of CRTP that the vehicle speaks, below zero for none."""
        return int(self._cf.platform.get_protocol_version())

    def variable(self, name: str) -> Variable | None:
        """Return a log variable by its name, such as `pm.vbat`."""
        return _entry(self._cf.log.toc, name)

    def parameter(self, name: str) -> Variable | None:
        """Return a parameter by its name, such as `motorPowerSet.enable`."""
        return _entry(self._cf.param.toc, name)

    def send(self, packet: Packet) -> QueuedPacket:
        """Queue a packet for the sending thread; the returned object gets the time at which it left.

        cflib would block the caller when a radio takes no more packets, and hold a lock while it reports that. When
        the link is gone, this method raises DeviceError, where cflib would ignore the packet.
        """
        if self.fault or self._cf.link is None:
            raise DeviceError(self.fault or f"{self.uri}: the link is closed.")
        leaving = QueuedPacket(packet)
        try:
            self._leaving.put_nowait(leaving)
        except queue.Full:
            self._fail("the link takes no more packets")
            raise DeviceError(self.fault) from None
        return leaving

    def receive(self, within_s: float) -> Packet | None:
        """Return the next packet, None when none comes in time. Once a loop is attached, it takes the packets."""
        with contextlib.suppress(queue.Empty):
            return self._arrived.get(timeout=within_s)[0]
        return None

    def attach(self, wake: Callable[[], None]) -> None:
        """Call `wake`, on cflib's thread, whenever a packet has arrived: `wake` makes a loop call `arrived`."""
        self._wake = wake
        wake()

    def arrived(self) -> list[Arrived]:
        """Return the packets that arrived since the last call, each with its time on the monotonic clock."""
        packets: list[Arrived] = []
        while True:
            try:
                packets.append(self._arrived.get_nowait())
            except queue.Empty:
                return packets

    def close(self) -> None:
        """Close the link and wait for its threads. cflib takes up to two seconds to release a radio or a cable."""
        self._wake = lambda: None
        with contextlib.suppress(queue.Full):
            self._leaving.put_nowait(None)
        closing = threading.Thread(target=self._close, daemon=True)
        closing.start()
        closing.join(_CLOSE_S)

    def _close(self) -> None:
        """Close the driver first, so that cflib, when it closes its own part, cannot send a last setpoint.

        That setpoint would go stale, and lock a vehicle whose motors ran within the last two seconds.
        """
        # cflib repeats requests from timers, which look up the link twice as they send. A timer that holds the lock for
        # longer is waiting for the driver, and does not look it up again.
        held = self._cf._send_lock.acquire(timeout=_SEND_S)
        driver, self._cf.link = self._cf.link, None
        if held:
            self._cf._send_lock.release()
        if driver is not None:
            driver.close()
        updater = self._cf.param.param_updater
        self._cf.close_link()
        if updater is not None:  # cflib wakes it before asking it to end, and so it may wait again, forever
            updater.request_queue.put(None)
            updater.join(_CLOSE_S)

    def _give_up(self, spent_s: float, *, answered: bool, foreign: bool) -> None:
        if not answered and spent_s > _SILENT_S:
            raise DeviceError(
                f"{self.uri}: no answer within {_SILENT_S:g} s. Is the vehicle on, and does this URI state its "
                "channel, data rate and address?"
            )
        if foreign:
            raise DeviceError(
                f"{self.uri}: the device that answers is no Crazyflie, or its link loses most packets: it answered "
                f"{_FOREIGN_TRIES} connections and never gave a Crazyflie's name."
            )
        if spent_s > _CONNECT_S:
            raise DeviceError(
                f"{self.uri}: the vehicle answers, but no connection was completed within {_CONNECT_S:g} s: the link "
                "loses packets. Bring the vehicle closer, change the channel, or quieten the network."
            )

    def _opened(self, end_s: float) -> bool:
        """Open the link and wait for the tables; return False when a lost packet stopped that."""
        connected = threading.Event()
        cf = self._cf
        cf.connected.add_callback(lambda uri: connected.set())
        cf.param.request_update_of_all_params = lambda: None  # cfid reads the few values that it needs
        for step in _STEPS:
            setattr(cf, step, _once(getattr(cf, step)))
        # cflib itself would close the link from the thread that met the error, and wait there for that same thread.
        cf._link_error_cb = self._failed
        cf.connection_failed.add_callback(lambda uri, reason: self._failed(reason))
        cf.packet_received.add_callback(self._received)
        begun_s = time.monotonic()
        threading.Thread(target=cf.open_link, args=(self.uri,), daemon=True).start()
        threading.Thread(target=self._send_all, daemon=True).start()
        echo_s = begun_s
        while not connected.wait(_CHECK_EVERY_S):
            self._check_answers()
            if cf.link is not None and not self.received_s and time.monotonic() - echo_s > _ECHO_EVERY_S:
                echo_s = time.monotonic()
                self.send(_ECHO)  # cflib sends its first request once, and a lossy link may lose it
            if time.monotonic() > end_s:
                return False
            if time.monotonic() - max(self.received_s, begun_s) > self._patience_s:
                return False
            if self.received_s and self.firmware_protocol < 0 and time.monotonic() - begun_s > _STUCK_S:
                return False
        self._stamp(cf.link)
        self._check_answers()
        return True

    @property
    def _patience_s(self) -> float:
        """How long an attempt waits for a packet: a radio repeats its packets, and may reach the vehicle late."""
        return _STUCK_S if self.received_s or self.uri.startswith("udp:") else _SILENT_S

    def _check_answers(self) -> None:
        if self.fault:
            raise DeviceError(self.fault)
        if 0 <= self.firmware_protocol < OLDEST_PROTOCOL:
            raise DeviceError(
                f"{self.uri}: the vehicle speaks version {self.firmware_protocol} of its protocol, cfid needs "
                f"{OLDEST_PROTOCOL} or newer: update its firmware."
            )

    def _failed(self, reason: str) -> None:
        lines = str(reason).strip().splitlines() or ["no reason was given"]
        detail = next((line for line in lines if line.startswith("Exception:")), lines[0]).removeprefix("Exception:")
        self._fail(_meaning(self.uri, detail))

    def _fail(self, what: str) -> None:
        if not self.fault:
            self.fault = f"{self.uri}: {what}"
        self._wake()

    def _send_all(self) -> None:
        """Hand packets to the driver, one after the other, until the link is closed."""
        while (leaving := self._leaving.get()) is not None:
            driver = self._cf.link
            if driver is None or self.fault:
                continue
            sent = CRTPPacket()
            sent.set_header(leaving.packet.port, leaving.packet.channel)
            sent.data = leaving.packet.payload
            leaving.at_s = time.monotonic()
            driver.send_packet(sent)

    def _stamp(self, driver: Any) -> None:
        """Stamp packets right after the driver has read them, before another thread takes them."""
        queued = driver.in_queue.put

        def put(packet: Any, *more: Any) -> None:
            packet.arrived_s = time.monotonic()
            queued(packet, *more)

        driver.in_queue.put = put

    def _received(self, packet: Any) -> None:
        self.received_s = getattr(packet, "arrived_s", None) or time.monotonic()
        came = Packet(packet.port, packet.channel, bytes(packet.data))
        self._named = self._named or (came[:2] == _NAME[:2] and came.payload.startswith(_NAME.payload))
        self._arrived.put((came, self.received_s))
        self._wake()


def _once(step: Callable[[], None]) -> Callable[[], None]:
    """Return a step that is taken at the first call and never again."""
    left = [step]

    def take() -> None:
        if left:
            left.pop()()

    return take


def _meaning(uri: str, reason: str) -> str:
    if "unreachable" in reason:
        return "the network has no route to it."
    if "refused" in reason:
        return "no program listens there: the vehicle is off, or the address is wrong."
    if "No driver found" in reason:
        return "this is not the address of a vehicle, such as radio://0/80/2M/E7E7E7E7E7."
    if "radio" in reason.lower() and uri.startswith("radio"):
        return f"no Crazyradio: {reason.strip()}. Plug it in; on Linux, install its udev rules."
    return f"the link failed: {reason.strip()}."


def _entry(table: Any, name: str) -> Variable | None:
    element = table.get_element_by_complete_name(name) if table is not None else None
    return None if element is None else Variable(element.ident, element.pytype[-1].replace("L", "I"))
