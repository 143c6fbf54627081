"""A radio or a USB cable as the carrier of a link: cflib's drivers, and nothing else of cflib."""

import contextlib
import io
import logging
import time
from collections.abc import Callable
from typing import Any

import cflib.crtp
from cflib.crtp.crtpstack import CRTPPacket
from cflib.crtp.radiodriver import RadioDriver
from cflib.crtp.usbdriver import UsbDriver

from cfid.errors import DeviceError
from cfid.wire.crtp import Packet


class Driver:
    """An open driver of cflib; `failed` is called with the reason when it loses its radio or its vehicle."""

    def __init__(self, uri: str, failed: Callable[[str], None]) -> None:
        """Open the driver of an address. Raises what cflib and its drivers raise, OSError for no such address."""
        _prepare()
        self._driver: Any = cflib.crtp.get_link_driver(uri, lambda *_: None, lambda reason: failed(_line_of(reason)))
        if self._driver is None:
            raise OSError("no driver")
        self._stamp(self._driver.in_queue)

    def send(self, packet: Packet) -> None:
        """Send a packet; a radio may take up to two seconds."""
        sent = CRTPPacket()
        sent.set_header(packet.port, packet.channel)
        sent.data = packet.payload
        self._driver.send_packet(sent)

    def receive(self) -> tuple[Packet, float] | None:
        """Wait for a packet; return it with its time on the monotonic clock, None when none came for a while."""
        came = self._driver.receive_packet(0.2)
        if came is None:
            return None
        return Packet(came.port, came.channel, bytes(came.data)), getattr(came, "arrived_s", time.monotonic())

    def close(self) -> None:
        """Release the radio or the cable."""
        self._driver.close()

    def _stamp(self, came: Any) -> None:
        """Stamp packets right after the driver has read them, before another thread takes them."""
        put = came.put

        def stamped(packet: Any, *more: Any) -> None:
            packet.arrived_s = time.monotonic()
            put(packet, *more)

        came.put = stamped


def find_vehicle() -> str:
    """Return the address of the only vehicle that a radio or a USB cable reaches. Raises DeviceError."""
    _prepare()
    found: list[str] = []
    for driver in (RadioDriver, UsbDriver):
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # cflib prints when no radio is plugged in
                found += [str(uri) for uri, _ in driver().scan_interface(None)]
        except Exception as error:  # cflib lets through whatever its drivers raise
            raise DeviceError(f"the search for a vehicle failed: {error}.") from None
    if not found:
        raise DeviceError(
            "no vehicle found by radio or USB. Is it on, and a Crazyradio plugged in? devices.crazyflie.uri in "
            "rig.toml, or `uri`, names one directly."
        )
    if len(found) > 1:
        raise DeviceError(f"several vehicles answer: {', '.join(found)}. Choose one with `uri`.")
    return found[0]


def _prepare() -> None:
    """Load cflib's drivers once, and keep its log off stderr, which is for cfid's messages."""
    logging.getLogger("cflib").setLevel(logging.CRITICAL)
    if not cflib.crtp.CLASSES:
        cflib.crtp.init_drivers()


def _line_of(reason: object) -> str:
    """Return the line of a driver's report that states its reason."""
    lines = str(reason).strip().splitlines() or ["no reason was given"]
    return next((line for line in lines if line.startswith("Exception:")), lines[0]).removeprefix("Exception:")
