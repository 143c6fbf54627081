"""Every imperfection of the simulated rig: recordings show its stated size when it is on, and none when it is off."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.records.rig_file import thesis_rig
from cfid.sim.link import Direction
from cfid.sim.loadcell import WARM_UP_S, SimulatedLoadCell
from cfid.sim.plants import DroppingWeight, HandRelease, Pendulum, drop, swing
from cfid.sim.propulsion import Battery, SimulatedRotors
from cfid.sim.swing import Truth, pendulum
from cfid.sim.truth import IMPERFECTIONS, Imperfection, SimTruth, draw, draw_vehicle, imperfection
from tests.offline.encoder import EncoderModel, record, record_swings
from tests.offline.motors import ping_run, shown_rpm
from tests.offline.stand import simulate_stand
from tests.offline.wind import wind_run

Array = npt.NDArray[np.float64]
Seen = Callable[[SimTruth], float]

RIG = thesis_rig()
IDEAL = SimTruth()
SMOOTH = {"unbalance": (0.0,) * 6, "blade_pass": (0.0,) * 6}
OFF = {"radio.jitter_shape": 1.0, "battery.charge": 1.0}


def vehicle(truth: SimTruth, seed: int = 1) -> Truth:
    return draw_vehicle(RIG, truth, rng=np.random.default_rng(seed))


def hanging(truth: SimTruth) -> Pendulum:
    return pendulum(vehicle(truth), "x")


def swung(truth: SimTruth, *, angle_rad: float, coulomb_nm: float) -> tuple[Array, Array]:
    """Return times and angles of a small swing with no friction but Coulomb friction and the truth's disturbances."""
    body = hanging(truth)
    bare = Pendulum(
        axis_inertia_kg_m2=body.axis_inertia_kg_m2,
        gravity_moment_nm=body.gravity_moment_nm,
        coulomb_nm=coulomb_nm,
        spring_nm_per_rad=body.spring_nm_per_rad,
        stribeck_nm=body.stribeck_nm,
        ripple_nm=body.ripple_nm,
    )
    hand = HandRelease(angle_rad=angle_rad, wait_s=0, lift_s=0.2, hold_s=0.3, tremor_rad=0)
    motion = swing([bare], [hand], duration_s=2.0, step_s=2e-3, store_every=1)
    free = motion.time_s > 0.55
    return motion.time_s[free], motion.angle_rad[free, 0]


def seen_eccentricity(truth: SimTruth) -> float:
    time_s = np.linspace(0, 4, 4001)
    angle = math.tau / 4 * time_s
    encoder = EncoderModel(
        word=2**22, stamp_error_s=0.0, poll_jitter_s=0.0, eccentricity_rad=truth.swing.eccentricity_rad
    )
    turn = record(time_s, angle, speed_rad_per_s=np.full_like(angle, math.tau / 4), encoder=encoder,
                  rng=np.random.default_rng(1))  # fmt: skip
    off = np.unwrap(math.tau / 2**22 * turn.counts) - math.tau / 4 * turn.time_s
    return math.degrees(2 * np.mean(off * np.sin(math.tau / 4 * turn.time_s)))


def seen_spring(truth: SimTruth) -> float:
    time_s, angle = swung(truth, angle_rad=0.02, coulomb_nm=0.0)
    before = np.flatnonzero(np.diff(np.sign(angle)) != 0)
    crossings = time_s[before] - angle[before] * 2e-3 / (angle[before + 1] - angle[before])
    body = hanging(truth)
    rate = math.pi / np.diff(crossings).mean()
    return float(body.axis_inertia_kg_m2 * rate**2 - body.gravity_moment_nm)


def seen_dry_friction(truth: SimTruth) -> float:
    """The deflection lost from one reversal to the next is twice the dry torque, divided by the gravity moment."""
    _, angle = swung(truth, angle_rad=0.15, coulomb_nm=2e-5)
    turns = np.abs(angle[1:-1][np.diff(np.sign(np.diff(angle))) != 0])
    return float(-np.diff(turns).mean() / 2 * hanging(truth).gravity_moment_nm - 2e-5)


def seen_stribeck(truth: SimTruth) -> float:
    """The largest deflection from which a released body does not move shows the friction at standstill."""
    body = hanging(truth)
    deflected = np.linspace(1e-5, 1e-4, 91) / body.gravity_moment_nm
    bodies = [
        Pendulum(
            axis_inertia_kg_m2=body.axis_inertia_kg_m2,
            gravity_moment_nm=body.gravity_moment_nm,
            coulomb_nm=2e-5,
            stribeck_nm=body.stribeck_nm,
        )
    ] * len(deflected)
    hands = [HandRelease(angle_rad=a, wait_s=0, lift_s=0.5, hold_s=1.0, tremor_rad=0, let_go_s=1.0) for a in deflected]
    motion = swing(bodies, hands, duration_s=2.6, step_s=2e-3, store_every=1)
    held = np.abs(motion.angle_rad[-1] - deflected) < 0.02 * deflected
    return float(deflected[held].max() * body.gravity_moment_nm - 2e-5)


