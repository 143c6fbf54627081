"""The table [devices] of rig.toml: ports and addresses of the instruments and the vehicle."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from cfid.records.facts import Positive, RigTable
from cfid.records.line_devices import EncoderLines, LineDevice, LoadCellLines, ScalesLines, TachometerLines
from cfid.units import FULL_COMMAND

_LINES = "lines"


class EncoderPort(RigTable):
    """Serial port of the encoder's interface, found automatically where none is given, and the polling rate."""

    kind: Literal["e201"] = "e201"
    port: str = ""
    rate_hz: Positive = 1000.0

    def sampled_at(self, rate_hz: float | None) -> Self:
        """Return the same port with another rate, where one is given."""
        return self if rate_hz is None else self.model_copy(update={"rate_hz": rate_hz})


PortNumber = Annotated[int, Field(strict=True, ge=1, le=65535)]


class LoadCellBox(RigTable):
    """Address, sampling rate and ports of the load cell's box."""

    kind: Literal["netft"] = "netft"
    address: str = Field("192.168.1.1", min_length=1)
    rate_hz: Annotated[int, Field(strict=True, gt=0)] = 7000
    rdt_port: PortNumber = 49152
    http_port: PortNumber = 80
    tcp_port: PortNumber = 49151

    def sampled_at(self, rate_hz: int | None) -> Self:
        """Return the same box with another rate, where one is given."""
        return self if rate_hz is None else self.model_copy(update={"rate_hz": rate_hz})


ServicePort = Annotated[int, Field(strict=True, ge=0, le=15)]


class CrazyflieLink(RigTable):
    """Address of the vehicle, found by radio where none is given. The ports are those of cfid's app."""

    uri: str = ""
    thrust_port: ServicePort = 10
    sine_port: ServicePort = 11
    ping_port: ServicePort = 12
    largest_command: Annotated[int, Field(strict=True, ge=0, le=FULL_COMMAND)] = FULL_COMMAND
    stop_below_v: Positive | None = None


def _sort(device: object) -> str:
    kind = device.get("kind") if isinstance(device, Mapping) else getattr(device, "kind", None)
    return _LINES if kind == _LINES else "own"


EncoderDevice = Annotated[
    Annotated[EncoderPort, Tag("own")] | Annotated[EncoderLines, Tag(_LINES)], Discriminator(_sort)
]
LoadCellDevice = Annotated[
    Annotated[LoadCellBox, Tag("own")] | Annotated[LoadCellLines, Tag(_LINES)], Discriminator(_sort)
]


class Devices(RigTable):
    """The devices connected to this computer."""

    encoder: EncoderDevice = EncoderPort()
    loadcell: LoadCellDevice = LoadCellBox()
    crazyflie: CrazyflieLink = CrazyflieLink()
    tachometer: TachometerLines | None = None
    scales: ScalesLines | None = None

    @model_validator(mode="after")
    def _find_same_ports(self) -> Self:
        """Give devices that send lines the names of others at their port: a board may serve two, in separate runs."""
        ports = {
            f"devices.{name}": Path(one.port).resolve()
            for name in type(self).model_fields
            if isinstance(one := getattr(self, name), EncoderPort | LineDevice) and one.port
        }
        for name in type(self).model_fields:
            if isinstance(one := getattr(self, name), LineDevice):
                own = f"devices.{name}"
                one.share_port(*(other for other, port in ports.items() if other != own and port == ports[own]))
        return self
