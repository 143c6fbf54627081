"""Serves a simulated rig on this machine: an encoder on a serial port, a load cell and a vehicle on UDP."""

from pathlib import Path
from typing import Any, NamedTuple

from twisted.internet.defer import Deferred, gatherResults
from twisted.internet.posixbase import PosixReactorBase

from cfid.records.rig_file import Devices, EncoderLines, LoadCellLines
from cfid.sim.devices import SimulatedRig
from cfid.sim.link import CrazyflieServer
from cfid.sim.netft import ANY_FREE, LOOPBACK, BoxPorts, NetFTServer
from cfid.sim.pty import PtyPort


class Addresses(NamedTuple):
    """The addresses of the two instruments and the vehicle; a load cell that sends lines has a port."""

    encoder_port: Path
    loadcell_port: Path | None
    address: str
    rdt_port: int
    http_port: int
    tcp_port: int
    crazyflie_uri: str


class ServedRig:
    """A simulated rig on pseudo-terminals in a folder, and on ports of one address."""

    def __init__(
        self,
        rig: SimulatedRig,
        *,
        reactor: PosixReactorBase,
        folder: Path,
        address: str = LOOPBACK,
        ports: BoxPorts = ANY_FREE,
    ) -> None:
        """Open nothing yet."""
        self._address = address
        self._pty = PtyPort(rig.encoder, reactor=reactor, folder=folder)
        lines = rig.loadcell_lines
        self._cell_pty = None if lines is None else PtyPort(lines, reactor=reactor, folder=folder, name="loadcell")
        self._server = NetFTServer(rig.loadcell, reactor=reactor, address=address, ports=ports)
        self._link = CrazyflieServer(rig.crazyflie, reactor=reactor, address=address)

    def open(self) -> Addresses:
        """Open all ports. Raises twisted's CannotListenError when a port is taken."""
        ports = self._server.open()
        cell_port = None if self._cell_pty is None else self._cell_pty.open()
        return Addresses(self._pty.open(), cell_port, self._address, *ports, self._link.open())

    def close(self) -> Deferred[list[Any]]:
        """Close all ports; fires when all are closed."""
        self._pty.close()
        if self._cell_pty is not None:
            self._cell_pty.close()
        closing: list[Deferred[Any]] = [self._server.close(), self._link.close()]
        return gatherResults(closing)


def devices_at(where: Addresses, devices: Devices) -> Devices:
    """Return a rig's devices at the addresses of the simulated ones, whose lines all have one form."""
    encoder, loadcell = devices.encoder, devices.loadcell
    own_form = {"pattern": ""}
    box = {
        "address": where.address,
        "rdt_port": where.rdt_port,
        "http_port": where.http_port,
        "tcp_port": where.tcp_port,
    }
    return Devices(
        encoder=encoder.model_copy(
            update={"port": str(where.encoder_port), **(own_form if isinstance(encoder, EncoderLines) else {})}
        ),
        loadcell=loadcell.model_copy(
            update={"port": str(where.loadcell_port), **own_form} if isinstance(loadcell, LoadCellLines) else box
        ),
        crazyflie=devices.crazyflie.model_copy(update={"uri": where.crazyflie_uri}),
        tachometer=devices.tachometer,
        scales=devices.scales,
    )