def seen_tilt(truth: SimTruth) -> float:
    pairs = [(vehicle(truth, seed), vehicle(IDEAL, seed)) for seed in range(60)]
    off = [np.cross(a.mounts[m].direction, b.mounts[m].direction) for a, b in pairs for m in a.mounts]
    return math.degrees(math.sqrt(np.mean(np.square(off)) * 3 / 2))


def seen_fixture(truth: SimTruth) -> float:
    return (hanging(truth).gravity_moment_nm - hanging(IDEAL).gravity_moment_nm) / vehicle(IDEAL).gravity_mps2 / 0.002


def unwound(truth: SimTruth) -> float:
    """The angle at which the line of a fast weight is unwound; from there on the axis slows down."""
    weight = DroppingWeight(
        setup_inertia_kg_m2=1e-6,
        weight_kg=0.05,
        radius_m=2e-3,
        viscous_nms_per_rad=0.0,
        coulomb_nm=1e-5,
        drop_m=0.5,
        line_diameter_m=1e-3 * truth.axis.line_diameter_mm,
        turns_per_layer=truth.axis.turns_per_layer,
    )
    motion = drop([weight], duration_s=0.9, wait_s=0.0)
    return float(motion.angle_rad[np.argmax(motion.speed_rad_per_s[:, 0]), 0])


def seen_line(truth: SimTruth) -> float:
    return 2000 * (0.5 / unwound(truth) - 2e-3)


def seen_layers(truth: SimTruth) -> float:
    """The turns per layer of a line of 0.2 mm, from the number of turns that hold 0.5 m; 0 for a single layer."""
    thick = truth.model_copy(update={"axis": truth.axis.model_copy(update={"line_diameter_mm": 0.2})})
    angle = unwound(thick)
    if math.isclose(angle, 0.5 / 2.1e-3, rel_tol=0.01):
        return 0.0
    lengths = {turns: _holds_m(angle / math.tau, turns) for turns in np.arange(5.0, 39.0, 0.1)}
    return float(min(lengths, key=lambda turns: abs(lengths[turns] - 0.5)))


def _holds_m(turns: float, per_layer: float) -> float:
    length_m, radius_m = 0.0, 2.1e-3
    while turns > 0:
        length_m += math.tau * radius_m * min(turns, per_layer)
        turns, radius_m = turns - per_layer, radius_m + 2e-4
    return length_m


def thrust(truth: SimTruth, commands: list[float], *, hold_s: float, rate_hz: float = 200.0) -> Array:
    """The wrench (holds, n, 6) of motor 1."""
    rotors = SimulatedRotors(truth.rotors.model_copy(update=SMOOTH), np.random.default_rng(3))
    each = np.arange(1, int(hold_s * rate_hz) + 1) / rate_hz
    holds = [(place * hold_s + each, command) for place, command in enumerate(commands)]
    return np.array([rotors.advance(time_s, command * np.eye(4)[0]) for time_s, command in holds])


def seen_scatter(truth: SimTruth) -> float:
    found = thrust(truth, [20000.0, 40000.0] * 200, hold_s=0.8)[:, -1, 2]
    slow, fast = (float(np.std(found[at::2]) / np.mean(found[at::2])) for at in (0, 1))
    return math.hypot(slow, fast) / math.sqrt(2)


def seen_wander(truth: SimTruth) -> float:
    forces = thrust(truth, [40000.0], hold_s=60.0)[0, 200:, 2]
    return float(np.std(np.sqrt(forces)) / np.mean(np.sqrt(forces)))


def seen_slower_fall(truth: SimTruth) -> float:
    falling = np.sqrt(thrust(truth, [40000.0, 0.0], hold_s=1.0, rate_hz=1000)[1, :, 2])
    return float(-1 / (np.log(falling[100] / falling[50]) / 0.05) / truth.rotors.time_constant_s - 1)


def seen_arm(truth: SimTruth) -> float:
    wrench = thrust(truth, [40000.0], hold_s=1.0)[0, -1]
    return float(np.hypot(wrench[3], wrench[4]) / wrench[2] / truth.rotors.arm_m - 1)


