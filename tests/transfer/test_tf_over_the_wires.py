"""From the first command of a campaign to its transfer function, on the simulated rig over real wires."""

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from cfid.records.files import RUNS_FOLDER
from cfid.sim.propulsion import RotorTruth
from tests.flying_in_a_folder import Bench, bench_in

pytestmark = pytest.mark.usefixtures("in_time")

TRUTH = RotorTruth()
SLOPE_N = (
    2
    * TRUTH.thrust_ns2_per_rad2
    * (TRUTH.idle_rad_per_s + 30000 * TRUTH.rad_per_s_per_command)
    * TRUTH.rad_per_s_per_command
)
STILL: dict[str, Any] = {
    "rotors": {"unbalance": (0.0,) * 6, "blade_pass": (0.0,) * 6},
    "loadcell": {"noise_std": (0.0,) * 6, "drift_per_s": (0.0,) * 6},
}
LATE = {"latency_s": 0.028, "jitter_s": 0.016}  # table 3.2: half of a round trip, and its standard deviation
IDENTIFY = ("tf", "identify")


def logged(bench: Bench, *words: object, longest_s: float) -> None:
    """Log sines, and resume if a computer too busy to keep the motors alive lets them stop, as an operator would."""
    for more in ((), ("--resume",), ("--resume",)):
        pilot = bench.start("log", "sine", *words, "--yes", *more)
        if pilot.process.wait(longest_s) == 0:
            break
    assert pilot.process.returncode == 0, pilot.err


def identified(bench: Bench, *words: object) -> dict[str, Any]:
    pilot = bench.start(*IDENTIFY, *words, "--json")
    assert pilot.end() == 0, pilot.err
    content: dict[str, Any] = json.loads(pilot.out)
    return content


def test_sines_that_were_logged_are_identified_and_verified(tmp_path: Path) -> None:
    with bench_in(tmp_path, **STILL) as bench:
        logged(bench, "--l", "4,8,32", "--n", 2000, "--before", 0.4, longest_s=60)
        content = identified(bench, "--settle-s", 0.4)
        parameters = content["parameters"]
        last = max((tmp_path / RUNS_FOLDER).iterdir()).name
        verified = bench.start("tf", "verify", last, "--settle-s", 0.4, "--no-figures")

        assert parameters["tf.time_constant_s"]["value"] == pytest.approx(TRUTH.time_constant_s, rel=0.02)
        assert parameters["tf.static_gain_n"]["value"] == pytest.approx(SLOPE_N, rel=0.01)
        assert parameters["tf.delay_s"]["value"] == pytest.approx(0, abs=5e-3)
        assert verified.end() == 0, verified.err
        assert "this verifies nothing" in verified.err


def test_sines_of_all_motors_are_usable_and_identified_by_the_force(tmp_path: Path) -> None:
    with bench_in(tmp_path, **STILL) as bench:
        logged(bench, "--l", "4,16", "--n", 2000, "--motor", 0, "--before", 0.4, longest_s=60)
        runs = [tomllib.loads((run / "run.toml").read_text()) for run in (tmp_path / RUNS_FOLDER).iterdir()]
        parameters = identified(bench, "--channel", "Fz", "--settle-s", 0.4)["parameters"]

        assert [run["verdict"]["usable"] for run in runs] == [True, True]
        assert parameters["tf.static_gain_n"]["value"] == pytest.approx(SLOPE_N, rel=0.02)


@pytest.mark.slow
def test_ten_sines_beside_shaking_rotors_give_one_percent(tmp_path: Path) -> None:
    with bench_in(tmp_path, radio=LATE) as bench:
        logged(bench, "--l", "1,2,4,8,12,20,32,50,80,100", "--rate-hz", 7000, longest_s=300)
        content = identified(bench)
        parameters = content["parameters"]
        delay_s = parameters["tf.delay_s"]["value"]
        gain, lag = parameters["tf.static_gain_n"], parameters["tf.time_constant_s"]

        print(
            f"over the wires: gain {gain['value'] / SLOPE_N - 1:+.2%} +- {gain['std'] / SLOPE_N:.2%}, time constant "
            f"{lag['value'] / TRUTH.time_constant_s - 1:+.2%} +- {lag['std'] / TRUTH.time_constant_s:.2%}, delay "
            f"{1e3 * delay_s:.1f} ms; as the thesis {content['quality']['thesis']}"
        )
        assert lag["value"] == pytest.approx(TRUTH.time_constant_s, rel=0.01)
        assert gain["value"] == pytest.approx(SLOPE_N, rel=0.005)
        assert -0.06 < delay_s < -LATE["latency_s"]  # reports queue behind rows of the vehicle's log
