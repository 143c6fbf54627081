"""Friction from dropping weights: table 2.1, simulated drops, and speeds that never settle."""

import functools
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import cfid.friction
from cfid.errors import ConfigError, DataError
from cfid.findings import rejected
from cfid.friction.drops import Drop, measure_drop
from cfid.friction.estimation import FrictionEstimate, fit_friction, thesis_friction
from cfid.recordings.angle import AngleRecord, labelled
from cfid.records.rig_file import FrictionRig, thesis_rig
from cfid.records.run import Label
from cfid.sim.plants import DroppingWeight, drop
from tests.lab import Cfid
from tests.recordings.made import made_angle
from tests.swing.swung import written

Array = npt.NDArray[np.float64]

RADIUS_M, GRAVITY = 0.002, 9.81
COULOMB, VISCOUS, SETUP = 3.2e-4, 1.1e-6, 1.5e-7

# Table 2.1: grams, averaged speed in rad/s, printed coefficient in 1e-5 kg m^2/(rad s).
TABLE_2_1 = [
    (20, 51.97, 0.7551), (20, 57.13, 0.6869), (20, 57.41, 0.6835), (20, 58.13, 0.6750), (20, 66.53, 0.5898),
    (30, 232.37, 0.2533), (30, 280.48, 0.2099), (30, 271.58, 0.2167), (30, 291.17, 0.2022), (30, 283.76, 0.2074),
    (40, 498.07, 0.1576), (40, 463.00, 0.1695), (40, 470.78, 0.1667), (40, 513.76, 0.1528),
    (50, 588.37, 0.1667), (50, 562.57, 0.1744), (50, 603.36, 0.1625), (50, 591.74, 0.1658), (50, 608.88, 0.1611),
]  # fmt: skip
MISPRINTED = {9: 0.2021, 17: 0.1626}  # rows whose coefficient does not follow from mass and speed


def measured(time_s: Array, angle: Array, grams: float, **window: float) -> Drop:
    return measure_drop(
        time_s,
        angle,
        weight_kg=grams / 1000,
        radius_m=RADIUS_M,
        gravity_mps2=GRAVITY,
        **window,
    )


def fitted(drops: list[Drop], radius_std_m: float = 0.0, gravity_std_mps2: float = 0.0) -> FrictionEstimate:
    return fit_friction(
        drops,
        radius_m=RADIUS_M,
        radius_std_m=radius_std_m,
        gravity_mps2=GRAVITY,
        gravity_std_mps2=gravity_std_mps2,
    )


@functools.cache
def fallen(
    grams: float, coulomb: float = COULOMB, viscous: float = VISCOUS, ripple: float = 0.0, seconds: float = 6.0
) -> tuple[Array, Array]:
    weight = DroppingWeight(
        setup_inertia_kg_m2=SETUP,
        weight_kg=grams / 1000,
        radius_m=RADIUS_M,
        viscous_nms_per_rad=viscous,
        coulomb_nm=coulomb,
        ripple_nm=ripple,
    )
    motion = drop([weight], duration_s=seconds)
    step = 2 * np.pi / 8192
    return motion.time_s, step * np.floor(motion.angle_rad[:, 0] / step)


def at_speed(speed: float, seconds: float = 3.0) -> tuple[Array, Array]:
    time_s = np.arange(0, seconds, 0.001)
    return time_s, speed * np.maximum(time_s - 0.5, 0)


@pytest.mark.parametrize("row", range(1, 20))
def test_table_2_1s_coefficients_follow_from_its_masses_and_speeds(row: int) -> None:
    grams, speed, printed = TABLE_2_1[row - 1]
    found = measured(*at_speed(speed), grams)

    assert found.settled
    assert found.speed_rad_per_s == pytest.approx(speed, rel=1e-6)
    assert round(1e5 * found.coefficient_nms_per_rad, 4) == MISPRINTED.get(row, printed)


def test_the_mean_of_rows_6_to_19_is_0_1833_where_table_2_2_says_0_1813() -> None:
    drops = [measured(*at_speed(speed), grams) for grams, speed, _ in TABLE_2_1[5:]]

    assert thesis_friction(drops).viscous_nms_per_rad == pytest.approx(0.1833e-5, abs=0.00005e-5)