def readings(truth: SimTruth) -> Array:
    commands = np.full(4000, 40000.0)
    return shown_rpm(commands, truth, np.random.default_rng(4)) / (2 * (381 + 0.0408 * 40000) * 60 / math.tau)


def shown(truth: SimTruth, wrench: Array, time_s: Array) -> Array:
    """The cell's readings (n, 6) of a wrench (6,), without noise, bias and drift, in N and Nm."""
    still = {"noise_std": (0.0,) * 6, "bias": (0.0,) * 6, "drift_per_s": (0.0,) * 6}
    cell = SimulatedLoadCell(truth.loadcell.model_copy(update=still), np.random.default_rng(5))
    return np.asarray(cell.read(time_s, np.tile(wrench, (len(time_s), 1)))[0] / truth.loadcell.counts_per_unit)


def seen_gain(truth: SimTruth) -> float:
    return float(shown(truth, np.array([1, 1, 1, 0.1, 0.1, 0.1]), np.zeros(1))[0, 2] - 1)


def seen_crosstalk(truth: SimTruth) -> float:
    return float(shown(truth, np.array([0, 0, 6.0, 0, 0, 0]), np.zeros(1))[0, 5] / 0.1)


def seen_warm_up(truth: SimTruth) -> float:
    found = shown(truth, np.array([0, 0, 1.0, 0, 0, 0]), np.array([0.0, WARM_UP_S, 20 * WARM_UP_S]))[:, 2]
    return float((found[1] - found[0]) / (1 - math.exp(-1)))


def seen_bias_wander(truth: SimTruth) -> float:
    found = shown(truth, np.zeros(6), 60.0 * np.arange(4000.0)) / np.array(truth.loadcell.ranges)
    return float(np.sqrt(np.mean(np.square(found))))


def seen_charge(truth: SimTruth) -> float:
    lipo = truth.battery.model_copy(update={"kind": "lipo"})
    unloaded_v = Battery(lipo).volts + lipo.resistance_ohm * lipo.standby_a
    return float(np.interp(unloaded_v, lipo.open_circuit_v, np.linspace(0, 1, len(lipo.open_circuit_v))))


def delays(truth: SimTruth, *, apart_s: float, latency_s: float = 0.0) -> Array:
    update = {"latency_s": latency_s or truth.radio.latency_s, "jitter_s": 1e-4}
    way = Direction(truth.radio.model_copy(update=update), np.random.default_rng(6))
    sent_s = apart_s * np.arange(20000)
    arrived = [way.arrival_s(at_s) for at_s in sent_s]
    return np.asarray(np.array([math.nan if at_s is None else at_s for at_s in arrived]) - sent_s)


def seen_congestion(truth: SimTruth) -> float:
    return float((delays(truth, apart_s=1.0).mean() - truth.radio.latency_s) * 5)


def seen_anemometer(truth: SimTruth) -> float:
    """The gain error, from the forces at equal readings: the force is proportional to the true wind speed."""
    forces = []
    for one in (truth, IDEAL):
        quiet = {"noise_std": (0.0,) * 6, "bias": (0.0,) * 6, "drift_per_s": (0.0,) * 6}
        smooth = one.model_copy(
            update={
                "rotors": one.rotors.model_copy(update=SMOOTH),
                "loadcell": one.loadcell.model_copy(update=quiet),
                "wind": one.wind.model_copy(update={"body_kg_per_m": 0.0}),
            }
        )
        run = wind_run(smooth, 48.4, 8.0, 2.9, np.random.default_rng(7))
        forces.append(float(np.mean(run.devices["loadcell"].values[1][3000:3400])))
    return forces[1] / forces[0] - 1


