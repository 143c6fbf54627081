"""Whole experiments on simulated rigs, fitted as in a notebook: the true values and the results."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import cfid
from cfid.demo.truth import true_motors
from cfid.records.campaign import Campaign
from cfid.records.result import Result
from cfid.sim.loadcell import LoadCellTruth
from cfid.sim.swing import pendulum
from cfid.sim.truth import SimTruth, draw_vehicle
from tests.offline.motors import (
    FULL_RATE_HZ,
    MOTORS,
    PINGS,
    QUICK_STEPS,
    ping_run,
    record_staircase,
    sine_runs,
    speed_run,
)
from tests.offline.runs import SimulatedRun
from tests.offline.stand import simulate_stand, staircase_steps
from tests.offline.swings import drop_runs, swing_runs
from tests.offline.wind import record_chapter_4
from tests.offline.write import write_runs

STEPS = tuple(range(8000, 64001, 8000))
MODERATE_STEPS = tuple(range(8000, 56001, 8000))
HOLD_S, REST_S = 2.5, 1.0
FULL_COMMAND = 65535


class Measured(NamedTuple):
    """The true numbers by name, and the results."""

    truth: Mapping[str, float]
    results: Sequence[Result]


Experiment = Callable[[Campaign, SimTruth, np.random.Generator], Measured]


def swing(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """One swing. The true value is the frequency of the pendulum itself, without the spring of a cable."""
    vehicle = draw_vehicle(campaign.rig, truth, rng=rng)
    (path,) = write_runs(campaign, swing_runs("crazyflie", vehicle, ["x"], truth, rng))
    body = pendulum(vehicle, "x")
    known = {"swing.natural_frequency_squared_s2": body.gravity_moment_nm / body.axis_inertia_kg_m2}
    return Measured(known, [cfid.swing.fit(path)])


def matrix(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    return _matrix(campaign, truth, _six_swings(campaign, truth, rng))


def swapped_matrix(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """Six swings, of which two have exchanged labels."""
    runs = _six_swings(campaign, truth, rng)
    one, other = rng.choice(len(runs), 2, replace=False)
    runs[one], runs[other] = replace(runs[one], axis=runs[other].axis), replace(runs[other], axis=runs[one].axis)
    return _matrix(campaign, truth, runs)


def _six_swings(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> list[SimulatedRun]:
    vehicle = draw_vehicle(campaign.rig, truth, rng=rng)
    return swing_runs("crazyflie", vehicle, vehicle.mounts, truth, rng)


def _matrix(campaign: Campaign, truth: SimTruth, runs: Sequence[SimulatedRun]) -> Measured:
    inertia = np.array(truth.vehicle.inertia_kg_m2)
    places = [("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2)]
    known = {f"inertia.matrix_kg_m2 {name}": float(inertia[i, j]) for name, i, j in places}
    return Measured(known, [cfid.inertia.fit(write_runs(campaign, runs))])


def friction(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    return _friction(campaign, truth, drop_runs(campaign.rig, truth, campaign.rig.site.gravity_mps2, rng))


def swapped_friction(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """Drops, of which the first and the last, 20 and 50 g, have exchanged labels."""
    runs = drop_runs(campaign.rig, truth, campaign.rig.site.gravity_mps2, rng)
    light, heavy = runs[0].weight_g, runs[-1].weight_g
    runs[0], runs[-1] = replace(runs[0], weight_g=heavy), replace(runs[-1], weight_g=light)
    return _friction(campaign, truth, runs)


def _friction(campaign: Campaign, truth: SimTruth, runs: Sequence[SimulatedRun]) -> Measured:
    known = {
        "friction.coulomb_nm": truth.axis.coulomb_nm,
        "friction.viscous_nms_per_rad": truth.axis.viscous_nms_per_rad,
    }
    return Measured(known, [cfid.friction.fit(write_runs(campaign, runs))])


def thrust_and_torque(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """A staircase on the load cell: the maps' coefficients, and the thrust at full command."""
    return _maps(campaign, truth, _staircase(campaign, truth, rng, STEPS))


