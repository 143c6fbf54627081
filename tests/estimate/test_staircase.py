"""Reduced staircases give back the simulated thrust of their rotors, with windows that are found automatically."""

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import DataError, FitError
from cfid.estimate.signals import find_spikes
from cfid.estimate.staircase import Point, Staircase, mean_in_windows, prepared, reduce_single, reduce_staircase
from cfid.motors.maps.data import reduce_thesis
from cfid.sim.loadcell import SATURATED, LoadCellTruth
from cfid.sim.propulsion import BatteryTruth, RotorTruth
from tests.offline.stand import StandRecord, simulate_stand, staircase_steps

Array = npt.NDArray[np.float64]

ROTORS = RotorTruth()  # vibration is 1.5 times the thrust
ALL = tuple(range(0, 64001, 2000))
SOME = tuple(range(4000, 64001, 6000))
FULL_N = 2 * ROTORS.thrust_ns2_per_rad2 * float(ROTORS.steady_rad_per_s(np.array(64000.0), volts=3.7)) ** 2


@cache
def record(
    commands: tuple[int, ...] = SOME,
    *,
    hold_s: float = 3.0,
    rest_s: float = 1.5,
    between_s: float | None = None,
    rate_hz: float = 2000,
    noise_n: float = 0.005,
    spikes_per_s: float = 0.5,
    kind: str = "supply",
    time_constant_s: float = 0.06,
    seed: int = 1,
) -> StandRecord:
    """Return a staircase of two motors on a cell that drifts by 50 uN/s, with spikes.

    Noise of 5 mN at 2 kHz is as dense as noise of 9.4 mN at 7 kHz.
    """
    steps, duration_s = staircase_steps(commands, motors=(1, 3), hold_s=hold_s, rest_s=rest_s, between_s=between_s)
    return simulate_stand(
        rotors=ROTORS.model_copy(update={"time_constant_s": time_constant_s}),
        loadcell=LoadCellTruth(noise_std=(0.01, 0.01, noise_n, 2e-4, 2e-4, 2e-4)),
        battery=BatteryTruth.model_validate({"kind": kind}),
        steps=steps,
        duration_s=duration_s,
        rate_hz=rate_hz,
        rng=np.random.default_rng(seed),
        spikes_per_s=spikes_per_s,
    )


def reduced(found: StandRecord, *, logged: bool = True, **more: Any) -> Staircase:
    log: dict[str, Any] = {"command_time_s": found.command_time_s, "commands": found.commands} if logged else {}
    return reduce_staircase(time_s=found.time_s, channels=found.wrench, status=found.status, **log, **more)


def true_thrust_n(found: StandRecord, point: Point) -> float:
    inside = (found.tick_s >= point.begin_s) & (found.tick_s <= point.end_s)
    return float(np.mean(np.sum(ROTORS.thrust_ns2_per_rad2 * found.speed_rad_per_s[inside] ** 2, axis=1)))


def errors(found: StandRecord, points: Sequence[Point]) -> tuple[Array, Array, Array]:
    """Return true thrusts, errors of the means, and standard uncertainties of the means, in N."""
    truth = np.array([true_thrust_n(found, point) for point in points])
    mean, std = np.array([(point.mean[2], point.std_of_mean[2]) for point in points]).T
    return truth, mean - truth, std


@pytest.mark.parametrize("logged", [True, False])
@pytest.mark.parametrize("pause", ["rests", "none"])
def test_every_point_of_33_commands_is_true_though_the_cell_drifts_and_vibrates(logged: bool, pause: str) -> None:
    # Noise of 2 mN at 2 kHz leaves 50 uN in a window less its tares; 0.3 % of 25 % of the range is 240 uN.
    found = record(ALL, hold_s=4, rest_s=2, between_s=0.0 if pause == "none" else None, noise_n=0.002)
    points = reduced(found, logged=logged).steady()
    truth, error, std = errors(found, points)
    relative = np.abs(error / truth)

    assert len(points) == 32
    assert relative[truth > 0.25 * FULL_N].max() < 0.003
    assert relative[(truth > 0.1 * FULL_N) & (truth < 0.25 * FULL_N)].max() < 0.006
    assert std.max() < 3e-4


@pytest.mark.slow
def test_every_point_of_a_full_staircase_at_7_khz_is_true_with_the_noise_of_a_good_cell() -> None:
    found = record(ALL, hold_s=10, rest_s=5, rate_hz=7000, noise_n=0.005)
    truth, error, _ = errors(found, reduced(found, logged=False).steady())
    relative = np.abs(error / truth)

    assert relative[truth > 0.25 * FULL_N].max() < 0.003
    assert relative[truth > 0.1 * FULL_N].max() < 0.006


