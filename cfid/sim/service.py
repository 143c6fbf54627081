"""Serves a whole simulated rig on this machine: an encoder on a serial port, a load cell and a vehicle on UDP."""

import math
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from twisted.internet.defer import Deferred, gatherResults
from twisted.internet.posixbase import PosixReactorBase

from cfid.errors import ConfigError
from cfid.recordings.wrench import AXES
from cfid.records.rig_file import Devices, EncoderLines, LoadCellLines, Rig
from cfid.sim.app_core import load_core
from cfid.sim.crazyflie import Crazyflie
from cfid.sim.e201 import E201Device
from cfid.sim.faults import (
    SOUND_CRAZYFLIE,
    SOUND_ENCODER,
    SOUND_LOADCELL,
    CrazyflieFaults,
    EncoderFaults,
    FaultyCrazyflie,
    FaultyE201,
    FaultyNetFT,
    LoadCellFaults,
    SerialDevice,
)
from cfid.sim.imu import Hanging, Imu
from cfid.sim.lines import LineSender
from cfid.sim.link import CrazyflieServer, Radio
from cfid.sim.loadcell import SimulatedLoadCell
from cfid.sim.netft import ANY_FREE, LOOPBACK, BoxPorts, NetFTBox, NetFTServer
from cfid.sim.plants import DroppingWeight
from cfid.sim.propulsion import STILL, Four, OnMotors, Propulsion
from cfid.sim.pty import PtyPort
from cfid.sim.stepping import Array
from cfid.sim.swing import DROPS, Axis, dropping, hanging, pendulum, resting, swinging, two_threads
from cfid.sim.truth import USUAL_TRUTH, AxisTruth, SimTruth, as_mounted, draw_vehicle
from cfid.units import MM
from cfid.wire.app import AppPorts

_USB_REPLY_S = 5e-4  # half a frame of full-speed USB, on average
_LINE_RADIUS_MM = 2.0  # where rig.toml names none
_CONVERTED_HZ = 2000.0  # of the samples that a converter averages: twice the blade pass at full command
_FRICTION_SCATTER = 0.03  # from one drop to the next, as the thesis' speeds scatter (table 2.1)


class Addresses(NamedTuple):
    """The addresses of the two instruments and the vehicle; a load cell that sends lines has a port."""

    encoder_port: Path
    loadcell_port: Path | None
    address: str
    rdt_port: int
    http_port: int
    tcp_port: int
    crazyflie_uri: str


