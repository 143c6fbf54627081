"""Defines the limits of motors by rig.toml and the rotors, and finds out how a vehicle's are driven.

They are driven in one of two ways: by cfid's app, or by stock firmware.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from cfid.errors import ConfigError, DeviceError
from cfid.rig.vehicle import Vehicle
from cfid.units import MOTORS
from cfid.wire.app import (
    ALL_MOTORS_SINE,
    LARGEST_COMMAND,
    MIDDLE,
    PROTOCOLS,
    AppPorts,
    Hello,
    PingChannel,
    SineRequest,
    decode_hello,
)
from cfid.wire.crtp import ECHO_CHANNEL, ECHO_PORT, Packet, decode_echo, encode_echo

Four = tuple[int, int, int, int]

STILL: Four = (0, 0, 0, 0)
STOPPED = "the motors were stopped: no further command is sent."

OWNERS_SINCE = 2  # version of the app
_DSHOT_SHIFT = 5  # of a command's 16 bits, 11 are carried
_DSHOT_NONE = 47  # values up to here are no throttle
_HELLO_S = 0.3
_HELLOS = 5


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What the operator allows in rig.toml, and what the vehicle's rotors allow.

    A vehicle with an `idle_thrust` keeps its rotors at that command or above, and locks itself where one turns at 1 to
    499 rpm. It arms only at 1000 rpm or more, so half the throttle of its idle thrust is the slowest command. While a
    motor is at zero, and so idles, a command has to be above idle thrust to count as flying.
    """

    largest_command: int = LARGEST_COMMAND
    idle_thrust: int = 0

    def check(self, largest: int, smallest: int = 0) -> None:
        """Raise ConfigError for commands beyond the limits."""
        if smallest < 0 or largest > self.largest_command:
            shown = largest if smallest >= 0 else smallest
            by = " (devices.crazyflie.largest_command in rig.toml)" if self.largest_command < LARGEST_COMMAND else ""
            raise ConfigError(f"command {shown}: commands go from 0 to {self.largest_command}{by}.")

    def slowest_command(self, motors: Sequence[int]) -> int:
        """Return the smallest command above zero for these motors while the others are at zero."""
        if not self.idle_thrust:
            return 0
        throttle = (self.idle_thrust >> _DSHOT_SHIFT) - _DSHOT_NONE
        if set(motors) != set(MOTORS) or throttle <= 0:
            return self.idle_thrust + 1
        return (_DSHOT_NONE + (throttle + 1) // 2) << _DSHOT_SHIFT

    def check_turning(self, motors: Sequence[int], smallest: int, largest: int) -> None:
        """Raise ConfigError for motors that are to turn, at commands beyond the limits; no command may be zero."""
        self.check(largest, smallest)
        slowest = self.slowest_command(motors)
        if smallest < slowest:
            others = "" if set(motors) == set(MOTORS) else " while the other motors idle"
            raise ConfigError(
                f"command {smallest}: this vehicle's rotors have to turn at {slowest} or above{others}, since its "
                f"firmware locks it where a rotor turns slower than 500 rpm (powerDist.idleThrust is "
                f"{self.idle_thrust}). Begin at {slowest}."
            )

    def refuse_idling(self, motors: Sequence[int]) -> None:
        """Raise ConfigError where the other motors would idle, so that their thrust would be measured too."""
        if self.idle_thrust and set(motors) != set(MOTORS):
            raise ConfigError(
                f"`motor` {','.join(map(str, motors))}: this vehicle's other rotors idle at {self.idle_thrust} "
                "meanwhile, and the load cell would measure them too: run all four (`motor` 1,2,3,4)."
            )

    def check_four(self, commands: Four) -> None:
        """Raise ConfigError when the commands of the four motors are beyond the limits."""
        self.check(max(commands), min(commands))
        turning = [motor for motor, command in zip(MOTORS, commands, strict=True) if command]
        if turning:
            self.check_turning(turning, min(command for command in commands if command), max(commands))

    def check_sine(self, request: SineRequest) -> None:
        """Raise ConfigError for a sine whose crest or trough is beyond the limits, clipped to the range of commands."""
        motors = MOTORS if request.motor == ALL_MOTORS_SINE else (request.motor,)
        self.check_turning(motors, max(MIDDLE - request.amplitude, 0), min(MIDDLE + request.amplitude, LARGEST_COMMAND))


@dataclass(frozen=True, kw_only=True)
class Firmware:
    """What runs on the vehicle: `app` is cfid's, `stock` has none."""

    kind: Literal["app", "stock"]
    ports: AppPorts
    hello: Hello | None = None

    @property
    def knows_owners(self) -> bool:
        """Whether it is an app that distinguishes the programs that talk to it."""
        return self.hello is not None and self.hello.protocol >= OWNERS_SINCE


async def firmware_of(vehicle: Vehicle, ports: AppPorts) -> Firmware:
    """Find out how a vehicle's motors are driven. Raises DeviceError where they cannot be."""
    hello = await vehicle.ask(
        Packet(ports.ping, PingChannel.HELLO, b""), decode_hello, within_s=_HELLO_S, tries=_HELLOS
    )
    if hello is not None:
        if hello.protocol not in PROTOCOLS:
            raise DeviceError(
                f"{vehicle.uri}: the app on the vehicle speaks version {hello.protocol}, this cfid "
                f"{' and '.join(map(str, PROTOCOLS))}: flash this cfid's app (firmware_patches/README.md)."
            )
        return Firmware(kind="app", ports=ports, hello=hello)
    # Stock firmware answers everything except the hello; a dead link answers nothing, so the echo distinguishes them.
    echo = Packet(ECHO_PORT, ECHO_CHANNEL, encode_echo(1))
    if await vehicle.ask(echo, decode_echo, within_s=_HELLO_S, tries=_HELLOS) is None:
        raise DeviceError(f"{vehicle.uri}: the vehicle no longer answers: the link is lost.")
    if vehicle.link.parameter("motorPowerSet.enable") is not None:
        return Firmware(kind="stock", ports=ports)
    raise DeviceError(
        f"{vehicle.uri}: this firmware has neither cfid's app nor the parameters motorPowerSet: its motors cannot be "
        "commanded. Update it, or flash the app (firmware_patches/README.md)."
    )