def test_the_thesis_mean_of_few_runs_has_students_interval() -> None:
    drops = [_settled_at(20, speed) for speed in (90.0, 100.0, 110.0)]
    found = thesis_friction(drops)

    coefficients = [drop.coefficient_nms_per_rad for drop in drops]
    student = 4.303 / 1.96  # two degrees of freedom
    assert found.viscous_std == pytest.approx(student * np.std(coefficients, ddof=1) / np.sqrt(3), rel=1e-3)
    assert thesis_friction(drops[:1]).viscous_std is None


def test_all_weights_of_table_2_1_together_show_a_mostly_dry_friction() -> None:
    drops = [measured(*at_speed(speed), grams) for grams, speed, _ in TABLE_2_1]
    found = fitted(drops)

    grams, speeds, _ = np.array(TABLE_2_1).T
    viscous, coulomb = np.polyfit(speeds, 1e-3 * grams * GRAVITY * RADIUS_M, 1)
    assert found.coulomb_nm == pytest.approx(coulomb, rel=1e-4)
    assert found.viscous_nms_per_rad == pytest.approx(viscous, rel=1e-4)
    assert coulomb > 0.5 * 0.03 * GRAVITY * RADIUS_M


def test_simulated_drops_give_coulomb_viscous_and_set_up_inertia_back() -> None:
    drops = [measured(*fallen(grams), grams) for grams in (30, 40, 50)]
    found = fitted(drops)

    # Without noise, only the encoder's steps scatter the runs, by a hundred-thousandth.
    for value, std, true in (
        (found.coulomb_nm, found.coulomb_std, COULOMB),
        (found.viscous_nms_per_rad, found.viscous_std, VISCOUS),
        (found.setup_inertia_kg_m2, found.setup_inertia_std, SETUP),
    ):
        assert abs((value or 0.0) - true) < 3 * (std or 0.0) < 1e-4 * true


def test_the_weights_own_inertia_is_taken_off_and_the_thesis_keeps_it() -> None:
    drops = [measured(*fallen(grams, coulomb=0.0, viscous=2.0e-6), grams) for grams in (30, 50)]
    ours = fitted(drops)
    theirs = thesis_friction(drops)

    assert ours.setup_inertia_kg_m2 == pytest.approx(SETUP, rel=2e-3)
    assert theirs.setup_inertia_kg_m2 == pytest.approx(SETUP + 0.04 * RADIUS_M**2, rel=0.02)


def test_a_speed_that_changes_within_a_turn_never_settles() -> None:
    found = measured(*fallen(10, coulomb=1.2e-4, viscous=1.5e-5, ripple=6e-5, seconds=12.0), 10)

    assert not found.settled
    for friction in (
        fitted([found]),
        thesis_friction([found]),
    ):
        assert [finding.code for finding in friction.findings] == ["friction-never-settled"]
        assert (friction.viscous_nms_per_rad, friction.setup_inertia_kg_m2) == (None, None)


def test_uncertain_weights_radius_and_gravity_widen_friction() -> None:
    drops = [_settled_at(*each) for each in ((20, 66.0), (30, 244.0), (40, 423.0), (50, 600.0))]
    exact, radius, gravity = fitted(drops), fitted(drops, 0.1 * RADIUS_M), fitted(drops, gravity_std_mps2=0.1 * GRAVITY)
    vague = fitted([replace(drop, weight_std_kg=1e-3) for drop in drops])
    drawn = np.random.default_rng(4).normal(0, 1e-3, (400, 4)) + [drop.weight_kg for drop in drops]
    speeds = [drop.terminal_rad_per_s for drop in drops]
    seen = [np.polyfit(speeds, GRAVITY * RADIUS_M * weights, 1)[0] for weights in drawn]

    viscous, std = exact.viscous_nms_per_rad or 0.0, exact.viscous_std or 0.0
    assert vague.viscous_std == pytest.approx(np.hypot(std, np.std(seen)), rel=0.1)
    assert radius.viscous_std == gravity.viscous_std == pytest.approx(np.hypot(std, 0.1 * viscous))
    assert radius.coulomb_std == pytest.approx(np.hypot(exact.coulomb_std or 0.0, 0.1 * (exact.coulomb_nm or 0.0)))
    assert (radius.setup_inertia_std or 0.0) > 0.1 * (radius.setup_inertia_kg_m2 or 1.0)


