"""Live runs measure the rate of the vehicle's microseconds, 84/85 of real time in releases and 1 after a mend."""

import json
from pathlib import Path
from typing import Any

import pytest

from cfid.sim.propulsion import RotorTruth
from tests.flying_in_a_folder import Bench, bench_in

pytestmark = pytest.mark.usefixtures("in_time")

TRUTH = RotorTruth()
STILL: dict[str, Any] = {
    "rotors": {"unbalance": (0.0,) * 6, "blade_pass": (0.0,) * 6},
    "loadcell": {"noise_std": (0.0,) * 6, "drift_per_s": (0.0,) * 6},
}
BOTH = pytest.mark.parametrize("skew", [-1 / 85, 0.0])


def answered(bench: Bench, *words: object) -> dict[str, Any]:
    pilot = bench.start(*words)
    assert pilot.end() == 0, pilot.err
    content: dict[str, Any] = json.loads(pilot.out)
    return content


@BOTH
def test_pings_give_the_rate_of_either_clock(tmp_path: Path, skew: float) -> None:
    with bench_in(tmp_path, crazyflie={"clock_skew": skew}) as bench:
        answered(bench, "log", "ping", "--count", 100, "--json")
        found = answered(bench, "tf", "latency", "--json", "--no-figures")["parameters"]["latency.clock_skew"]
    assert found["value"] == pytest.approx(skew, abs=1e-3)
    assert found["std"] < 1e-3


@BOTH
def test_sines_give_one_time_constant_by_either_clock(tmp_path: Path, skew: float) -> None:
    with bench_in(tmp_path, crazyflie={"clock_skew": skew}, **STILL) as bench:
        pilot = bench.start("log", "sine", "--l", "8,32", "--n", 2000, "--before", 0.4, "--yes")
        assert pilot.end() == 0, pilot.err
        found = answered(bench, "tf", "identify", "--settle-s", 0.4, "--json", "--no-figures")
    (series,) = found["quality"]["series"].values()
    assert found["parameters"]["tf.time_constant_s"]["value"] == pytest.approx(TRUTH.time_constant_s, rel=0.02)
    assert series["clock_skew"] == pytest.approx([skew], abs=2e-3)


@BOTH
def test_a_swing_by_gyro_is_timed_by_milliseconds_that_are_right_by_either_clock(tmp_path: Path, skew: float) -> None:
    with bench_in(tmp_path, hung_on="x", crazyflie={"clock_skew": skew}) as bench:
        told = answered(bench, "log", "gyro", "--axis", "x", "--for", 5, "--log-ms", 5, "--json")
        shown = answered(bench, "show", "last", "--json", "--no-figures")["parameters"]
    duration = next(value["value"] for key, value in shown.items() if key.endswith("duration_s"))
    assert told["devices"]["crazyflie"]["rows"] == pytest.approx(1000, abs=30)
    assert duration == pytest.approx(5, abs=0.1)
