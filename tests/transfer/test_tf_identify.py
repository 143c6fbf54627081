"""`cfid tf identify` turns runs and files of sines into transfer functions with a verdict."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from cfid.records.files import RIG_FILE
from cfid.records.parameters import Parameter, Section
from cfid.records.rig_file import LoadCellMount, RigFacts, new_rig_text
from tests.lab import keep, sections_at, sentences
from tests.offline.sine_bench import Bench, SimulatedSine
from tests.transfer.sines_in_a_folder import (
    GAIN_N,
    LAG_S,
    PERIODS,
    TRUTH,
    USUAL,
    Here,
    sines,
    write_index,
    write_run,
)

MODEL = ("numerator", "denominator", "static_gain_n", "time_constant_s", "delay_s", "delay_after_quickest_s")


def found(tf: Here, *words: object, code: int = 0) -> dict[str, Any]:
    return tf.json("identify", *words, code=code)


@pytest.fixture(scope="module")
def first() -> list[SimulatedSine]:
    return sines(samples=4000, bench=USUAL)


@pytest.fixture(scope="module")
def second() -> list[SimulatedSine]:
    return sines(periods=PERIODS[1:], samples=4000, seed=1, bench=replace(USUAL, motor=3, loadcell_latency_s=0.010))


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory, first: list[SimulatedSine], second: list[SimulatedSine]) -> Path:
    return write_index(tmp_path_factory.mktemp("both"), {"first": first, "second": second})


def test_an_index_of_two_series_gives_one_function_and_one_for_each(tf: Here, both: Path) -> None:
    content = found(tf, "--index", both)
    parameters, quality = content["parameters"], content["quality"]

    assert content["command"] == "tf identify"
    assert parameters["tf.time_constant_s"]["value"] == pytest.approx(LAG_S, rel=0.01)
    assert parameters["tf.static_gain_n"]["value"] == pytest.approx(GAIN_N, rel=0.005)
    pole = np.exp(-parameters["tf.sample_time_s"]["value"] / parameters["tf.time_constant_s"]["value"])
    assert parameters["tf.denominator"]["value"] == pytest.approx([1, -pole])
    assert parameters["tf.denominator"]["std"][0] == 0
    gain = parameters["tf.static_gain_n"]["value"]
    assert parameters["tf.numerator"]["value"] == pytest.approx([0, gain * (1 - pole)])
    for name, delay_s in (("first", -0.0274), ("second", -0.018)):
        own = {key: parameters[f"tf.series.{name}.{key}"] for key in ("time_constant_s", "static_gain_n", "delay_s")}
        assert own["time_constant_s"]["value"] == pytest.approx(LAG_S, rel=0.02)
        assert own["static_gain_n"]["value"] == pytest.approx(GAIN_N, rel=0.01)
        assert own["delay_s"]["value"] == pytest.approx(delay_s, abs=3 * own["delay_s"]["std"])
        assert len(parameters[f"tf.series.{name}.numerator"]["value"]) == 2
    assert content["accepted"]
    assert quality["degrees_of_freedom"] == 2 * quality["frequencies"] - 4
    assert quality["corrected_aic"]["first+delay"] < 5
    assert quality["corrected_aic"]["first"] > 100
    assert {Path(source["path"]).name for source in content["sources"]} >= {"index.csv", "cellfirst_0.csv"}


def test_the_sign_that_is_given_is_kept_and_a_gain_below_zero_is_reported(
    tf: Here, tmp_path: Path, first: list[SimulatedSine]
) -> None:
    index = write_index(tmp_path, {"": first})
    down, up = (found(tf, "--index", index, "--channel", "Ty", "--sign", sign) for sign in ("+", "-"))

    assert down["parameters"]["tf.static_gain_n"]["value"] == pytest.approx(-GAIN_N, rel=0.01)
    assert up["parameters"]["tf.static_gain_n"]["value"] == pytest.approx(GAIN_N, rel=0.01)
    assert any("the static gain is negative" in text for text in sentences(down))
    assert not any("negative" in text for text in sentences(up))


def test_runs_of_cfid_are_found_by_no_word_at_all_and_kept_in_the_campaign(
    tf: Here, tmp_path: Path, first: list[SimulatedSine]
) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    for run in first[1:]:
        write_run(tmp_path, run, series="bench")
    said = tf("identify", "--no-figures")
    section = sections_at(tmp_path)["tf"]

    assert said.returncode == 0, said.stderr
    assert "takes 9 complete sines" in said.stderr
    assert section.parameters["tf.time_constant_s"].value == pytest.approx(LAG_S, rel=0.01)
    assert section.parameters["tf.static_gain_n"].value == pytest.approx(GAIN_N, rel=0.005)
    assert section.accepted
    assert len(section.sources) == 18


def test_a_run_keeps_the_yaw_and_arm_it_was_recorded_with_whatever_rig_toml_says_later(
    tf: Here, tmp_path: Path
) -> None:
    cell = USUAL.loadcell.model_copy(update={"yaw_deg": 30.0})
    facts = RigFacts(loadcell=LoadCellMount(yaw_deg=30.0, arm_mm=23.0))
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    for run in sines(bench=replace(USUAL, loadcell=cell))[1:]:
        write_run(tmp_path, run, facts=facts)
    content = found(tf)
    overridden = found(tf, "--arm-mm", 46)
    uncertain = found(tf, "--arm-mm", "46:2.3")["parameters"]["tf.static_gain_n"]

    assert content["parameters"]["tf.static_gain_n"]["value"] == pytest.approx(2 * GAIN_N, rel=0.01)
    assert overridden["parameters"]["tf.static_gain_n"]["value"] == pytest.approx(GAIN_N, rel=0.01)
    assert uncertain["std"] == pytest.approx(0.05 * uncertain["value"], rel=0.05)
    assert not any("assumed" in warning for warning in sentences(content))


@pytest.mark.parametrize(
    ("stated", "given", "channel", "lacks"),
    [
        (LoadCellMount(arm_mm=46.0), (), "arm", "--yaw-deg"),
        (LoadCellMount(), (), "Ty", "--arm-mm"),
        (LoadCellMount(), ("--arm-mm", 46, "--yaw-deg", -45), "arm", None),
        (LoadCellMount(), (), "Fz", None),
    ],
)
def test_a_mount_that_was_not_stated_is_asked_for_where_the_channel_needs_it(
    tf: Here,
    tmp_path: Path,
    first: list[SimulatedSine],
    stated: LoadCellMount,
    given: tuple[object, ...],
    channel: str,
    lacks: str | None,
) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    for run in first[1:]:
        write_run(tmp_path, run, facts=RigFacts(loadcell=stated))
    ended = tf("identify", "--channel", channel, *given, "--json")

    if lacks:
        assert (ended.returncode, lacks in ended.stderr) == (2, True)
    else:
        gain = json.loads(ended.stdout)["parameters"]["tf.static_gain_n"]["value"]
        assert gain == pytest.approx(GAIN_N, rel=0.01)


def test_the_static_gain_is_checked_against_the_thrust_map(
    tf: Here, tmp_path: Path, first: list[SimulatedSine]
) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    index = write_index(tmp_path, {"": first})
    for slope, warned in ((GAIN_N, False), (1.3 * GAIN_N, True)):
        poly = Parameter(value=[slope / 120000, slope / 2, 0.0], std=[0.0, 0.0, 0.0], unit="N(cmd)")
        keep(
            tmp_path,
            "thrust",
            Section(
                method="default",
                found=pd.Timestamp("2026-11-21", tz="UTC").to_pydatetime(),
                cfid_version="0",
                accepted=True,
                sources=(),
                parameters={"motor.thrust_poly": poly},
            ),
        )
        content = found(tf, "--index", index)
        assert content["quality"]["thrust_map_slope_n"] == pytest.approx(slope)
        assert content["quality"]["static_gain_off_slope"] == pytest.approx(GAIN_N / slope - 1, abs=0.01)
        assert any("off the thrust map's slope" in warning for warning in sentences(content)) == warned


def test_what_no_such_plant_explains_is_rejected_and_exits_with_5(tf: Here, both: Path) -> None:
    content = found(tf, "--index", both, "--shape", "first", code=5)
    forced = found(tf, "--index", both, "--shape", "first", "--force")
    said = tf("identify", "--index", str(both), "--shape", "first", "--no-figures", "--verbose")

    assert set(content["parameters"]) == {
        "tf.sample_time_s",
        "tf.frequency_response",
        *(f"tf.series.second.{name}" for name in MODEL),  # this series is described within 3 %
    }
    assert not content["accepted"]
    assert "tf.time_constant_s" in forced["parameters"]
    assert "static_gain_n" in forced["quality"]["thesis"]
    assert content["quality"]["thesis"] == {}
    assert said.returncode == 5
    assert said.stderr.splitlines()[-1].startswith("cfid: rejected: chi-squared is ")
    assert "'first+delay' describes the responses clearly better than 'first'" in said.stderr


def test_series_of_two_motors_that_differ_keep_their_own_functions(
    tf: Here, tmp_path: Path, first: list[SimulatedSine]
) -> None:
    slower = replace(TRUTH, time_constant_s=1.5 * LAG_S)
    other = sines(PERIODS[1:], truth=slower, samples=4000, seed=2, bench=Bench(rate_hz=500, motor=3))
    index = write_index(tmp_path, {"first": first, "second": other})
    content = found(tf, "--index", index, code=5)

    assert [one["code"] for one in content["findings"] if one["severity"] == "rejection"] == [
        "transfer-misfit",
        "series-differ",
    ]
    assert not any(f"tf.{name}" in content["parameters"] for name in MODEL)
    lag = content["parameters"]["tf.series.second.time_constant_s"]["value"]
    assert lag == pytest.approx(1.5 * LAG_S, rel=0.02)
