"""The freely flying plant against other formulas, and its logs against its truth and the readers."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from cfid.flight.data import read_flight
from cfid.recordings.crazyflie import channel
from cfid.sim.flying import LOGGED, STEP_S, VEHICLES, FlightLogs, FlyingVehicle, FreeFlight, fly, scattered
from cfid.sim.pilot import HUBS, SPINS, manoeuvres
from cfid.units import RPM

Array = npt.NDArray[np.float64]

G = 9.81
BRUSHLESS = VEHICLES["brushless_38"]
_RNG = np.random.default_rng(5)
FLEET = [scattered(vehicle, _RNG, gust=0.01) for _ in range(3) for vehicle in VEHICLES.values()]
IN_VACUUM: dict[str, Any] = {
    "thrust_ns2_per_rad2": 1e-30,  # a hover speed is not needed, but looked for
    "thrust_slope": 0.0,
    "torque_m": 0.0,
    "drag_kg_per_rad": (0.0, 0.0, 0.0),
    "flapping_kgm_per_rad": (0.0, 0.0),
}


def seeded(count: int, seed: int = 3) -> list[np.random.Generator]:
    return [np.random.default_rng((seed, flight)) for flight in range(count)]


def tumbling(vehicle: FlyingVehicle, rates: Array, speeds: Array) -> FreeFlight:
    """Return a vehicle that starts with rates and rotor speeds."""
    flight = FreeFlight([vehicle])
    momentum = np.array(vehicle.inertia_kg_m2) @ rates
    momentum[2] += vehicle.rotor_inertia_kg_m2 * (SPINS @ speeds)
    flight.state = flight.state._replace(momentum=momentum[np.newaxis], speeds=speeds[np.newaxis])
    return flight


@pytest.mark.parametrize("name", VEHICLES)
def test_a_body_in_vacuum_tumbles_as_eulers_equations_say_while_its_rotors_speed_up(name: str) -> None:
    vehicle = replace(VEHICLES[name], **IN_VACUUM)
    speeds, steady = np.array([500.0, 900.0, 700.0, 600.0]), np.array([900.0, 500.0, 1000.0, 600.0])
    rates = np.array([3.0, -2.0, 4.0])
    inertia, j_r = np.array(vehicle.inertia_kg_m2), vehicle.rotor_inertia_kg_m2

    def slope(_: float, y: Array) -> Array:
        w, omega = y[:4], y[4:]
        k1, k2 = (np.where(steady > w, up, down) for up, down in zip(vehicle.rising, vehicle.falling, strict=True))
        quicker = k1 * (steady - w) + k2 * (steady**2 - w**2)
        spun = np.array([0.0, 0.0, j_r * SPINS @ w])
        torque = -np.cross(omega, inertia @ omega + spun) - [0, 0, j_r * SPINS @ quicker]
        return np.concatenate([quicker, np.linalg.solve(inertia, torque)])

    flight = tumbling(vehicle, rates, speeds)
    begin = flight.state.momentum.copy()
    for _ in range(1000):
        flight.step(steady[np.newaxis])
    expected = solve_ivp(slope, (0, 1), np.concatenate([speeds, rates]), rtol=1e-10, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(flight.state.speeds[0], expected[:4], rtol=1e-5)
    np.testing.assert_allclose(flight.rates(flight.state)[0], expected[4:], atol=2e-4)
    # Along the world's axes, by what the attitude and the rates say.
    turn, rates = flight.state.attitude[0], flight.rates(flight.state)[0]
    spun = np.array([0.0, 0.0, j_r * SPINS @ flight.state.speeds[0]])
    np.testing.assert_allclose(
        turn @ (inertia @ rates + spun), begin[0], rtol=0, atol=1e-9 * float(np.linalg.norm(begin))
    )
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("name", VEHICLES)
def test_rotors_at_hover_speed_carry_the_weight(name: str) -> None:
    """Gravity acts through the centre of mass, which is off the rotors' middle: what they lift is the weight alone."""
    vehicle = VEHICLES[name]
    flight = FreeFlight([vehicle])
    hover = np.full((1, 4), vehicle.hover_rad_s)
    slopes = flight.slopes(flight.state, hover, 0.0, 0.0)
    assert np.sum(flight.thrust_n(hover)) == pytest.approx(vehicle.mass_kg * G, rel=1e-9)
    np.testing.assert_allclose(slopes.velocity, 0, atol=1e-9)
    np.testing.assert_allclose(slopes.specific[0], [0, 0, G], atol=1e-9)
    x, y, _ = np.mean(vehicle.arm_m * HUBS, axis=0) - vehicle.centre_of_mass_m
    np.testing.assert_allclose(slopes.momentum[0, :2], vehicle.mass_kg * G * np.array([y, -x]), rtol=1e-9)


