"""Runs the vehicle's app on this machine: the same C code that runs on the vehicle.

It compiles the core, without its connection to the firmware, into a shared object of this process and leaves no file.
"""

import ctypes
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from cfid.errors import DeviceError
from cfid.sim.propulsion import Four

THRUST, SINE, PING = range(3)

Sent = tuple[int, int, bytes]  # service, channel, payload

_PACKAGE = Path(__file__).parents[1]
_PLACES = (_PACKAGE, _PACKAGE.parent)  # in an installed package; in the repository
_PAYLOAD = 30
_WAY_OUT = (
    "Install one (Debian and Ubuntu: sudo apt install gcc libc6-dev), or simulate stock firmware, which needs none: "
    'firmware = "stock" under [crazyflie] in a file for `truth`.'
)


class CorePacket(ctypes.Structure):
    """`struct cfid_packet`."""

    _fields_ = [
        ("service", ctypes.c_uint8),
        ("channel", ctypes.c_uint8),
        ("size", ctypes.c_uint8),
        ("data", ctypes.c_uint8 * _PAYLOAD),
    ]

    @classmethod
    def of(cls, service: int, channel: int, payload: bytes) -> "CorePacket":
        """Return a packet; raises ValueError for more than 30 bytes."""
        if len(payload) > _PAYLOAD:
            raise ValueError(f"{len(payload)} bytes of payload are more than {_PAYLOAD}")
        return cls(service, channel, len(payload), (ctypes.c_uint8 * _PAYLOAD)(*payload))

    @property
    def payload(self) -> bytes:
        """The bytes in use."""
        return bytes(self.data[: self.size])


class Seen(ctypes.Structure):
    """`struct cfid_vehicle`: the vehicle's state; `idle` is powerDist.idleThrust as its owner set it."""

    _fields_ = [
        ("can_fly", ctypes.c_bool),
        ("flying", ctypes.c_bool),
        ("needs_arming", ctypes.c_bool),
        ("idle", ctypes.c_uint16),
    ]


class Orders(ctypes.Structure):
    """`struct cfid_orders`, until the next tick.

    `feeds` gives fresh null setpoints, `idles_off` switches idle thrust off, and `disarms` disarms now.
    """

    _fields_ = [
        ("commands", ctypes.c_uint16 * 4),
        ("holds", ctypes.c_bool),
        ("feeds", ctypes.c_bool),
        ("idles_off", ctypes.c_bool),
        ("disarms", ctypes.c_bool),
    ]

    @property
    def held(self) -> Four | None:
        """The commands of the four motors, None to leave them to the stock controller."""
        one, two, three, four = self.commands
        return (one, two, three, four) if self.holds else None


class App:
    """The three services on a vehicle, which give orders once a millisecond; this one, of stock firmware, has none."""

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, vehicle: Seen) -> None:
        """Take a request."""

    def tick(self, *, now_us: int, vehicle: Seen) -> Orders:
        """Advance by a millisecond."""
        return Orders()

    def sent(self) -> list[Sent]:
        """Return the packets to send."""
        return []

    def alive(self, *, now_us: int) -> bool:
        """Return whether its client's keep-alives are fresh and were not revoked, or a sine plays."""
        return False


class AppCore(App):
    """A core of the app, with the interface that the vehicle's firmware uses."""

    def __init__(self, library: ctypes.CDLL) -> None:
        """Start without commands and without a client."""
        self._library = library
        self._core = ctypes.create_string_buffer(library.cfid_core_size())
        library.cfid_core_init(self._core)

    def receive(self, service: int, channel: int, payload: bytes, *, now_us: int, vehicle: Seen) -> None:
        """Take a request."""
        self._library.cfid_core_receive(self._core, CorePacket.of(service, channel, payload), now_us, vehicle)

    def tick(self, *, now_us: int, vehicle: Seen) -> Orders:
        """Advance by a millisecond."""
        orders = Orders()
        self._library.cfid_core_tick(self._core, now_us, vehicle, orders)
        return orders

    def sent(self) -> list[Sent]:
        """Return the packets to send."""
        packets = []
        packet = CorePacket()
        while self._library.cfid_core_send(self._core, packet):
            packets.append((packet.service, packet.channel, packet.payload))
        return packets

    def alive(self, *, now_us: int) -> bool:
        """Return whether the last keep-alive is fresh and was not revoked."""
        return bool(self._library.cfid_core_alive(self._core, now_us))


def load_core() -> AppCore:
    """Return a new app. Raises DeviceError where it cannot be compiled."""
    return AppCore(load_library())


@cache
def load_library() -> ctypes.CDLL:
    """Return the core compiled with this machine's cc or gcc, once in a process. Raises DeviceError."""
    library = compiled(find_source())
    core, us, packet, flag = ctypes.c_char_p, ctypes.c_uint64, ctypes.POINTER(CorePacket), ctypes.c_bool
    vehicle, orders = ctypes.POINTER(Seen), ctypes.POINTER(Orders)
    for name, result, *arguments in (
        ("cfid_core_size", ctypes.c_size_t),
        ("cfid_core_init", None, core),
        ("cfid_core_receive", None, core, packet, us, vehicle),
        ("cfid_core_tick", None, core, us, vehicle, orders),
        ("cfid_core_send", flag, core, packet),
        ("cfid_core_alive", flag, core, us),
        ("cfid_answer_ping", flag, packet, us, packet),
    ):
        function = getattr(library, str(name))
        function.restype, function.argtypes = result, arguments
    return library


def compiled(source: Path) -> ctypes.CDLL:
    """Return a core as a shared object of this process. Raises DeviceError without a compiler that can do that."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        raise DeviceError(f"There is no C compiler (gcc), which the simulated vehicle's app needs. {_WAY_OUT}")
    with TemporaryDirectory() as folder:
        made = Path(folder) / "cfid_core.so"
        command = [compiler, "-std=c11", "-O2", "-shared", "-fPIC", "-o", str(made), str(source), "-lm"]
        done = subprocess.run(command, capture_output=True, check=False)
        if done.returncode != 0:  # the compiler may lack its headers or libraries
            raise DeviceError(
                f"{compiler} cannot compile the simulated vehicle's app (exit {done.returncode}): a complete gcc with "
                f"its C library's headers is needed. {_WAY_OUT}"
            )
        return ctypes.CDLL(str(made))


def find_source() -> Path:
    """Return the path of `cfid_core.c`. Raises DeviceError where the installation lacks it."""
    files = [place / "firmware_patches" / "cfid_app" / "src" / "cfid_core.c" for place in _PLACES]
    found = next((file for file in files if file.is_file()), None)
    if found is None:
        raise DeviceError(f"{files[0]}: no such file, so the simulated vehicle has no app: install cfid again.")
    return found
