"""Make parameter sets: from a campaign's rig, from its flights, and from complete published values."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from cfid.errors import CfidError
from cfid.flight.data import same_flight
from cfid.flight.model import ThrustLag
from cfid.flight.rows import AXES
from cfid.published import PublishedSet, turned
from cfid.published.set_file import PublishedValue
from cfid.recordings.read import read_recording
from cfid.recordings.recording import Recording
from cfid.records.campaign import Campaign
from cfid.records.files import RIG_FILE
from cfid.records.fits import read_fit
from cfid.records.parameters import Parameter
from cfid.records.rig_file import Rig, load_rig, thesis_rig
from cfid.records.run import run_holding
from cfid.records.values import Values
from cfid.units import FULL_COMMAND, MM
from cfid.validation.predictions import ParameterSet

_BEYOND = 20.0  # times mass times arm squared, or one over it: bodies have 0.2 to 2
_NO_TORQUE = ", no torque about yaw"


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The values of a campaign or of one kept fit, with the rig, None for a fit outside a campaign.

    Paths of their recordings are relative to `folder`.
    """

    name: str
    folder: Path
    values: Values
    rig: Rig | None

    def get(self, key: str) -> Parameter | None:
        """Return an accepted parameter, None where there is none."""
        value = self.values.find(key)
        return None if value is None or not value.accepted or value.parameter.value is None else value.parameter

    def __getitem__(self, key: str) -> Parameter:
        """Return an accepted parameter. Raises KeyError with a sentence where there is none."""
        parameter = self.get(key)
        if parameter is not None:
            return parameter
        reason = self.values.rejected(key)
        raise KeyError(f"{key} was rejected: {reason}" if reason else f"{key} is not there.")

    def fitted_to(self, log: Recording) -> bool:
        """Return whether any parameter comes from a log: from this file, or from the same flight in another file."""
        hashes = {source.sha256 for fit in self.values.by_fit for source in fit.section.sources}
        return log.source.sha256 in hashes or any(same_flight(log, flight) for flight in self._flights())

    def _flights(self) -> Iterator[Recording]:
        """Yield the logs of flights whose files still exist at their paths."""
        for source in (source for fit in self.values.by_fit if fit.name == "flight" for source in fit.section.sources):
            path = self.folder / source.path
            with suppress(CfidError):
                run = run_holding(path)
                yield read_recording(path if run is None else run.folder)


def measured_in(campaign: Campaign) -> Measured:
    """Return the values of a campaign."""
    folder = campaign.folder
    return Measured(name=folder.resolve().name, folder=folder, values=campaign.values(), rig=campaign.rig)


def measured_file(path: Path) -> Measured:
    """Return the values of a kept fit by its path. Raises DataError for another file."""
    fit, folder = read_fit(path), path.absolute().parent.parent
    rig = load_rig(folder / RIG_FILE) if (folder / RIG_FILE).is_file() else None
    return Measured(name=fit.stem, folder=folder, values=Values([fit], rig or thesis_rig(), lambda _: ()), rig=rig)


class _Logged(NamedTuple):
    """What a log shows besides commands: the battery's voltage, and rotor speeds."""

    in_volts: bool
    by_speed: bool


def sets_of(measured: Measured, *, in_volts: bool, by_speed: bool = False) -> tuple[list[ParameterSet], list[str]]:
    """Return the sets that parameters give for a log with or without voltage, and why other sets are incomplete.

    With rotor speeds in the log, `by_speed`, a set with thrust over speed needs neither thrust over commands nor lags.
    One set is from the rig's experiments, with rig.toml's mass and arm; the other is from flights, with the mass and
    arm that scaled them.
    """
    sets, missing = [], []
    makers: dict[str, Callable[[Measured, str, _Logged], ParameterSet]] = {"rig": _of_rig, "flight": _of_flights}
    for what, make in makers.items():
        try:
            made = make(measured, f"{measured.name} ({what})", _Logged(in_volts, by_speed))
        except KeyError as error:
            missing.append(f"{measured.name}: no set of the {what}: {error.args[0]}")
            continue
        if fault := _impossible(made):
            missing.append(f"{measured.name}: no set of the {what}: {fault}, which no vehicle has.")
        else:
            sets.append(made)
    return sets, missing


def published_parameters(published: PublishedSet, *, in_volts: bool, by_speed: bool = False) -> ParameterSet:
    """Return a published set for a log with or without voltage and speeds.

    Raises KeyError with a sentence where the set states too little to predict such a log.
    """
    along = turned(published["inertia.matrix_kg_m2"].value, published.frame)
    lag, torque = published.find("tf.time_constant_s"), published.find("motor.torque_poly")
    over_speed, of_volts = _over_speed(published.find), published.find("motor.thrust_voltage_poly")
    thrust_n: tuple[float, ...] = ()
    if not (by_speed and over_speed):
        if of_volts is not None and not in_volts:
            raise KeyError("its thrust is of volts, and the log has no battery voltage (pm.vbat).")
        thrust_n = (
            _over_full_command(published["motor.thrust_poly"].value) if of_volts is None else tuple(of_volts.value)
        )
    return ParameterSet(
        name=published.name,
        origin=published.origin(published["mass_kg"]) + (_NO_TORQUE if torque is None else ""),
        mass_kg=published["mass_kg"].value,
        moments_kg_m2=(along["roll"], along["pitch"], along["yaw"]),
        arm_m=published["arm_m"].value,
        torque_m=0.0 if torque is None else torque.value[-2],
        thrust_n=thrust_n,
        in_volts=bool(thrust_n) and of_volts is not None,
        lag=None if lag is None else ThrustLag(lag.value, lag.value),
        thrust_speed_n=over_speed,
    )