def test_a_step_of_yaw_is_a_reaction_of_rotors_first_and_their_torque_later() -> None:
    vehicle = replace(BRUSHLESS, centre_of_mass_m=(0.0, 0.0, 0.0), drag_kg_per_rad=(0.0, 0.0, 0.0))
    flight, hover = FreeFlight([vehicle]), vehicle.hover_rad_s
    steady = (hover + 100 * SPINS)[np.newaxis]
    k1, k2 = vehicle.rising
    k3, k4 = vehicle.falling
    sped = 2 * (100 * k1 + k2 * ((hover + 100) ** 2 - hover**2) + 100 * k3 + k4 * (hover**2 - (hover - 100) ** 2))
    j_z = 1 / np.linalg.inv(vehicle.inertia_kg_m2)[2, 2]
    flight.step(steady)
    first = flight.rates(flight.state)[0, 2]
    assert first == pytest.approx(-vehicle.rotor_inertia_kg_m2 * sped * STEP_S / j_z, rel=0.02)
    for _ in range(1000):
        flight.step(steady)
    before = flight.rates(flight.state)[0, 2]
    flight.step(steady)
    thrusts = flight.thrust_n(steady)[0]
    later = -vehicle.torque_m * (SPINS @ thrusts) / j_z
    assert (flight.rates(flight.state)[0, 2] - before) / STEP_S == pytest.approx(later, rel=0.05)
    assert first / STEP_S / later > 0.8  # of 100 rad/s, the reaction is as large as what follows


def test_a_steady_force_goes_for_the_speed_where_drag_balances_it() -> None:
    vehicle = replace(BRUSHLESS, centre_of_mass_m=(0.0, 0.0, 0.0), flapping_kgm_per_rad=(0.0, 0.0))
    flight, speeds = FreeFlight([vehicle]), np.full((1, 4), vehicle.hover_rad_s)
    force_n = np.array([[0.02, -0.01, 0.0]])
    for _ in range(2000):
        flight.step(speeds, force_n)
    damping = np.array(vehicle.drag_kg_per_rad) * np.sum(speeds)
    gone = 1 - np.exp(-damping * 2.0 / vehicle.mass_kg)
    np.testing.assert_allclose(flight.state.velocity[0], force_n[0] / damping * gone, rtol=1e-4, atol=1e-9)
    assert np.all(gone > 0.6)


def test_moments_per_velocity_are_those_at_hover() -> None:
    flight, speeds = FreeFlight([BRUSHLESS]), np.full((1, 4), BRUSHLESS.hover_rad_s)
    at_rest, moving = (
        flight.slopes(flight.state._replace(velocity=np.array([velocity])), speeds, 0.0, 0.0).momentum[0]
        for velocity in ([0.0, 0.0, 0.0], [0.5, 2.0, 0.0])
    )
    roll, pitch = BRUSHLESS.moment_per_velocity_ns
    np.testing.assert_allclose((moving - at_rest)[:2], [2 * roll, 0.5 * pitch], rtol=1e-9)
    assert (roll, pitch) == pytest.approx((6e-4, -8e-4), rel=0.01)


@pytest.fixture(scope="module")
def plans() -> Array:
    kinds = [["tilts"], ["yaw"], ["squares"]]
    return np.stack([manoeuvres(kind, 5.0, np.random.default_rng(2)) for kind in kinds for _ in VEHICLES])


@pytest.fixture(scope="module")
def flown(plans: Array) -> FlightLogs:
    """Flights of tilts, yaw and squares, of three vehicles each, in light gusts."""
    return fly(FLEET, plans, rngs=seeded(9))


def angles_of(columns: dict[str, Array]) -> Array:
    quaternions = np.column_stack([columns[f"stateEstimate.q{part}"] for part in "xyzw"])
    return np.asarray(Rotation.from_quat(quaternions).as_euler("xyz"))


