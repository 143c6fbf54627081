"""The devices of a simulated rig, on any clock: an encoder, a load cell and a vehicle; no port, no address."""

import math
from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np

from cfid.errors import ConfigError
from cfid.recordings.wrench import AXES
from cfid.records.rig_file import EncoderLines, LoadCellLines, Rig
from cfid.sim.app_core import load_core
from cfid.sim.crazyflie import Crazyflie
from cfid.sim.e201 import E201Device
from cfid.sim.faults import (
    SOUND_CRAZYFLIE,
    SOUND_ENCODER,
    SOUND_LOADCELL,
    CrazyflieFaults,
    EncoderFaults,
    FaultyNetFT,
    FaultySerial,
    LoadCellFaults,
    SerialDevice,
)
from cfid.sim.imu import Hanging, Imu
from cfid.sim.lines import LineSender
from cfid.sim.link import Radio, VehicleLink
from cfid.sim.loadcell import SimulatedLoadCell
from cfid.sim.netft import NetFTBox
from cfid.sim.plants import DroppingWeight
from cfid.sim.propulsion import STILL, Four, OnMotors, Propulsion
from cfid.sim.stepping import Array
from cfid.sim.swing import (
    DROPS,
    PERIOD_S,
    Axis,
    Truth,
    draw_testbody,
    dropping,
    hanging,
    pendulum,
    resting,
    swinging,
    two_threads,
)
from cfid.sim.truth import USUAL_TRUTH, AxisTruth, SimTruth, as_mounted, draw_vehicle
from cfid.units import MM
from cfid.wire.app import AppPorts

_USB_REPLY_S = 5e-4  # half a frame of full-speed USB, on average
_TESTBODY = 1 << 40  # distinguishes its random numbers from those of a power-on
_LINE_RADIUS_MM = 2.0  # where rig.toml names none
_UNSEEN_S = 3.0  # without a reading of the encoder: the next one begins a recording
_CONVERTED_HZ = 2000.0  # of the samples that a converter averages: twice the blade pass at full command
_FRICTION_SCATTER = 0.03  # from one drop to the next, as the thesis' speeds scatter (table 2.1)

Body = Literal["crazyflie", "testbody"]


