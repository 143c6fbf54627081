"""The vehicle's app on this machine: the very C that runs on the vehicle, or the same in Python without a compiler.

Compiles the core, without what ties it to the firmware, into a shared object of this process; leaves no file behind.
"""

import ctypes
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from cfid.sim.app_core_python import PythonCore
from cfid.sim.crazyflie_modules import App, Sent
from cfid.sim.propulsion import Four

_PACKAGE = Path(__file__).parents[1]
_PLACES = (_PACKAGE, _PACKAGE.parent)  # in an installed package; in the repository
_PAYLOAD = 30


class AppCore(App, Protocol):
    """The app, and which of the two it is: "C" or "Python"."""

    implementation: str


class Packet(ctypes.Structure):
    """`struct cfid_packet`."""

    _fields_ = [
        ("service", ctypes.c_uint8),
        ("channel", ctypes.c_uint8),
        ("size", ctypes.c_uint8),
        ("data", ctypes.c_uint8 * _PAYLOAD),
    ]

    @classmethod
    def of(cls, service: int, channel: int, payload: bytes) -> "Packet":
        """Return a packet; raises ValueError for more than 30 bytes."""
        if len(payload) > _PAYLOAD:
            raise ValueError(f"{len(payload)} bytes of payload are more than {_PAYLOAD}")
        return cls(service, channel, len(payload), (ctypes.c_uint8 * _PAYLOAD)(*payload))

    @property
    def payload(self) -> bytes:
        """The bytes in use."""
        return bytes(self.data[: self.size])


class CompiledCore:
    """The C core behind `AppCore`'s interface."""

    implementation = "C"

    def __init__(self, library: ctypes.CDLL) -> None:
        """Drive nothing, and have heard nothing."""
        self._library = library
        self._core = ctypes.create_string_buffer(library.cfid_core_size())
        library.cfid_core_init(self._core)

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, allowed: bool) -> None:
        """Take a request. `allowed`: whether the supervisor lets motors run."""
        self._library.cfid_core_receive(self._core, Packet.of(service, channel, payload), now_us, allowed)

    def tick(self, *, now_us: int, allowed: bool) -> Four | None:
        """Go on by a millisecond; return the commands while keep-alives come, else None."""
        commands = (ctypes.c_uint16 * 4)()
        held = self._library.cfid_core_tick(self._core, now_us, allowed, commands)
        m1, m2, m3, m4 = commands
        return (m1, m2, m3, m4) if held else None

    def sent(self) -> list[Sent]:
        """Hand over what is to be sent."""
        packets = []
        packet = Packet()
        while self._library.cfid_core_send(self._core, packet):
            packets.append((packet.service, packet.channel, packet.payload))
        return packets

    def alive(self, *, now_us: int) -> bool:
        """Return whether the last keep-alive is fresh and was not revoked."""
        return bool(self._library.cfid_core_alive(self._core, now_us))


def load_core() -> AppCore:
    """Return a new app: the C core, or the Python one where there is no compiler or no source."""
    library = load_library()
    return PythonCore() if library is None else CompiledCore(library)


@cache
def load_library() -> ctypes.CDLL | None:
    """Return the core compiled with this machine's cc or gcc, once in a process; None where that cannot be."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    source = find_source()
    if compiler is None or source is None:
        return None
    with TemporaryDirectory() as folder:
        made = Path(folder) / "cfid_core.so"
        command = [compiler, "-std=c11", "-O2", "-shared", "-fPIC", "-o", str(made), str(source), "-lm"]
        if subprocess.run(command, capture_output=True, check=False).returncode != 0:
            return None  # a compiler without its headers or libraries is none
        return declared(ctypes.CDLL(str(made)))


def find_source() -> Path | None:
    """Return where `cfid_core.c` is, if it is there."""
    files = (place / "firmware_patches" / "cfid_app" / "src" / "cfid_core.c" for place in _PLACES)
    return next((file for file in files if file.is_file()), None)


def declared(library: ctypes.CDLL) -> ctypes.CDLL:
    """Return the library with the signatures of `cfid_core.h`."""
    core, us, packet = ctypes.c_char_p, ctypes.c_uint64, ctypes.POINTER(Packet)
    flag, commands = ctypes.c_bool, ctypes.POINTER(ctypes.c_uint16)
    for name, result, *arguments in (
        ("cfid_core_size", ctypes.c_size_t),
        ("cfid_core_init", None, core),
        ("cfid_core_receive", None, core, packet, us, flag),
        ("cfid_core_tick", flag, core, us, flag, commands),
        ("cfid_core_send", flag, core, packet),
        ("cfid_core_alive", flag, core, us),
        ("cfid_answer_ping", flag, packet, us, packet),
    ):
        function = getattr(library, str(name))
        function.restype, function.argtypes = result, arguments
    return library