def test_friction_that_comes_out_negative_is_set_to_zero_with_a_warning() -> None:
    dry_below, viscous_below = (fitted([_settled_at(20, a), _settled_at(40, b)]) for a, b in ((100, 190), (300, 200)))

    assert (dry_below.coulomb_nm, viscous_below.viscous_nms_per_rad) == (0.0, 0.0)
    assert viscous_below.setup_inertia_kg_m2 is None
    # If a heavier weight turns the axis more slowly, exchanged labels are a more likely cause than friction.
    assert rejected(viscous_below.findings, ()).keys() == {
        "friction.viscous_nms_per_rad",
        "friction.coulomb_nm",
        "friction.setup_inertia_kg_m2",
    }
    assert rejected(dry_below.findings, ()) == {}


def drop_of(grams: float, **more: Any) -> AngleRecord:
    return made_angle(*fallen(grams), name=f"{grams:g}", label=Label(weight_g=grams), **more)


def test_labels_have_the_weights_and_one_without_is_refused() -> None:
    thesis = thesis_rig()
    rig = thesis.model_copy(update={"friction": FrictionRig(radius_mm=1e3 * RADIUS_M, line_mm=0.0, line_std_mm=0.0)})
    records = [drop_of(grams) for grams in (30.0, 40.0, 50.0)]
    result = cfid.friction.fit(records, rig=rig)
    coulomb = result.quantities["friction.coulomb_nm"]

    assert result.accepted
    assert abs(coulomb.value - COULOMB) < 3 * coulomb.std
    assert cfid.friction.fit(records, radius_m=2 * RADIUS_M).quantities["friction.coulomb_nm"].value == pytest.approx(
        2 * coulomb.value, rel=1e-3
    )
    wide = cfid.friction.fit(records, radius_m=10 * RADIUS_M)
    assert {f"friction.{key}" for key in ("coulomb_nm", "viscous_nms_per_rad", "setup_inertia_kg_m2")} <= set(
        wide.rejected
    )
    with pytest.raises(DataError, match="does not state its weight"):
        cfid.friction.fit([labelled(records[0], weight_g=None)], rig=rig)
    with pytest.raises(ConfigError, match="radius_m"):
        cfid.friction.fit(records, radius_m=0.0)
    with pytest.raises(ConfigError, match="radius of the axis is not known"):
        cfid.friction.fit(records, rig=rig.model_copy(update={"friction": None}))


def test_a_drop_that_cannot_be_followed_is_left_out_and_named_and_the_others_are_fitted() -> None:
    records = [drop_of(grams) for grams in (30.0, 40.0, 50.0)]
    jumped = replace(records[1], path=Path("slipped.csv"), angle_rad=np.where(records[1].time_s > 1.0, 3.0, 0.0))
    jumped = replace(jumped, angle_rad=jumped.angle_rad + records[1].angle_rad)
    among = cfid.friction.fit([jumped, records[0], records[2]], radius_m=RADIUS_M)
    alone = cfid.friction.fit([records[0], records[2]], radius_m=RADIUS_M)

    assert among.quantities == alone.quantities
    (left_out,) = (one for one in among.findings if one.code == "friction-drop-left-out")
    assert left_out.where == ("slipped",)
    with pytest.raises(DataError, match=r"slipped.csv: the angle jumps"):
        cfid.friction.fit([jumped, jumped], radius_m=RADIUS_M)


def test_a_file_of_a_drop_that_cannot_be_read_is_left_out_and_alone_refused(cfid: Cfid, tmp_path: Path) -> None:
    for grams in (20, 30, 40):
        time_s, angle = fallen(float(grams))
        angle = np.where(np.arange(len(angle)) % 20 == 0, 7.7, angle) if grams == 20 else angle
        written(tmp_path / f"{grams}.csv", time_s, angle)
    ended = [
        cfid("fit", "friction", *words.split(), "--radius-mm", "2", "--no-figures")
        for words in ("20=20.csv 30=30.csv 40=40.csv", "20=20.csv", "20=none.csv 30=30.csv")
    ]
    assert [one.returncode for one in ended] == [0, 4, 4]
    assert "20.csv:4: the angle jumps" in ended[0].stderr


