"""Motors, battery, rotors and wind settle, lag, sag, vibrate and push as their closed forms state."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cfid.sim.propulsion import STILL, Battery, BatteryTruth, Four, Propulsion, RotorTruth, SimulatedRotors, WindTruth

SMOOTH = RotorTruth(unbalance=(0.0,) * 6, blade_pass=(0.0,) * 6)
HZ = 7000
SECOND = np.arange(HZ) / HZ
ONLY_FIRST = np.array([40000.0, 0, 0, 0])
ALL = np.full(4, 40000.0)


def _rotors(truth: RotorTruth = SMOOTH) -> SimulatedRotors:
    return SimulatedRotors(truth, np.random.default_rng(3))


def test_one_motor_lifts_and_tilts_and_twists_as_its_place_and_sense_of_rotation_say() -> None:
    wrench = _rotors().advance(SECOND, ONLY_FIRST)[-1]
    thrust_n = 1.8e-8 * (381.0 + 0.0408 * 40000) ** 2
    arm_m = 0.046 / math.sqrt(2)
    np.testing.assert_allclose(wrench, thrust_n * np.array([0, 0, 1, -arm_m, -arm_m, -0.006]), rtol=1e-6)


def test_speed_has_covered_63_percent_after_the_time_constant() -> None:
    rotors = _rotors()
    rotors.advance(np.array([0.0]), ALL)
    rotors.advance(np.array([0.06]), ALL)
    steady = 381.0 + 0.0408 * 40000
    np.testing.assert_allclose(rotors.speed_rad_per_s, (1 - math.exp(-1)) * steady)


@given(cuts=st.lists(st.integers(1, 999), max_size=6))
def test_the_slicing_into_calls_changes_nothing(cuts: list[int]) -> None:
    time_s = np.arange(1000) / HZ
    whole = _rotors(RotorTruth()).advance(time_s, ALL)
    rotors = _rotors(RotorTruth())
    parts = [rotors.advance(part, ALL) for part in np.split(time_s, sorted(set(cuts)))]
    np.testing.assert_allclose(np.vstack(parts), whole, atol=1e-9)


def test_vibration_stands_at_rotor_and_blade_frequency_alone() -> None:
    rotors = _rotors(RotorTruth())
    rotors.advance(SECOND, ONLY_FIRST)
    spectrum = np.abs(np.fft.rfft(rotors.advance(1 + SECOND, ONLY_FIRST)[:, 2] * np.hanning(HZ)))
    rotor_hz = (381.0 + 0.0408 * 40000) / math.tau
    loudest = np.argsort(spectrum[10:])[::-1][:4] + 10
    for hz in loudest:
        assert min(abs(hz - rotor_hz), abs(hz - 2 * rotor_hz)) < 2
    away = np.ones(len(spectrum), bool)
    for line in (0, rotor_hz, 2 * rotor_hz):
        away[max(0, int(line) - 10) : int(line) + 11] = False
    assert spectrum[away].max() < 1e-3 * spectrum[loudest].max()


# The battery

SUPPLY = BatteryTruth()
LIPO = BatteryTruth(kind="lipo")
ROTORS = RotorTruth()
FULL_SPEED: Four = (60000,) * 4


def _propulsion(battery: BatteryTruth = SUPPLY) -> Propulsion:
    return Propulsion(ROTORS, battery, rng=np.random.default_rng(3), begin_s=0.0)


@given(power_w=st.floats(0, 20), charge=st.floats(0, 1))
def test_a_loaded_cell_gives_the_power_that_is_asked_for(power_w: float, charge: float) -> None:
    truth = LIPO.model_copy(update={"charge": charge})
    battery = Battery(truth)
    battery.load(power_w=power_w, for_s=0.0)
    open_v = float(np.interp(charge, np.linspace(0, 1, 11), truth.open_circuit_v))
    current_a = (open_v - battery.volts) / truth.resistance_ohm
    delivered_w = (current_a - truth.standby_a) * battery.volts * truth.efficiency
    most_w = truth.efficiency * (open_v - truth.resistance_ohm * truth.standby_a) ** 2 / (4 * truth.resistance_ohm)
    assert delivered_w == pytest.approx(min(power_w, most_w), abs=1e-6)


def test_currents_are_near_those_that_bitcraze_measured() -> None:
    """The table of 2015 has 1.83 A at 3.71 V for all four motors at 50 %, and 0.24 A at rest."""
    battery = Battery(LIPO.model_copy(update={"charge": 0.8}))
    power_w = 4 * float(ROTORS.power_w(ROTORS.steady_rad_per_s(np.array(32768.0), volts=3.71)))
    battery.load(power_w=power_w, for_s=0.0)
    current_a = LIPO.standby_a + power_w / LIPO.efficiency / battery.volts
    assert current_a == pytest.approx(1.83, rel=0.3)


# Rotors that the battery feeds


def test_speed_falls_as_the_battery_sags() -> None:
    propulsion = _propulsion(LIPO)
    rested_v = propulsion.battery.volts
    propulsion.command(FULL_SPEED, 0.0)
    propulsion.advance(1.0)
    loaded_v, early = propulsion.battery.volts, propulsion.speed_rad_per_s(1.0)
    propulsion.advance(120.0)
    late_v, late = propulsion.battery.volts, propulsion.speed_rad_per_s(120.0)
    assert rested_v - loaded_v > 0.3
    assert late_v < loaded_v - 0.2
    np.testing.assert_allclose(late, ROTORS.steady_rad_per_s(np.array(60000.0), volts=late_v), rtol=1e-3)
    assert late[0] < early[0] - 100
    propulsion.command(STILL, 121.0)
    propulsion.advance(122.0)
    assert propulsion.battery.volts > late_v + 0.3  # the battery recovers without a load


def test_how_often_the_vehicle_looks_changes_nothing() -> None:
    def after(times_s: list[float]) -> tuple[float, float]:
        propulsion = _propulsion(LIPO)
        propulsion.command(FULL_SPEED, 0.0123)
        for time_s in [*times_s, 5.0]:
            propulsion.advance(time_s)
        return propulsion.battery.volts, propulsion.battery.charge

    assert after([]) == after([k / 1000 for k in range(13, 5000)])


@settings(max_examples=10)
@given(
    commands=st.lists(st.tuples(*[st.integers(0, 65535)] * 4), min_size=1, max_size=5),
    cuts=st.lists(st.integers(1, 699), max_size=5),
)
def test_the_load_cell_feels_each_command_from_its_very_moment_on(commands: list[Four], cuts: list[int]) -> None:
    propulsion, rotors = _propulsion(), SimulatedRotors(ROTORS, np.random.default_rng(3))
    rotors.advance(np.array([0.0]), np.zeros(4))
    time_s = np.arange(700) / 7000
    changes_s = [0.0137 * (place + 1) for place in range(len(commands))]
    for change_s, command in zip(changes_s, commands, strict=True):
        propulsion.command(command, change_s)
    seen = np.vstack([propulsion.wrench_at(part) for part in np.split(time_s, sorted(set(cuts)))])

    fine_s = np.unique(np.concatenate([time_s, changes_s]))
    active = np.zeros(4)
    expected = []
    for moment_s in fine_s:
        row = rotors.advance(np.array([moment_s]), active)
        expected += list(row) if moment_s in time_s else []
        active = np.array(commands[changes_s.index(moment_s)], float) if moment_s in changes_s else active
    np.testing.assert_allclose(seen, expected, atol=1e-9)


# Wind

WIND = WindTruth(speed_mps=3.0, angle_deg=48.4)


def test_wind_from_above_presses_on_turning_rotors_along_z_alone() -> None:
    above = WindTruth(speed_mps=3.0, angle_deg=0.0)
    assert above.drag_ns_per_rad == pytest.approx([0, 0, 3 * -10.311e-7])


def test_what_the_load_cell_feels_is_turned_into_its_own_frame() -> None:
    across, azimuth = 3 * math.sin(math.radians(48.4)), math.radians(28.46)
    x, y = -9.1785e-7 * across * np.array([math.cos(azimuth), -math.sin(azimuth)])
    cos = math.cos(math.pi / 4)

    assert WIND.drag_ns_per_rad[:2] == pytest.approx([cos * (x + y), cos * (y - x)])
    assert WindTruth(speed_mps=3.0, angle_deg=48.4, yaw_deg=0.0).drag_ns_per_rad[:2] == pytest.approx([x, y])


def test_the_bodys_drag_grows_with_the_square_of_the_wind() -> None:
    twice = WIND.model_copy(update={"speed_mps": 6.0})
    assert twice.body_n == pytest.approx(4 * WIND.body_n)


def test_rotors_feel_the_wind_by_the_sum_of_their_speeds_and_only_while_they_turn() -> None:
    calm, windy = (
        SimulatedRotors(RotorTruth(), np.random.default_rng(3), drag_ns_per_rad=drag)
        for drag in ((0, 0, 0), WIND.drag_ns_per_rad)
    )
    time_s, commands = np.linspace(0, 2, 500), np.array([20000.0, 0, 40000, 0])
    for standing in (True, False):
        more = [rotors.advance(time_s + 3 * (not standing), commands * (not standing)) for rotors in (calm, windy)]
        felt = (more[1] - more[0])[-1]
        assert felt == pytest.approx(np.append(calm.speed_rad_per_s.sum() * WIND.drag_ns_per_rad, np.zeros(3)))
