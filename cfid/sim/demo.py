"""Simulates a whole campaign: every experiment of the thesis, and the true value of each parameter."""

from collections.abc import Mapping

import numpy as np

from cfid.quantities.values import ENTRIES
from cfid.records.rig_file import Rig
from cfid.sim.demo_motors import record_chapter_3
from cfid.sim.demo_runs import SimulatedRun
from cfid.sim.demo_swings import record_chapter_2
from cfid.sim.demo_wind import record_chapter_4
from cfid.sim.sine_bench import LATE_RADIO, Bench
from cfid.sim.truth import SimTruth, as_mounted, draw, imperfection
from cfid.wire.app import MIDDLE

DEMO_TRUTH = SimTruth(radio=LATE_RADIO)

# Imperfections of even a good lab: scales off by what rig.toml states, steps that scatter, reports that are lost.
GOOD_LAB = (
    imperfection("loadcell.gain_error", size=0.006),
    imperfection("rotors.arm_error", size=0.2 / 46),
    imperfection("rotors.tachometer_gain", size=0.0003),
    imperfection("rotors.thrust_scatter", size=0.002),
    imperfection("wind.anemometer_gain", size=0.02),
    imperfection("radio.loss", size=0.005),
)


def demo_truth(seed: int) -> SimTruth:
    """Return the true parameters of a demo's rig, with the imperfections of a good lab drawn by its seed."""
    return draw(DEMO_TRUTH, GOOD_LAB, rng=np.random.default_rng([seed, len(GOOD_LAB)]))


def simulate_demo(rig: Rig, truth: SimTruth, *, seed: int) -> tuple[dict[str, float], list[SimulatedRun]]:
    """Record everything; also return the true values, by the names of the parameters' numbers."""
    truth = as_mounted(truth, rig)
    of_swings, of_motors, of_wind = np.random.default_rng(seed).spawn(3)
    runs, testbody = record_chapter_2(rig, truth, of_swings)
    runs += record_chapter_3(truth, of_motors)
    runs += record_chapter_4(truth, of_wind)
    return {**_of_bodies(truth, testbody), **true_motors(truth), **_of_wind(truth)}, runs


def _of_bodies(truth: SimTruth, testbody: Mapping[str, float]) -> dict[str, float]:
    matrix = np.array(truth.vehicle.inertia_kg_m2)
    return {
        **{f"inertia.matrix_kg_m2 {name}": float(matrix[place]) for name, place in ENTRIES.items()},
        "friction.coulomb_nm": truth.axis.coulomb_nm,
        "friction.viscous_nms_per_rad": truth.axis.viscous_nms_per_rad,
        "friction.setup_inertia_kg_m2": truth.axis.setup_inertia_kg_m2,
        **{f"testbody.measured_kg_m2.{axis}": inertia for axis, inertia in testbody.items()},
    }


def true_motors(truth: SimTruth) -> dict[str, float]:
    """Return the true values of chapter 3: speed is linear in the command, thrust quadratic in speed (eq. 3.3, 3.4)."""
    rotors = truth.rotors
    slope, idle, k = rotors.rad_per_s_per_command, rotors.idle_rad_per_s, rotors.thrust_ns2_per_rad2
    radio, bench = truth.radio, Bench(radio=truth.radio)
    return {
        "motor.thrust_poly [0]": k * slope**2,
        "motor.thrust_poly [1]": 2 * k * idle * slope,
        "motor.thrust_poly [2]": k * idle**2,
        "motor.speed_poly [0]": slope,
        "motor.speed_poly [1]": idle,
        "motor.torque_poly [0]": rotors.torque_m,
        "motor.thrust_per_speed_squared_n_s2": k,
        "tf.time_constant_s": rotors.time_constant_s,
        "tf.static_gain_n": 2 * k * slope * (idle + slope * MIDDLE),
        "tf.delay_s": bench.delay_s,
        "latency.rtt_mean_s": 2 * radio.mean_s,
    }


def _of_wind(truth: SimTruth) -> dict[str, float]:
    return {f"drag.simple_kg_per_rad [{axis}]": value for axis, value in enumerate(truth.wind.kg_per_rad)}
