"""The true values of the demo's rig: its parameters, with the imperfections of a good lab drawn by a seed."""

import numpy as np

from cfid.quantities.values import ENTRIES
from cfid.records.rig_file import Rig
from cfid.sim.devices import drawn_testbody
from cfid.sim.link import RadioTruth
from cfid.sim.truth import SimTruth, as_mounted, draw, draw_vehicle, imperfection
from cfid.wire.app import MIDDLE

# Half of the thesis' 57 ms (table 3.2). Its standard deviation, 16 ms, is that of a radio that passes few packets: a
# link in order that also carries rows of the log would delay all of them, and nobody could state its mean.
DEMO_TRUTH = SimTruth(radio=RadioTruth(latency_s=0.028, jitter_s=0.002))

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
    """Return the true parameters of a demo's rig."""
    return draw(DEMO_TRUTH, GOOD_LAB, rng=np.random.default_rng([seed, len(GOOD_LAB)]))


def true_values(truth: SimTruth, rig: Rig, *, seed: int) -> dict[str, float]:
    """Return the true values of a simulated rig, by the names of the parameters' numbers."""
    truth = as_mounted(truth, rig)
    vehicle = draw_vehicle(rig, truth, rng=np.random.default_rng(seed).spawn(1)[0])
    body = drawn_testbody(rig, truth, vehicle, seed=seed)
    return {
        **true_matrix(truth),
        "friction.coulomb_nm": truth.axis.coulomb_nm,
        "friction.viscous_nms_per_rad": truth.axis.viscous_nms_per_rad,
        "friction.setup_inertia_kg_m2": truth.axis.setup_inertia_kg_m2,
        **{
            f"testbody.measured_kg_m2.{axis}": float(mount.direction @ body.inertia_kg_m2 @ mount.direction)
            for axis, mount in body.mounts.items()
        },
        **true_motors(truth),
        **{f"drag.simple_kg_per_rad [{axis}]": value for axis, value in enumerate(truth.wind.kg_per_rad)},
    }


def true_matrix(truth: SimTruth) -> dict[str, float]:
    """Return the true entries of the inertia matrix."""
    matrix = np.array(truth.vehicle.inertia_kg_m2)
    return {f"inertia.matrix_kg_m2 {name}": float(matrix[place]) for name, place in ENTRIES.items()}


def true_motors(truth: SimTruth) -> dict[str, float]:
    """Return the true values of chapter 3: speed is linear in the command, thrust quadratic in speed (eq. 3.3, 3.4).

    The load cell's samples are stamped when they are taken, and the reports of commands come by radio.
    """
    rotors = truth.rotors
    slope, idle, k = rotors.rad_per_s_per_command, rotors.idle_rad_per_s, rotors.thrust_ns2_per_rad2
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
        "tf.delay_s": -truth.radio.mean_s,
        "latency.rtt_mean_s": 2 * truth.radio.mean_s,
    }
