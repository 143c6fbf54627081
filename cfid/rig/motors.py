"""The vehicle's motors: set within the limits of rig.toml, watched while they run, stopped and checked.

Which of three ways a vehicle has is asked of it: cfid's app, the thesis' modules of 2015, or stock firmware.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar

from cfid.errors import ConfigError, DeviceError
from cfid.wire.app import LARGEST_COMMAND, MIDDLE, PROTOCOL, Hello, PingChannel, Ports, SineRequest, decode_hello
from cfid.wire.crtp import ECHO_CHANNEL, ECHO_PORT, Packet, decode_echo, encode_echo

Answer = TypeVar("Answer")
Four = tuple[int, int, int, int]

STILL: Four = (0, 0, 0, 0)
MOTORS = (1, 2, 3, 4)
MAY_BE_RUNNING = "THE MOTORS MAY STILL BE RUNNING. KEEP CLEAR AND PULL THE BATTERY"

STOPPED = "the motors were stopped: nothing is commanded any more."

_HELLO_S = 0.3
_HELLOS = 5


class Motors(Protocol):
    """Four motors of a vehicle."""

    def start(self) -> None:
        """Begin to watch over them."""

    async def set(self, commands: Four) -> float:
        """Bring all four to commands; return when the first request that counted was sent, on the monotonic clock.

        May be cancelled half-way; the next call then sets all of them. Raises ConfigError beyond the limits,
        DeviceError when the vehicle does not obey, or once `stop` was called.
        """

    def check(self) -> None:
        """Raise DeviceError when the vehicle stopped them by itself, or can no longer be reached."""

    async def stop(self) -> None:
        """Stop them for good and see that they stopped. Raises StopError when that is not certain."""


class SinePlayer(Motors, Protocol):
    """Motors that can play the sine of eq. 3.6 on board."""

    @property
    def playing(self) -> bool:
        """Whether the vehicle said lately that it plays."""

    async def be_ready(self, request: SineRequest) -> None:
        """Wait for an earlier sine's last word. Raises ConfigError beyond the limits, DeviceError for another's."""

    async def play(self, request: SineRequest) -> None:
        """Let it begin. Raises ConfigError beyond the limits, DeviceError when the vehicle refuses."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What the operator allows in rig.toml."""

    largest_command: int = LARGEST_COMMAND

    def check(self, largest: int, smallest: int = 0) -> None:
        """Raise ConfigError for commands beyond the limits."""
        if smallest < 0 or largest > self.largest_command:
            shown = largest if smallest >= 0 else smallest
            by = " (devices.crazyflie.largest_command in rig.toml)" if self.largest_command < LARGEST_COMMAND else ""
            raise ConfigError(f"command {shown}: commands go from 0 to {self.largest_command}{by}.")

    def check_sine(self, request: SineRequest) -> None:
        """Raise ConfigError for a sine whose crest is beyond the limit; the vehicle clips what no motor can do."""
        self.check(min(MIDDLE + request.amplitude, LARGEST_COMMAND))


@dataclass(frozen=True, kw_only=True)
class Firmware:
    """What runs on the vehicle: `app` is cfid's, `thesis` the modules of 2015, `stock` neither."""

    kind: Literal["app", "thesis", "stock"]
    ports: Ports
    hello: Hello | None = None


class Asked(Protocol):
    """A link that is asked before a loop runs, as `crazyflie.Link` is one."""

    uri: str

    def ask(
        self, packet: Packet, read: Callable[[Packet], Answer | None], *, within_s: float, tries: int
    ) -> Answer | None:
        """Return what `read` made of an answer, None without one."""

    def parameter(self, name: str) -> object:
        """Return a parameter."""


def firmware_of(link: Asked, ports: Ports) -> Firmware:
    """Ask a vehicle which way it has. Raises DeviceError for one without any."""

    def answer(packet: Packet) -> Hello | str | None:
        if packet.port != ports.ping:
            return None
        return decode_hello(packet.payload) or ("thesis" if not packet.payload else None)

    heard = link.ask(Packet(ports.ping, PingChannel.HELLO, b""), answer, within_s=_HELLO_S, tries=_HELLOS)
    if isinstance(heard, Hello):
        if heard.protocol != PROTOCOL:
            raise DeviceError(
                f"{link.uri}: the app on the vehicle speaks version {heard.protocol}, this cfid {PROTOCOL}: flash the "
                "app that came with it (firmware_patches/README.md)."
            )
        return Firmware(kind="app", ports=ports, hello=heard)
    if heard:
        return Firmware(kind="thesis", ports=ports)
    # Stock firmware is what answers everything but this: a link that is dead says nothing of either.
    if link.ask(Packet(ECHO_PORT, ECHO_CHANNEL, encode_echo(1)), _echoed, within_s=_HELLO_S, tries=_HELLOS) is None:
        raise DeviceError(f"{link.uri}: the vehicle answers no more: the link is lost.")
    if link.parameter("motorPowerSet.enable") is not None:
        return Firmware(kind="stock", ports=ports)
    raise DeviceError(
        f"{link.uri}: this firmware has neither cfid's app nor the parameters motorPowerSet: its motors cannot be "
        "commanded. Update it, or flash the app (firmware_patches/README.md)."
    )


def _echoed(packet: Packet) -> bool | None:
    return True if packet[:2] == (ECHO_PORT, ECHO_CHANNEL) and decode_echo(packet.payload) else None
