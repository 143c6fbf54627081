"""Prepares cflib's drivers and its cache of tables, and searches for a vehicle with them."""

import contextlib
import io
import logging
import os
import queue
import socket
from pathlib import Path

import cflib.crtp
from cflib.crtp.radiodriver import RadioDriver
from cflib.crtp.udpdriver import UdpDriver
from cflib.crtp.usbdriver import UsbDriver
from platformdirs import user_cache_path

from cfid.errors import DeviceError


class RepeatingUdp(UdpDriver):  # type: ignore[misc]
    """cflib's UDP driver, which repeats requests until they are answered: datagrams get lost too."""

    def __init__(self) -> None:
        """Create a driver that is not connected yet."""
        super().__init__()
        self.needs_resending = True

    def close(self) -> None:
        """Close at once: wake the thread that receives, and the one that takes packets, instead of waiting for both.

        A thread that still ran when the interpreter ends could abort the program.
        """
        if self.socket is None:
            return
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)
            os.set_blocking(self.socket.fileno(), True)  # else the receiving thread polls in vain for a second
        super().close()
        queue.Queue.put(self.in_queue, None)


def find_vehicle() -> str:
    """Return the address of the only vehicle that a radio or a USB cable reaches. Raises DeviceError."""
    prepare_cflib()
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


def prepare_cflib() -> None:
    """Load cflib's drivers once, and keep its log off stderr, which is for cfid's messages."""
    logging.getLogger("cflib").setLevel(logging.CRITICAL)
    if not cflib.crtp.CLASSES:
        cflib.crtp.init_drivers()
    cflib.crtp.CLASSES[:] = [RepeatingUdp if driver is UdpDriver else driver for driver in cflib.crtp.CLASSES]


def table_cache() -> Path:
    """Return the folder in which cflib caches tables: over a radio, reading them takes seconds."""
    folder = user_cache_path("cfid") / "crazyflie-tables"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # cflib then works without a cache
        return Path()
    return folder
