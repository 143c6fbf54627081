"""From the first command of a campaign to its transfer function, on the simulated rig."""

import json
from pathlib import Path
from typing import Any

import pytest

from cfid.records.campaign import open_campaign
from cfid.sim.propulsion import RotorTruth
from tests.virtual_bench import Bench, bench_in

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


def logged(bench: Bench, *words: object) -> None:
    pilot = bench.start("log", "sine", *words, "--yes")
    assert pilot.end() == 0, pilot.err
    assert not any(bench.motors)


def identified(bench: Bench, *words: object) -> dict[str, Any]:
    pilot = bench.start("tf", "identify", *words, "--json")
    assert pilot.end() == 0, pilot.err
    parameters: dict[str, Any] = json.loads(pilot.out)["parameters"]
    return parameters


def test_sines_that_were_logged_are_identified_and_verified(tmp_path: Path) -> None:
    with bench_in(tmp_path, **STILL) as bench:
        logged(bench, "--hz", "1,2,8", "--for", 4)
        parameters = identified(bench)
        last = list(open_campaign(tmp_path).runs(kind="sine"))[-1].folder.name
        verified = bench.start("tf", "verify", last, "--no-figures")

        assert parameters["tf.time_constant_s"]["value"] == pytest.approx(TRUTH.time_constant_s, rel=0.02)
        assert parameters["tf.static_gain_n"]["value"] == pytest.approx(SLOPE_N, rel=0.01)
        assert parameters["tf.delay_s"]["value"] == pytest.approx(0, abs=5e-3)
        assert verified.end() == 0, verified.err
        assert "verifies nothing" in verified.err


def test_sines_of_all_motors_are_usable_and_identified_by_the_force(tmp_path: Path) -> None:
    with bench_in(tmp_path, **STILL) as bench:
        logged(bench, "--hz", "1,4", "--for", 4, "--motor", 0)
        parameters = identified(bench, "--channel", "Fz")
        verdicts = [run.header.verdict for run in open_campaign(tmp_path).runs(kind="sine")]

        assert [verdict is not None and verdict.usable for verdict in verdicts] == [True, True]
        assert parameters["tf.static_gain_n"]["value"] == pytest.approx(SLOPE_N, rel=0.02)