@pytest.mark.parametrize("kind", ["supply", "lipo"])
@pytest.mark.parametrize("pause", ["rests", "none"])
def test_with_and_without_the_command_log_the_windows_are_the_same(kind: str, pause: str) -> None:
    found = record(SOME, kind=kind, between_s=0.0 if pause == "none" else None)
    told, seen = (reduced(found, logged=logged).points for logged in (True, False))

    assert len(told) == len(seen) == len(SOME)
    assert [point.begin_s for point in seen] == pytest.approx([point.begin_s for point in told], abs=0.05)
    assert [point.end_s for point in seen] == pytest.approx([point.end_s for point in told], abs=0.05)


def test_tare_drift_and_spikes_are_those_of_the_cell() -> None:
    found = record()
    staircase = reduced(found)
    before, after = staircase.tare_before, staircase.tare_after

    assert after is not None
    assert staircase.drift is not None
    for tare in (before, after):
        assert abs(tare.mean[2] - 1.4 - 5e-5 * tare.time_s) < 3 * tare.std[2]
    assert staircase.drift[2] == pytest.approx(5e-5, rel=0.15)
    assert staircase.spikes == len(found.spikes)
    assert staircase.findings == ()


def covered(seeds: range) -> float:
    inside: list[bool] = []
    for seed in seeds:
        found = record.__wrapped__(SOME, hold_s=2.5, rest_s=1.3, seed=seed)
        _, error, std = errors(found, reduced(found).steady())
        inside += (np.abs(error) < 1.96 * std).tolist()
    return float(np.mean(inside))


@pytest.mark.parametrize(
    ("seeds", "low", "high"),
    [
        (range(1000, 1015), 0.9, 0.99),  # 165 windows: 95 % with 2.6 standard deviations
        pytest.param(range(2000, 2190), 0.93, 0.97, marks=pytest.mark.slow),
    ],
)
def test_the_truth_is_within_95_percent_of_the_intervals_of_windows(seeds: range, low: float, high: float) -> None:
    held = covered(seeds)
    print(f"intervals of means hold the truth: {held:.3f}")

    assert low <= held <= high


def test_a_step_that_never_settles_is_told_and_not_averaged() -> None:
    found = record((20000, 40000), time_constant_s=1.5)
    staircase = reduced(found)

    assert not any(point.settled for point in staircase.points)
    assert all(np.isnan(point.mean).all() and np.isnan(point.std_of_mean).all() for point in staircase.points)
    assert "are left after 5 time constants" in staircase.points[0].reason
    with pytest.raises(FitError, match=r"none of 2 steps settles.*Hold each command longer"):
        staircase.steady()


def test_a_file_with_two_steps_asks_which_is_meant() -> None:
    found = record((20000, 40000))
    channels: dict[str, Any] = {"time_s": found.time_s, "channels": found.wrench}

    with pytest.raises(FitError, match=r"1\.\d+ to 4\.\d+ s, 6\.\d+ to 9\.\d+ s"):
        reduce_single(**channels)
    (point,) = reduce_single(**channels, window=(6.5, 8.5)).points
    assert (point.begin_s, point.end_s) == (6.5, 8.5)
    assert abs(errors(found, [point])[1][0]) < 3 * point.std_of_mean[2]


def test_the_thesis_mean_is_that_of_prepare_data() -> None:
    time_s = 5.0 + np.arange(200) / 10
    channel = np.arange(200.0) ** 2

    found = reduce_thesis(time_s, channel, from_s=10.05, to_s=15.0)
    # MATLAB: t_raw(101) <= 10.05 < t_raw(102), t_raw(151) <= 15 < t_raw(152); bias = mean(Fz_raw(10:60)).
    assert found == pytest.approx(channel[100:151].mean() - channel[9:60].mean())


def spoiled(found: StandRecord, **change: Any) -> dict[str, Any]:
    given = {"time_s": found.time_s, "channels": found.wrench, "status": found.status}
    return {**given, "command_time_s": found.command_time_s, "commands": found.commands, **change}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda given: {name: given[name][:40] for name in ("time_s", "channels", "status")}, "too short: 40 samples"),
        (lambda given: {"time_s": np.roll(given["time_s"], 1000)}, "after sample 1000 the times do not rise"),
        (lambda given: {"time_s": given["time_s"][:-1]}, "should be as many"),
        (lambda given: {"channels": np.where(given["time_s"][:, np.newaxis] == 1, np.nan, given["channels"])}, "no n"),
        (lambda given: {"commands": given["commands"] + [[0, 0, 0, 0], [1, 0, 0, 0], [0] * 4]}, "different commands"),
        (lambda given: {"commands": given["commands"][1:]}, "as many rows of four"),
        (lambda given: {"command_time_s": given["command_time_s"][::-1]}, "do not rise"),
        (lambda given: {"commands": given["commands"] - [[0, 0, 1, 0]]}, "below zero"),
        (lambda given: {"commands": given["commands"] + [[0, 0, np.nan, 0]]}, "no numbers"),
    ],
)
def test_records_that_cannot_be_reduced_are_refused(change: Any, expected: str) -> None:
    given = spoiled(record((20000,)))

    with pytest.raises(DataError, match=expected):
        reduce_staircase(**given | change(given))