class SimulatedRig:
    """An encoder on the axis of a swing or of a dropping weight, and a vehicle that is fastened to a load cell.

    With `weight_g` a weight drops; else a vehicle swings about the mount `axis`, by default the first one, and the gyro
    and accelerometer of the vehicle on the link feel that swing. The truth may include a wind on the vehicle on the
    load cell. The rotors run at `commands` until the motors are commanded; `on_motors` is called at each change.

    All random numbers come from `seed`: those of the rig itself, and of what differs from one power-on to the next,
    for which `power_on` counts. Raises ConfigError for an unknown mount.
    """

    def __init__(
        self,
        rig: Rig,
        *,
        seconds: Callable[[], float],
        seed: int,
        truth: SimTruth = USUAL_TRUTH,
        encoder_faults: EncoderFaults = SOUND_ENCODER,
        loadcell_faults: LoadCellFaults = SOUND_LOADCELL,
        crazyflie_faults: CrazyflieFaults = SOUND_CRAZYFLIE,
        axis: str | None = None,
        body: Body = "crazyflie",
        weight_g: float | None = None,
        power_on: int = 0,
        commands: Four = STILL,
        on_motors: OnMotors = lambda time_s, motors: None,
    ) -> None:
        """Draw the rig and integrate its axis' motion; the times of faults begin here, on the clock `seconds`."""
        truth = as_mounted(truth, rig)
        plant_rng, *streams = np.random.default_rng(seed).spawn(6)
        hung = draw_vehicle(rig, truth, rng=plant_rng)
        if body == "testbody":
            hung = drawn_testbody(rig, truth, hung, seed=seed)
        if power_on:
            plant_rng, *streams = np.random.default_rng([seed, power_on]).spawn(6)
        motor_rng, cell_rng, fault_rng, radio_rng, imu_rng = streams
        self.axis, hangs = _axis(rig, truth, hung, axis, weight_g, rng=plant_rng)
        self._opened_s = opened_s = seconds()  # after the integration, which takes some time
        self._moves_s = self._looked_s = opened_s  # since when the axis moves, and when the encoder was read last
        self.encoder = FaultySerial(self._encoder(rig), encoder_faults, opened_s=opened_s)
        cell = SimulatedLoadCell(truth.loadcell, cell_rng)
        box = NetFTBox(load_cell=cell, plant=self._wrench_at, powered_s=opened_s)
        self.loadcell = FaultyNetFT(box, loadcell_faults, opened_s=opened_s, rng=fault_rng)
        self._body_n = np.append(truth.wind.body_n, np.zeros(3))
        self.on_supply = truth.battery.kind == "supply"
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
        self.crazyflie = VehicleLink(
            vehicle,
            self._propulsion,
            Radio(truth.radio, radio_rng),
            crazyflie_faults,
            ping_port=app_ports.ping,
            opened_s=opened_s,
        )
        self.loadcell_lines: FaultySerial | None = None  # a load cell that sends lines, where rig.toml has one
        if isinstance(setting := rig.devices.loadcell, LoadCellLines):
            sender = LineSender(setting, partial(self._load_at, cell, 1 / setting.rate_hz), powered_s=opened_s)
            self.loadcell_lines = FaultySerial(sender, _of_lines(loadcell_faults), opened_s=opened_s)

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
        """Return the angle that the encoder sees; the operator begins a motion when a recording begins to look."""
        if time_s - self._looked_s > _UNSEEN_S:
            self._moves_s = time_s - math.ceil((time_s - self._moves_s) / PERIOD_S) * PERIOD_S
        self._looked_s = time_s
        return self.axis.angle_at(time_s - self._moves_s)

    def _motion_at(self, time_s: float) -> tuple[float, float, float]:
        return self.axis.motion_at(time_s - self._moves_s)

    def _wrench_at(self, time_s: Array) -> Array:
        self.crazyflie.advance(float(time_s[-1]))  # packets until then already drive its motors
        return np.asarray(self._propulsion.wrench_at(time_s) + self._body_n)


def _of_lines(faults: LoadCellFaults) -> EncoderFaults:
    """Return those of a box' faults that lines can have too."""
    shared = {"drop_every", "corrupt_every", "silent_after_s", "silent_for_s"}
    return EncoderFaults.model_validate(faults.model_dump(include=shared))


def drawn_testbody(rig: Rig, truth: SimTruth, vehicle: Truth, *, seed: int) -> Truth:
    """Return the test body of a rig whose vehicle has been drawn; both swing at one place."""
    rng = np.random.default_rng([seed, _TESTBODY])
    return draw_testbody(rig, rng=rng, gravity_mps2=vehicle.gravity_mps2, friction=truth.swing.friction)


def _axis(
    rig: Rig, truth: SimTruth, hung: Truth, name: str | None, weight_g: float | None, *, rng: np.random.Generator
) -> tuple[Axis, Hanging | None]:
    """Return what turns the encoder, and how a body hangs on it, None where it does not."""
    off_rad = truth.swing.eccentricity_rad
    if weight_g is not None:
        weights = _weights(rig, truth.axis, weight_g, gravity_mps2=hung.gravity_mps2, rng=rng)
        return dropping(weights, rng=rng, eccentricity_rad=off_rad), None
    if name is not None and name not in hung.mounts:
        raise ConfigError(f"rig.toml: mounts: there is no '{name}'. There are: {', '.join(hung.mounts) or 'none'}.")
    mount = name or next(iter(hung.mounts), None)
    if mount is None:
        return resting(offset_rad=0.0), None
    pendulum_or_threads = two_threads(hung, mount) or pendulum(hung, mount)
    return swinging(pendulum_or_threads, rng=rng, eccentricity_rad=off_rad), hanging(hung, mount)


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