def up_and_down(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """The same for a staircase up and down."""
    return _maps(campaign, truth, _staircase(campaign, truth, rng, (*STEPS, *STEPS[::-1])))


def slow_up_and_down(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """The same with each command held for as long as in the thesis."""
    return _maps(campaign, truth, _staircase(campaign, truth, rng, (*STEPS, *STEPS[::-1]), hold_s=10.0))


def _maps(campaign: Campaign, truth: SimTruth, path: Path) -> Measured:
    known = {name: true for name, true in true_motors(truth).items() if name.startswith(("motor.thrust_poly", _TORQUE))}
    rotors, gravity_mps2 = truth.rotors, campaign.rig.site.gravity_mps2
    fastest_rad_s = float(rotors.steady_rad_per_s(np.array(FULL_COMMAND), volts=rotors.nominal_v))
    known["motor.max_thrust_n"] = rotors.thrust_ns2_per_rad2 * fastest_rad_s**2
    results = [cfid.motors.maps.fit_thrust(path, gravity_mps2=gravity_mps2), cfid.motors.maps.fit_torque(path)]
    return Measured(known, results)


_TORQUE = "motor.torque_poly [0]"


def maximum_thrust(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """A staircase to 56000; the true value is the thrust of four at full command afterwards, on the same battery."""
    path = _staircase(campaign, truth, rng, MODERATE_STEPS)
    when, duration_s = staircase_steps([*MODERATE_STEPS, FULL_COMMAND], motors=MOTORS, hold_s=HOLD_S, rest_s=REST_S)
    *before, (full_s, _), last = when
    stand = simulate_stand(
        rotors=truth.rotors.model_copy(update={"unbalance": (0.0,) * 6, "blade_pass": (0.0,) * 6}),
        loadcell=LoadCellTruth(bias=(0.0,) * 6, drift_per_s=(0.0,) * 6, noise_std=(0.0,) * 6),
        battery=truth.battery,
        steps=[*before, (full_s, (FULL_COMMAND,) * 4), last],
        duration_s=duration_s,
        rate_hz=1000,
        rng=np.random.default_rng(0),
    )
    held = (stand.time_s > duration_s - REST_S - 1.0) & (stand.time_s < duration_s - REST_S - 0.1)
    known = {"motor.max_thrust_n": float(stand.wrench[held, 2].mean()) / 4}
    return Measured(known, [cfid.motors.maps.fit_thrust(path, gravity_mps2=campaign.rig.site.gravity_mps2)])


def _staircase(
    campaign: Campaign, truth: SimTruth, rng: np.random.Generator, steps: Sequence[int], *, hold_s: float = HOLD_S
) -> Path:
    run = record_staircase(truth, rng, steps=steps, motors=MOTORS, hold_s=hold_s, rest_s=REST_S)
    (path,) = write_runs(campaign, [run])
    return path


def speed(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """Typed readings of a tachometer."""
    (path,) = write_runs(campaign, [speed_run(truth, rng)])
    known = {name: true for name, true in true_motors(truth).items() if name.startswith("motor.speed_poly")}
    return Measured(known, [cfid.motors.maps.fit_speed(path)])


def step_response(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """Steps of one motor, with its speed estimated from vibration: the time constant of each step."""
    run = record_staircase(truth, rng, steps=QUICK_STEPS, motors=(1,), hold_s=1.5, rest_s=1.5, rate_hz=FULL_RATE_HZ)
    (path,) = write_runs(campaign, [run])
    result = cfid.motors.rotor.fit(path)
    rows = [row for row in _rows(result) if row["accepted"] and row["time_constant_s"] is not None]
    rise_s, fall_s = truth.rotors.time_constant_s, truth.rotors.time_constant_s * (1 + truth.rotors.slower_fall)
    taken = {
        f"time constant of {row['cmd_from']:.0f} to {row['cmd_to']:.0f}": replace(
            result.quantities["dynamics.time_constant_s"], value=row["time_constant_s"], std=row["std_s"]
        )
        for row in rows
    }
    known = {name: fall_s if name.endswith(" 0") else rise_s for name in taken}
    return Measured(known, [replace(result, quantities={**result.quantities, **taken})])


def _rows(result: Result) -> list[dict[str, float]]:
    rows = result.quantities["dynamics.time_constant_s"].value
    assert isinstance(rows, list)
    return rows


def transfer_function(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """A series of sines. For a rotor that slows down more slowly, the mean of its two rates in 1/s is true."""
    known = {name: true for name, true in true_motors(truth).items() if name.startswith("tf.")}
    known["tf.time_constant_s"] *= (1 + truth.rotors.slower_fall) / (1 + truth.rotors.slower_fall / 2)
    return Measured(known, [cfid.transfer.fit(write_runs(campaign, sine_runs(truth, rng)))])


def drag(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """Wind runs at six settings, and a reference run."""
    known = {f"drag.simple_kg_per_rad [{axis}]": value for axis, value in enumerate(truth.wind.kg_per_rad)}
    return Measured(known, [cfid.drag.fit(write_runs(campaign, record_chapter_4(truth, rng)))])


def pings(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """Half a minute of pings: the mean round trip, and the rate of the vehicle's clock."""
    return _pings(campaign, truth, ping_run(truth, rng))


def pings_for_long(campaign: Campaign, truth: SimTruth, rng: np.random.Generator) -> Measured:
    """The same for ten minutes."""
    return _pings(campaign, truth, ping_run(truth, rng, count=20 * PINGS))


def _pings(campaign: Campaign, truth: SimTruth, run: SimulatedRun) -> Measured:
    (path,) = write_runs(campaign, [run])
    known = {"latency.rtt_mean_s": 2 * truth.radio.mean_s, "latency.clock_skew": truth.crazyflie.clock_skew}
    return Measured(known, [cfid.latency.fit([path])])
