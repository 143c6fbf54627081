"""The simulated battery, and the rotors that it feeds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from cfid.sim.propulsion import STILL, Battery, BatteryTruth, Four, Propulsion, RotorTruth, SimulatedRotors

SUPPLY = BatteryTruth()
LIPO = BatteryTruth(kind="lipo")
ROTORS = RotorTruth()
FULL_SPEED: Four = (60000,) * 4


def _propulsion(battery: BatteryTruth = SUPPLY) -> Propulsion:
    return Propulsion(ROTORS, battery, rng=np.random.default_rng(3), begin_s=0.0)


def test_a_full_cell_without_load_shows_what_a_full_cell_shows() -> None:
    assert Battery(LIPO.model_copy(update={"standby_a": 0.0})).volts == 4.2


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


def test_a_cell_of_240_mah_is_empty_after_an_hour_at_240_ma() -> None:
    battery = Battery(LIPO)
    for _ in range(3600):
        battery.load(power_w=0.0, for_s=1.0)
    assert battery.charge == pytest.approx(0.0, abs=1e-9)
    battery.load(power_w=0.0, for_s=1.0)
    assert battery.charge == 0.0


def test_currents_are_near_those_that_bitcraze_measured() -> None:
    """The table of 2015 has 1.83 A at 3.71 V for all four motors at 50 %, and 0.24 A at rest."""
    battery = Battery(LIPO.model_copy(update={"charge": 0.8}))
    power_w = 4 * float(ROTORS.power_w(ROTORS.steady_rad_per_s(np.array(32768.0), volts=3.71)))
    battery.load(power_w=power_w, for_s=0.0)
    current_a = LIPO.standby_a + power_w / LIPO.efficiency / battery.volts
    assert current_a == pytest.approx(1.83, rel=0.3)


def test_a_table_of_a_cell_that_cannot_be_is_told() -> None:
    for wrong in ({"open_circuit_v": (3.0,)}, {"charge": 1.5}, {"efficiency": 0.0}, {"kind": "nuclear"}):
        with pytest.raises(ValidationError):
            BatteryTruth.model_validate(wrong)


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


@settings(max_examples=25)
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


def test_commands_that_no_load_cell_saw_are_caught_up_with() -> None:
    propulsion = _propulsion()
    for place in range(5000):
        command = round(30000 + 20000 * math.cos(place / 10))
        propulsion.command((command,) * 4, place / 500)
    propulsion.wrench_at(np.array([10.0]))
    np.testing.assert_allclose(propulsion._rotors.speed_rad_per_s, propulsion.speed_rad_per_s(10.0), rtol=1e-6)