def _impossible(vehicle: ParameterSet) -> str:
    """Return the impossible value of a set in words, "" if all are possible."""
    sizes = {"mass": vehicle.mass_kg, "arm": vehicle.arm_m, **dict(zip(AXES, vehicle.moments_kg_m2, strict=True))}
    wrong = next((name for name, size in sizes.items() if not 0 < size < math.inf), None)
    if wrong is not None:
        return f"{wrong} {sizes[wrong]:g}"
    of_points = vehicle.mass_kg * vehicle.arm_m**2  # with the mass at the motors, the moment about yaw is twice this
    far = next((axis for axis in AXES if not 1 / _BEYOND < sizes[axis] / of_points < _BEYOND), None)
    if far is not None:
        return f"moment about {far} of {sizes[far] / of_points:.3g} times mass times arm squared"
    if vehicle.lag is not None and not all(0 <= tau_s < 1 for tau_s in vehicle.lag):
        return f"lags of {vehicle.lag.rising_s:g} and {vehicle.lag.falling_s:g} s"
    return ""


def _of_rig(measured: Measured, name: str, logged: _Logged) -> ParameterSet:
    if measured.rig is None:
        raise KeyError("no rig.toml with mass and arm belongs to the fit.")
    matrix = turned(measured["inertia.matrix_kg_m2"].value, measured.rig.vehicle.body_frame)
    arm_mm = measured.rig.facts.loadcell.arm_mm
    if arm_mm is None:
        raise KeyError("arm_mm is not in rig.toml.")
    thrust_n, in_volts = _thrust(measured, "motor", logged)
    lag_s = measured["tf.time_constant_s"].value if thrust_n else None
    return ParameterSet(
        name=name,
        origin="its experiments on the rig",
        mass_kg=measured.rig.vehicle.mass_kg,
        moments_kg_m2=(matrix["roll"], matrix["pitch"], matrix["yaw"]),
        arm_m=MM * arm_mm,
        torque_m=float(measured["motor.torque_poly"].value[-2]),
        thrust_n=thrust_n,
        in_volts=in_volts,
        lag=None if lag_s is None else ThrustLag(lag_s, lag_s),
        thrust_speed_n=_over_speed(measured.get),
        rotor_inertia_kg_m2=_rotor_inertia_kg_m2(measured),
    )


def _of_flights(measured: Measured, name: str, logged: _Logged) -> ParameterSet:
    roll, pitch = (float(measured[f"flight.inertia_kg_m2.{axis}"].value) for axis in ("roll", "pitch"))
    thrust_n, in_volts = _thrust(measured, "flight", logged)
    lags_s = [measured[f"flight.{way}_s"].value for way in ("rising", "falling")] if thrust_n else None
    yaw, torque_m = measured.get("flight.inertia_kg_m2.yaw"), None
    if yaw is not None:  # with the torque over thrust that scaled it, else the rig's
        scaled, rig = measured.get("flight.torque_m"), measured.get("motor.torque_poly")
        torque_m = scaled.value if scaled is not None else rig.value[-2] if rig is not None else None
    unknown = f"{_NO_TORQUE}, whose moment is unknown: it stands as the sum of the others"
    return ParameterSet(
        name=name,
        origin="its flights" + (unknown if torque_m is None else ""),
        mass_kg=float(measured["flight.mass_kg"].value),
        moments_kg_m2=(roll, pitch, roll + pitch if yaw is None else float(yaw.value)),
        arm_m=float(measured["flight.arm_m"].value),
        torque_m=float(torque_m or 0.0),
        thrust_n=thrust_n,
        in_volts=in_volts,
        lag=None if lags_s is None else ThrustLag(*lags_s),
        drag_per_s=_pair(measured, "flight.drag_over_mass_per_s.forward", "flight.drag_over_mass_per_s.left"),
        thrust_speed_n=_over_speed(measured.get),
        rotor_inertia_kg_m2=_rotor_inertia_kg_m2(measured),
        moment_per_velocity_ns=_pair(
            measured, "flight.moment_per_velocity_ns.roll", "flight.moment_per_velocity_ns.pitch"
        ),
    )


def _pair(measured: Measured, *keys: str) -> tuple[float, float] | None:
    first, second = map(measured.get, keys)
    return None if first is None or second is None else (float(first.value), float(second.value))


def _rotor_inertia_kg_m2(measured: Measured) -> float:
    found = measured.get("rotor_inertia_kg_m2")
    return 0.0 if found is None else float(found.value)


def _thrust(measured: Measured, experiment: str, logged: _Logged) -> tuple[tuple[float, ...], bool]:
    """Return one rotor's thrust, lowest power first, over volts if log and campaign have them, else over commands.

    There is none where the thrust over speed serves instead.
    """
    if logged.by_speed and _over_speed(measured.get) is not None:
        return (), False
    of_volts = measured.get(f"{experiment}.thrust_voltage_poly")
    if logged.in_volts and of_volts is not None:
        return tuple(map(float, of_volts.value)), True
    return _over_full_command(measured[f"{experiment}.thrust_poly"].value), False


def _over_speed(find: Callable[[str], Parameter | PublishedValue | None]) -> tuple[float, ...] | None:
    """Return one rotor's thrust over its speed in rad/s, lowest power first, None where it is not known."""
    poly, square = find("motor.thrust_speed_poly"), find("motor.thrust_per_speed_squared_n_s2")
    if poly is not None:
        return tuple(map(float, reversed(poly.value)))
    return None if square is None else (0.0, 0.0, float(square.value))


def _over_full_command(thrust_poly: Sequence[float]) -> tuple[float, ...]:
    """Return a thrust map's coefficients over the command relative to full command, lowest power first."""
    return tuple(float(value) * FULL_COMMAND**power for power, value in enumerate(reversed(thrust_poly)))