@pytest.mark.parametrize("flight", range(9))
def test_the_controller_follows_its_plan(flown: FlightLogs, plans: Array, flight: int) -> None:
    columns, targets = flown.columns(flight), np.repeat(plans[flight], 5, axis=0)
    commands = np.column_stack([columns[f"motor.m{motor}"] for motor in (1, 2, 3, 4)])
    assert 3000 < commands.min() < commands.max() < 65535
    assert np.all(commands == np.floor(commands))
    known, rows = np.nan_to_num(targets), np.arange(len(targets))
    changes = np.append(True, np.any(known[1:] != known[:-1], axis=1))
    since = rows - np.maximum.accumulate(np.where(changes, rows, 0))
    settled = since * 0.002 > (0.18, 0.18, 0.6)[flight // 3]
    if flight < 3:
        settled &= ~np.isnan(targets[:, 0])
        error = np.degrees(angles_of(columns)[settled, :2] - targets[settled, :2])
        assert np.degrees(np.max(np.abs(targets[settled, :2]))) > 12
        assert np.median(np.abs(error)) < 3
    elif flight < 6:
        settled &= targets[:, 5] != 0
        assert np.median(np.abs(np.radians(columns["gyro.z"][settled]) / targets[settled, 5] - 1)) < 0.3
    else:
        settled &= np.any(targets[:, 2:4] != 0, axis=1)
        error = np.column_stack([columns["stateEstimate.vx"], columns["stateEstimate.vy"]]) - targets[:, 2:4]
        assert np.median(np.abs(error[settled])) < 0.2


def test_the_same_seed_gives_the_same_bytes_whatever_flies_beside(plans: Array) -> None:
    short, vehicles = plans[:3, 100:160], [replace(vehicle, gust_n=0.01) for vehicle in VEHICLES.values()]
    together = fly(vehicles, short, rngs=seeded(3))
    assert fly(vehicles, short, rngs=seeded(3)).rows.tobytes() == together.rows.tobytes()
    np.testing.assert_array_equal(fly(vehicles[:1], short[:1], rngs=seeded(1)).rows[0], together.rows[0])
    assert fly(vehicles, short, rngs=seeded(3, seed=4)).rows.tobytes() != together.rows.tobytes()


def test_telemetry_is_late_in_steps_and_cut_to_what_dshot_sends(plans: Array) -> None:
    """Nothing but the telemetry differs: the controller does not use it."""
    prompt, late, slow = (
        replace(BRUSHLESS, telemetry_delay_s=delay_s, telemetry_s=every_s)
        for delay_s, every_s in ((0.0, 0.001), (0.02, 0.001), (0.0, 0.008))
    )
    speeds = [
        fly([each], plans[:1, 100:180], rngs=seeded(1)).columns(0)["motor.m2_rpm"] for each in (prompt, late, slow)
    ]
    np.testing.assert_array_equal(speeds[1][10:], speeds[0][:-10])
    assert np.count_nonzero(np.diff(speeds[2])) < len(speeds[2]) / 4
    assert np.all(
        np.isin(speeds[2], fly([prompt], plans[:1, 100:180], rngs=seeded(1), rate_hz=1000).columns(0)["motor.m2_rpm"])
    )
    period_us = 60e6 / (6 * speeds[0])
    at = period_us > 512  # ten bits, of which the last is 0
    assert np.any(at)
    assert np.all(np.abs(period_us[at] / 2 - np.round(period_us[at] / 2)) < 0.03)  # after rpm were cut to whole numbers


def test_rotors_follow_the_commands_of_a_log_after_the_delay_alone(plans: Array) -> None:
    vehicle = replace(BRUSHLESS, period_bits=20.0, pulses=0.1, telemetry_s=0.001, telemetry_delay_s=0.0)
    columns = fly([vehicle], plans[:1, 100:180], rngs=seeded(1), rate_hz=1000).columns(0)
    speeds = RPM * columns["motor.m3_rpm"]
    steady = vehicle.idle_rad_s + vehicle.rad_s_per_v * columns["pm.vbat"] * columns["motor.m3"] / 65535

    def missed(late: int) -> float:
        speed, missed = speeds[late], 0.0
        for c, shown in zip(steady, speeds[late + 1 :], strict=False):
            k1, k2 = vehicle.rising if c > speed else vehicle.falling
            middle = speed + STEP_S / 2 * (c - speed) * (k1 + k2 * (c + speed))
            speed += STEP_S * (c - middle) * (k1 + k2 * (c + middle))
            missed += (speed - shown) ** 2
        return float(np.sqrt(missed / len(steady)))

    errors = [missed(late) for late in range(5)]
    assert int(np.argmin(errors)) == round(vehicle.command_delay_s / STEP_S)
    assert errors[2] < 0.4 * min(errors[1], errors[3])


def test_an_accelerometer_off_the_centre_of_mass_feels_rotation(plans: Array) -> None:
    near, far = (
        fly([replace(BRUSHLESS, imu_m=(x, 0.0, 0.0))], plans[3:4, :300], rngs=seeded(1)).columns(0) for x in (0.0, 0.02)
    )
    turning = np.radians(near["gyro.z"]) ** 2 + np.radians(near["gyro.y"]) ** 2
    felt = G * (far["acc.x"] - near["acc.x"])
    assert np.mean(felt) == pytest.approx(-0.02 * np.mean(turning), rel=0.05)
    assert np.mean(turning) > 2


@pytest.mark.parametrize("rate_hz", [500, 100])
def test_a_log_as_a_file_is_a_flight_whose_speeds_carry_its_weight(
    flown: FlightLogs, tmp_path: Path, rate_hz: int
) -> None:
    """With rotor speeds, rows 10 ms apart lack nothing: no lag is sought."""
    every = 500 // rate_hz
    columns = {name: values[::every] for name, values in {"t": flown.time_s, **flown.columns(3)}.items()}
    path = tmp_path / "flight.csv"
    np.savetxt(path, np.column_stack(list(columns.values())), "%.7g", ",", header=",".join(columns), comments="")
    read = read_flight(path)
    assert read.in_air_s > 2.9
    assert {one.code for one in read.findings if one.severity == "rejection"} == set()
    assert {*LOGGED} <= {name for series in read.log.series.values() for name in series.names}
    squares = np.sum([channel(read.log, f"motor.m{motor}_rpm").value ** 2 for motor in (1, 2, 3, 4)], axis=0)
    k = FLEET[3].mass_kg * np.mean(channel(read.log, "acc.z").value) / np.mean(squares)
    truth = FLEET[3].thrust_ns2_per_rad2 + FLEET[3].thrust_slope * FLEET[3].hover_rad_s
    assert k == pytest.approx(truth, rel=0.015)