SEEN: dict[str, Seen] = {
    "swing.eccentricity_deg": seen_eccentricity,
    "swing.spring_nm_per_rad": seen_spring,
    "swing.stribeck_nm": seen_stribeck,
    "swing.ripple_nm": seen_dry_friction,
    "swing.tilt_deg": seen_tilt,
    "vehicle.fixture_kg": seen_fixture,
    "vehicle.centre_of_mass_error_mm": lambda truth: float(
        1000 * (vehicle(truth).centre_of_mass_m - vehicle(IDEAL).centre_of_mass_m)[1]
    ),
    "vehicle.mass_error_kg": lambda truth: vehicle(truth).mass_kg - vehicle(IDEAL).mass_kg,
    "axis.line_diameter_mm": seen_line,
    "axis.turns_per_layer": seen_layers,
    "rotors.thrust_scatter": seen_scatter,
    "rotors.speed_wander": seen_wander,
    "rotors.slower_fall": seen_slower_fall,
    "rotors.arm_error": seen_arm,
    "rotors.tachometer_gain": lambda truth: float(readings(truth).mean() - 1),
    "rotors.tachometer_std": lambda truth: float(readings(truth).std()),
    "loadcell.gain_error": seen_gain,
    "loadcell.crosstalk": seen_crosstalk,
    "loadcell.warm_up": seen_warm_up,
    "loadcell.bias_wander": seen_bias_wander,
    "battery.charge": seen_charge,
    "radio.loss": lambda truth: float(np.isnan(delays(truth, apart_s=0.1)).mean()),
    "radio.jitter_shape": lambda truth: float((1e-4 / delays(truth, apart_s=0.1).std()) ** 2),
    "radio.floor_wander_s": lambda truth: float(delays(truth, apart_s=60.0, latency_s=0.05).std()),
    "radio.congestion_s": seen_congestion,
    "wind.anemometer_gain": seen_anemometer,
}


def off_value(key: str) -> Any:
    section, name = key.split(".")
    return getattr(getattr(IDEAL, section), name)


def switched(one: Imperfection) -> SimTruth:
    """The ideal rig with only this imperfection, each of whose values has the usual size."""
    section, name = one.key.split(".")
    value = np.full(np.shape(off_value(one.key)), one.size).tolist()
    return SimTruth.model_validate({section: {name: value}})


def test_every_imperfection_is_seen_by_a_test() -> None:
    assert set(SEEN) == {one.key for one in IMPERFECTIONS}


@pytest.mark.parametrize("one", IMPERFECTIONS, ids=lambda one: one.key)
def test_an_imperfection_shows_with_its_size_when_it_is_on_and_not_at_all_when_it_is_off(one: Imperfection) -> None:
    off = OFF.get(one.key, 4e-4 if one.key == "rotors.tachometer_std" else 0.0)

    assert SEEN[one.key](switched(one)) == pytest.approx(one.size, rel=0.1)
    assert SEEN[one.key](IDEAL) == pytest.approx(off, abs=0.05 * one.size)


def recorded(truth: SimTruth) -> list[bytes]:
    """A swing, a drop, a step on the load cell, readings and pings."""
    rng = np.random.default_rng(9)
    encoder = EncoderModel(eccentricity_rad=truth.swing.eccentricity_rad)
    swings = record_swings(draw_vehicle(RIG, truth, rng=rng), ["x"], rng=rng, encoder=encoder, duration_s=2.6)
    stand = simulate_stand(
        rotors=truth.rotors,
        loadcell=truth.loadcell,
        battery=truth.battery,
        steps=[(0.2, (30000, 0, 30000, 0)), (0.8, (0, 0, 0, 0))],
        duration_s=1.2,
        rate_hz=1000,
        rng=rng,
    )
    pings = ping_run(truth, rng).devices["pings"].values
    found = [*swings["x"], np.array(unwound(truth)), stand.wrench, stand.volts, readings(truth), *pings]
    return [np.ascontiguousarray(part).tobytes() for part in found]


def test_what_is_switched_off_leaves_recordings_as_they_are_to_the_byte() -> None:
    off: dict[str, dict[str, Any]] = {}
    for one in IMPERFECTIONS:
        section, name = one.key.split(".")
        off.setdefault(section, {})[name] = off_value(one.key)

    ideal, disturbed = recorded(IDEAL), recorded(draw(IDEAL, IMPERFECTIONS, rng=np.random.default_rng(10)))
    assert recorded(SimTruth.model_validate(off)) == ideal
    assert disturbed != ideal


def test_values_are_drawn_from_the_stated_distributions() -> None:
    rng = np.random.default_rng(8)
    arms = [draw(IDEAL, [imperfection("rotors.arm_error")], rng=rng).rotors.arm_error for _ in range(1000)]
    cubes = [draw(IDEAL, [imperfection("vehicle.fixture_kg")], rng=rng).vehicle.fixture_kg for _ in range(1000)]
    loss = draw(IDEAL, [imperfection("radio.loss", size=0.03)], rng=rng).radio.loss
    crosstalk = np.array(draw(IDEAL, [imperfection("loadcell.crosstalk")], rng=rng).loadcell.crosstalk)

    assert np.mean(arms) == pytest.approx(0, abs=1e-3)
    assert np.std(arms) == pytest.approx(0.01, rel=0.1)
    assert (min(cubes), max(cubes)) == pytest.approx((0.6e-3, 1.8e-3), rel=0.02)
    assert loss == 0.03
    assert len(set(crosstalk.ravel())) == 36