def test_a_saturated_cell_is_refused_with_the_time_of_its_first_sample_and_a_mere_warning_is_not() -> None:
    found = record((20000,))
    saturated, warned = (np.where(found.time_s > 3, np.uint32(word), found.status) for word in (SATURATED, 0x80010000))

    with pytest.raises(DataError, match=r"saturated or faulty \(status 0x80020000\), the first after 3 s"):
        reduce_staircase(**spoiled(found, status=saturated))
    assert reduce_staircase(**spoiled(found, status=warned)).points[0].settled


def test_a_record_that_begins_with_running_motors_gives_the_later_steps_by_the_rest_that_follows() -> None:
    found = record((20000, 30000, 40000))
    whole = reduce_staircase(**spoiled(found))
    begin_s = (whole.points[0].begin_s + whole.points[0].end_s) / 2
    late = found.time_s > begin_s
    cut = {"time_s": found.time_s[late], "channels": found.wrench[late], "status": found.status[late]}
    reduced = reduce_staircase(**spoiled(found, **cut))

    assert reduced.begins_driven
    assert [point.settled for point in reduced.points] == [False, True, True]
    assert "under way" in reduced.points[0].reason
    assert "no-baseline-before" in {one.code for one in reduced.findings}
    for one, other in zip(reduced.points[1:], whole.points[1:], strict=True):
        assert np.all(np.abs(one.mean - other.mean) < 4 * np.hypot(one.std_of_mean, other.std_of_mean))


def test_a_record_that_begins_with_running_motors_is_refused() -> None:
    found = record((20000,))
    late = found.time_s > 2
    cut = {"time_s": found.time_s[late], "channels": found.wrench[late], "status": found.status[late]}

    with pytest.raises(DataError, match="no baseline before the first command"):
        reduce_staircase(**spoiled(found, **cut))


def test_motors_that_never_turn_are_told_only_where_they_should() -> None:
    found = record((20000, 40000))
    still = LoadCellTruth().bias + np.random.default_rng(1).normal(0, 0.005, found.wrench.shape)
    dead = np.where(found.commands > 0, 900.0, 0.0)

    said = r"no motor is felt: no thrust is seen at command 40000: \S+ \+- \S+ N\. .*the load cell did not feel them"
    with pytest.raises(DataError, match=said):
        reduce_staircase(**spoiled(found, channels=still))
    assert all(point.settled for point in reduce_staircase(**spoiled(found, channels=still, commands=dead)).points)
    with pytest.raises(DataError, match="never run"):
        reduce_staircase(time_s=found.time_s, channels=still)
    with pytest.raises(DataError, match="never run"):
        reduce_staircase(**spoiled(found, commands=0 * found.commands))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("order", ["C", "F"])
def test_neither_the_sign_of_the_thrust_nor_the_layout_of_the_array_matters_and_it_stays_as_it_was(
    sign: float, order: Any
) -> None:
    found = record(rate_hz=1000)
    given = np.array(sign * found.wrench, order=order)
    kept = given.copy()

    points = reduce_staircase(**spoiled(found, channels=given)).points
    np.testing.assert_array_equal(given, kept)
    np.testing.assert_allclose(
        [sign * point.mean for point in points], [point.mean for point in reduced(found).points], rtol=1e-9, atol=1e-12
    )


def test_spikes_of_a_record_of_hours_are_those_of_the_whole() -> None:
    """A million samples at 100 Hz and more are searched in parts; some spikes lie at the seams between parts."""
    draw = np.random.default_rng(8)
    count, seam = 2_300_000, -(-(1 << 20) // 64) * 64
    value = draw.normal(0, 0.1, count)
    at = np.unique([*draw.integers(3, count - 3, 200), *(seam + np.array([-65, -2, 0, 63]))])
    value[at] += 5
    found = prepared(np.arange(count) / 100, value[:, np.newaxis], status=None, thrust=0)
    _, place, instead = find_spikes(value[np.newaxis], length=64)
    value[place] = instead

    assert found.spikes == len(place)
    assert set(at) <= set(place.tolist())
    np.testing.assert_allclose(found.value[0], value, rtol=0, atol=1e-12)


def test_what_another_instrument_showed_is_averaged_as_much_earlier_as_thrust_came_late() -> None:
    (point,) = reduced(record((30000,))).points
    late = dataclasses.replace(point, begin_s=3.0, end_s=4.0, delay_s=0.5)
    time_s = np.arange(0, 4, 0.25)

    assert mean_in_windows([late], time_s, time_s) == pytest.approx([3.0])  # 2.5 to 3.5 s
    assert mean_in_windows([dataclasses.replace(late, delay_s=None)], time_s, time_s) == pytest.approx([3.375])
    assert np.isnan(mean_in_windows([late], time_s + 10, time_s)).all()