@pytest.mark.parametrize("turns", [0.3, -0.5])
def test_turns_that_jump_within_the_fall_are_refused_and_before_it_are_not(turns: float) -> None:
    time_s, angle = fallen(30.0)
    clean = measured(time_s, angle, 30.0)
    jumped = angle + 2 * np.pi * turns * (time_s - time_s[0] >= (clean.from_s + clean.to_s) / 2)
    with pytest.raises(DataError, match="turns cannot be counted"):
        measured(time_s, jumped, 30.0)
    before = angle + 2 * np.pi * turns * (np.arange(len(angle)) >= 5)
    assert measured(time_s, before, 30.0).settled


def wrapped_without(time_s: Array, angle: Array, gaps: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
    """Return a record without the samples in some gaps, with the angle unwrapped from readings within a turn."""
    kept = ~np.any([(time_s > begin) & (time_s < end) for begin, end in gaps], axis=0)
    return time_s[kept], np.unwrap(angle[kept] % (2 * np.pi))


def test_turns_are_counted_across_missing_samples_by_the_speed_on_both_sides() -> None:
    time_s, angle = fallen(40.0)
    whole = measured(time_s, angle, 40.0)
    assert whole.speed_rad_per_s > 400  # half a turn takes 8 ms

    gaps = [(whole.from_s - 0.15 + 0.1 * at, whole.from_s - 0.12 + 0.1 * at) for at in range(4)]
    found = measured(*wrapped_without(time_s, angle, gaps), 40.0)

    assert found.terminal_rad_per_s == pytest.approx(whole.terminal_rad_per_s, rel=1e-3)


def test_a_gap_at_the_release_is_refused_and_one_before_it_is_not() -> None:
    time_s, angle = fallen(40.0, seconds=3.0)
    time_s, angle = np.concatenate([time_s - 3.0, time_s[1:]]), np.concatenate([np.zeros(len(angle)), angle[1:]])
    with pytest.raises(DataError, match=r"samples are missing from \d\.\d\d to \d\.\d\d s, within the fall"):
        measured(*wrapped_without(time_s, angle, [(0.45, 0.8)]), 40.0)
    assert measured(*wrapped_without(time_s, angle, [(-1.0, -0.5)]), 40.0).settled


def at_each_count(per_turn: int, speed: float, *, lost: float = 0.0) -> tuple[Array, Array]:
    """Return an encoder's edges, a share of them `lost`; after 1 s at rest, the speed settles with a lag of 0.25 s."""
    settling_s, time_s = 0.25, np.arange(0, 6, 1e-4)
    angle = speed * (time_s + settling_s * np.expm1(-time_s / settling_s))
    counts = 2 * np.pi / per_turn * np.arange(1, int(5.5 * speed * per_turn / (2 * np.pi)))
    counts = counts[np.random.default_rng(3).uniform(size=len(counts)) >= lost]
    return np.append(0.0, 1 + np.interp(counts, angle, time_s)), np.append(0.0, counts)


@pytest.mark.parametrize("lost", [0.0, 0.01])
def test_a_rest_before_the_release_is_no_gap_of_an_encoder_with_a_row_at_each_count(lost: float) -> None:
    found = measured(*at_each_count(100, 27.7, lost=lost), 20.0)

    assert found.terminal_rad_per_s == pytest.approx(27.7, rel=1e-3)


def test_an_angle_that_is_read_at_50_hz_and_repeated_in_rows_at_200_hz_is_taken_once_a_reading(
    cfid: Cfid, tmp_path: Path
) -> None:
    settling_s, time_s, read = 0.25, np.arange(1600) / 200, np.arange(1600) // 4 * 4
    fallen_s = np.maximum(time_s[read] - 1, 0)
    viscous, coulomb, names = 1.2e-5, 6e-5, []
    for grams in (20, 40, 80):
        speed = (grams / 1000 * 9.81 * RADIUS_M - coulomb) / viscous
        angle = speed * (fallen_s + settling_s * np.expm1(-fallen_s / settling_s))
        rows = "".join(f"{t:.4f},{phi:.5f}\n" for t, phi in zip(time_s, angle, strict=True))
        (tmp_path / f"{grams}.csv").write_text(f"t_s,phi_rad\n{rows}")
        names.append(f"{grams}={grams}.csv")
    found = cfid("fit", "friction", *names, "--radius-mm", "2", "--gravity-mps2", "9.81", "--no-figures", "--json")
    result = json.loads(found.stdout)

    assert found.returncode == 0, found.stderr
    assert result["parameters"]["friction.viscous_nms_per_rad"]["value"] == pytest.approx(viscous, rel=2e-3)
    assert result["parameters"]["friction.coulomb_nm"]["value"] == pytest.approx(coulomb, rel=5e-3)
    assert "friction-angle-repeated" in {one["code"] for one in result["findings"]}


def test_a_speed_that_tends_far_beyond_what_was_seen_has_not_settled() -> None:
    time_s = np.arange(0, 13, 0.001)
    found = measured(time_s, 0.5 * 30 * np.maximum(time_s - 0.5, 0) ** 2, 30.0)  # gains 30 rad/s per second forever

    assert found.ripple < 0.03
    assert not found.settled


@pytest.mark.parametrize(
    ("change", "window", "reason"),
    [
        (lambda time_s, angle: (time_s, 0 * angle), {}, "no weight dropped"),
        (lambda time_s, angle: (time_s + 600 * (time_s > 1.0), angle), {}, "Was the clock set"),
        (lambda time_s, angle: (time_s, angle), {"from_s": 50.0}, "no samples in the window"),
        (lambda time_s, angle: (time_s, angle), {"to_s": 0.05}, "stands still"),
    ],
)
def test_a_record_without_a_steady_fall_is_refused(
    change: Callable[[Array, Array], tuple[Array, Array]], window: dict[str, float], reason: str
) -> None:
    time_s, angle = change(*fallen(40.0))
    with pytest.raises(DataError, match=reason):
        measured(time_s, angle, 40.0, **window)


def test_friction_lies_within_its_intervals_19_times_in_20() -> None:
    rng = np.random.default_rng(8)
    speeds = {20: 65.9, 30: 244.3, 40: 422.7, 50: 601.0}  # that VISCOUS and COULOMB lead to
    covered, covered_inertia = [], []
    for _ in range(400):
        drops = []
        for grams, speed in speeds.items():
            for _ in range(2):
                off = speed + rng.normal(0, 0.03 * COULOMB) / VISCOUS
                drops.append(_settled_at(grams, off))
        found = fitted(drops)
        errors = (found.viscous_nms_per_rad or 0.0) - VISCOUS, (found.setup_inertia_kg_m2 or 0.0) - SETUP
        covered.append(abs(errors[0]) < 1.96 * (found.viscous_std or 0.0))
        covered_inertia.append(abs(errors[1]) < 1.96 * (found.setup_inertia_std or 0.0))

    assert 0.93 <= np.mean(covered) <= 0.97
    assert 0.93 <= np.mean(covered_inertia) <= 0.985  # a little wide, since the slope's share is common


def _settled_at(grams: float, speed: float) -> Drop:
    nothing = np.zeros(2)
    return Drop(
        weight_kg=grams / 1000,
        time_s=nothing,
        angle_rad=nothing,
        trace_rad_per_s=nothing,
        from_s=0.0,
        to_s=1.0,
        settled=True,
        speed_rad_per_s=speed,
        speed_std_rad_per_s=0.0,
        ripple=0.0,
        coefficient_nms_per_rad=grams / 1000 * GRAVITY * RADIUS_M / speed,
        terminal_rad_per_s=speed,
        time_constant_s=(SETUP + grams / 1000 * RADIUS_M**2) / VISCOUS,
        model_time_s=nothing,
        model_rad=nothing,
    )