class SimulatedRig:
    """An encoder on the axis of a swing or of a dropping weight, and a vehicle that is fastened to a load cell.

    With `weight_g` a weight drops; else a vehicle swings about the mount `axis`, by default the first one, and the gyro
    and accelerometer of the vehicle on the link feel that swing. The truth may include a wind on the vehicle on the
    load cell. The rotors run at `commands` until the motors are commanded; `on_motors` is called at each change. All
    random numbers come from `seed`. Raises ConfigError for an unknown mount.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        reactor: PosixReactorBase,
        folder: Path,
        seed: int,
        truth: SimTruth = USUAL_TRUTH,
        encoder_faults: EncoderFaults = SOUND_ENCODER,
        loadcell_faults: LoadCellFaults = SOUND_LOADCELL,
        crazyflie_faults: CrazyflieFaults = SOUND_CRAZYFLIE,
        axis: str | None = None,
        weight_g: float | None = None,
        commands: Four = STILL,
        on_motors: OnMotors = lambda time_s, motors: None,
        address: str = LOOPBACK,
        ports: BoxPorts = ANY_FREE,
    ) -> None:
        """Draw the rig and integrate its axis' motion; open nothing yet, though the times of faults begin here."""
        truth = as_mounted(truth, rig)
        plant_rng, motor_rng, cell_rng, fault_rng, radio_rng, imu_rng = np.random.default_rng(seed).spawn(6)
        self._address = address
        self.axis, hangs = _axis(rig, truth, axis, weight_g, rng=plant_rng)
        self._opened_s = opened_s = reactor.seconds()  # after the integration, which takes some time
        self.encoder = FaultyE201(self._encoder(rig), encoder_faults, opened_s=opened_s)
        cell = SimulatedLoadCell(truth.loadcell, cell_rng)
        box = NetFTBox(load_cell=cell, plant=self._wrench_at, powered_s=opened_s)
        self.loadcell = FaultyNetFT(box, loadcell_faults, opened_s=opened_s, rng=fault_rng)
        self._body_n = np.append(truth.wind.body_n, np.zeros(3))
        self._propulsion = Propulsion(
            truth.rotors,
            truth.battery,
            rng=motor_rng,
            begin_s=opened_s,
            commands=commands,
            drag_ns_per_rad=truth.wind.drag_ns_per_rad,
            yaw_deg=truth.wind.yaw_deg if truth.wind.speed_mps else truth.loadcell.yaw_deg,
        )
        link = rig.devices.crazyflie
        app_ports = AppPorts(link.thrust_port, link.sine_port, link.ping_port)
        vehicle = Crazyflie(
            truth.crazyflie,
            self._propulsion,
            load_app=load_core,
            opened_s=opened_s,
            ports=app_ports,
            on_motors=on_motors,
            imu=None if hangs is None else Imu(truth.imu, hangs, self._motion_at, imu_rng),
        )
        self.crazyflie = FaultyCrazyflie(
            vehicle,
            self._propulsion,
            Radio(truth.radio, radio_rng),
            crazyflie_faults,
            ping_port=app_ports.ping,
            opened_s=opened_s,
        )
        self._pty = PtyPort(self.encoder, reactor=reactor, folder=folder)
        self._cell_pty: PtyPort | None = None
        if isinstance(setting := rig.devices.loadcell, LoadCellLines):
            sender = LineSender(setting, partial(self._load_at, cell, 1 / setting.rate_hz), powered_s=opened_s)
            faulty = FaultyE201(sender, _of_lines(loadcell_faults), opened_s=opened_s)
            self._cell_pty = PtyPort(faulty, reactor=reactor, folder=folder, name="loadcell")
        self._server = NetFTServer(self.loadcell, reactor=reactor, address=address, ports=ports)
        self._link = CrazyflieServer(self.crazyflie, reactor=reactor, address=address)

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

    def _encoder(self, rig: Rig) -> SerialDevice:
        if not isinstance(setting := rig.devices.encoder, EncoderLines):
            return E201Device(self._angle_at, reply_s=_USB_REPLY_S, powered_s=self._opened_s)
        counts = float(rig.encoder.counts_per_turn) if setting.counted else math.tau
        return LineSender(
            setting,
            lambda time_s: {"phi": self._angle_at(time_s) / math.tau % 1.0 * counts},
            powered_s=self._opened_s,
        )

    def _load_at(self, cell: SimulatedLoadCell, period_s: float, time_s: float) -> dict[str, float]:
        """Return what the load cell shows, in N and N m: the mean over a period, as bridge converters return it."""
        count = max(round(period_s * _CONVERTED_HZ), 1)
        at = np.maximum(np.linspace(time_s - period_s, time_s, count + 1)[1:], self._opened_s)
        wrench = self._wrench_at(at).mean(axis=0, keepdims=True)
        shown = cell.read(at[-1:], wrench)[0][0] / cell.truth.counts_per_unit
        return dict(zip(AXES, shown.tolist(), strict=True))

    def _angle_at(self, time_s: float) -> float:
        return self.axis.angle_at(time_s - self._opened_s)

    def _motion_at(self, time_s: float) -> tuple[float, float, float]:
        return self.axis.motion_at(time_s - self._opened_s)

    def _wrench_at(self, time_s: Array) -> Array:
        self.crazyflie.advance(float(time_s[-1]))  # packets until then already drive its motors
        return np.asarray(self._propulsion.wrench_at(time_s) + self._body_n)


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


def _of_lines(faults: LoadCellFaults) -> EncoderFaults:
    """Return those of a box' faults that lines can have too."""
    return EncoderFaults(
        drop_every=faults.drop_every,
        corrupt_every=faults.corrupt_every,
        silent_after_s=faults.silent_after_s,
        silent_for_s=faults.silent_for_s,
    )


def _axis(
    rig: Rig, truth: SimTruth, name: str | None, weight_g: float | None, *, rng: np.random.Generator
) -> tuple[Axis, Hanging | None]:
    """Return what turns the encoder, and how the vehicle hangs on it, None where it does not."""
    vehicle = draw_vehicle(rig, truth, rng=rng)
    off_rad = truth.swing.eccentricity_rad
    if weight_g is not None:
        weights = _weights(rig, truth.axis, weight_g, gravity_mps2=vehicle.gravity_mps2, rng=rng)
        return dropping(weights, rng=rng, eccentricity_rad=off_rad), None
    if name is not None and name not in vehicle.mounts:
        raise ConfigError(f"rig.toml: mounts: there is no '{name}'. There are: {', '.join(vehicle.mounts) or 'none'}.")
    mount = name or next(iter(vehicle.mounts), None)
    if mount is None:
        return resting(offset_rad=0.0), None
    body = two_threads(vehicle, mount) or pendulum(vehicle, mount)
    return swinging(body, rng=rng, eccentricity_rad=off_rad), hanging(vehicle, mount)


def _weights(
    rig: Rig, axis: AxisTruth, weight_g: float, *, gravity_mps2: float, rng: np.random.Generator
) -> list[DroppingWeight]:
    """Return the same weight DROPS times: dry friction differs slightly from one drop to the next."""
    return [
        DroppingWeight(
            setup_inertia_kg_m2=axis.setup_inertia_kg_m2,
            weight_kg=weight_g / 1000,
            radius_m=MM * (rig.friction.lever_mm if rig.friction else _LINE_RADIUS_MM),
            viscous_nms_per_rad=axis.viscous_nms_per_rad,
            coulomb_nm=axis.coulomb_nm * rng.normal(1, _FRICTION_SCATTER),
            gravity_mps2=gravity_mps2,
            line_diameter_m=MM * axis.line_diameter_mm,
            turns_per_layer=axis.turns_per_layer,
        )
        for _ in range(DROPS)
    ]
