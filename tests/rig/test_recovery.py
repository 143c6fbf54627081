"""`cfid motors recover`: a vehicle that crashed is recovered once it is upright, and no motor turns."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from cfid.sim.supervisor import SupervisorState
from tests.flying_in_a_folder import Bench, Pilot, bench_in

pytestmark = pytest.mark.usefixtures("in_time")

VEHICLES = [("app", "cf2"), ("app", "cf21bl"), ("stock", "cf2")]
AFTER = {"cf2": SupervisorState.READY, "cf21bl": SupervisorState.PASSED}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path) as bench:
        yield bench


def state_of(bench: Bench) -> SupervisorState:
    bench.in_loop(lambda: bench.rig.crazyflie.advance(time.monotonic()))
    return bench.rig.crazyflie.vehicle.supervisor.state


def wait_for(bench: Bench, state: SupervisorState) -> None:
    end_s = time.monotonic() + 10.0
    while state_of(bench) is not state:
        assert time.monotonic() < end_s, state_of(bench)
        time.sleep(0.01)


def crash(bench: Bench) -> Pilot:
    """Turn the vehicle upside down while motors run."""
    pilot = bench.start("motors", "set", 30000, "--yes")
    pilot.wait_until_motors_run()
    wait_for(bench, SupervisorState.FLYING)
    bench.vehicle_suffers(tumble_after_s=0)
    wait_for(bench, SupervisorState.CRASHED)
    assert pilot.end() == 3
    return pilot


def recover(bench: Bench) -> Pilot:
    pilot = bench.start("motors", "recover")
    pilot.end()
    return pilot


@pytest.mark.parametrize(("firmware", "platform"), VEHICLES)
def test_a_crashed_vehicle_is_recovered_once_it_is_upright(tmp_path: Path, firmware: str, platform: str) -> None:
    with bench_in(tmp_path, crazyflie={"firmware": firmware, "platform": platform}) as bench:
        crashed = crash(bench)
        lying = recover(bench)
        assert state_of(bench) is SupervisorState.CRASHED
        bench.vehicle_suffers()  # no more: it stands upright
        done = recover(bench)
        wait_for(bench, AFTER[platform])
        assert not any(bench.motors)
        again = bench.start("motors", "set", 20000, "--for", 0.3, "--yes")
        assert again.end() == 0, again.err
    assert "cfid motors recover" in " ".join(crashed.err.split())
    assert lying.process.poll() == 3
    assert done.process.poll() == 0, done.err


def test_a_recovery_turns_no_motor_that_was_left_on(tmp_path: Path) -> None:
    """Stock firmware obeys motorPowerSet also while it is crashed, so that its motors run on."""
    with bench_in(tmp_path, crazyflie={"firmware": "stock"}) as bench:
        pilot = bench.start("motors", "set", 30000, "--yes", anew=True)
        pilot.wait_until_motors_run()
        wait_for(bench, SupervisorState.FLYING)
        pilot.process.kill()
        bench.vehicle_suffers(tumble_after_s=0)
        wait_for(bench, SupervisorState.CRASHED)
        bench.vehicle_suffers()
        assert any(bench.motors)
        assert recover(bench).process.poll() == 0
        wait_for(bench, SupervisorState.READY)
        assert not any(bench.motors)


def test_a_locked_vehicle_is_not_recovered(bench: Bench) -> None:
    bench.vehicle_suffers(emergency_after_s=0)
    wait_for(bench, SupervisorState.LOCKED)
    pilot = recover(bench)
    assert pilot.process.poll() == 3
    assert "turn it off and on" in " ".join(pilot.err.split())
    assert state_of(bench) is SupervisorState.LOCKED


def test_a_vehicle_that_did_not_crash_stays_as_it_is(bench: Bench) -> None:
    wait_for(bench, SupervisorState.READY)
    assert recover(bench).process.poll() == 0
    wait_for(bench, SupervisorState.READY)


def test_a_vehicle_that_another_command_drives_is_left_to_it(bench: Bench) -> None:
    driving = bench.start("motors", "set", 30000, "--for", 20, "--yes")
    driving.wait_until_motors_run()
    pilot = recover(bench)
    assert pilot.process.poll() == 3
    assert any(bench.motors)
    driving.send(2)
    assert driving.end() == 0
