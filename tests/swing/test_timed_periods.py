"""A stopwatch or a light gate gives a natural frequency with its standard uncertainty, and so an axis inertia."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import cfid.inertia
import cfid.swing
from cfid.errors import ConfigError, DataError
from cfid.recordings.periods import PERIODS, PeriodRecord, axis_record, periods_of
from cfid.recordings.read import read_recording
from cfid.records.parameters import Source
from cfid.records.rig_file import load_rig
from cfid.records.run import Label
from cfid.sim.plants import HandRelease, Pendulum, swing
from cfid.swing.body import KnownInertia
from cfid.swing.pendulum import NO_THREADS, Threads
from cfid.swing.periods import period_ratio, timed_frequency
from tests.lab import made_run, new_campaign

Array = npt.NDArray[np.float64]

FREQUENCY = "swing.natural_frequency_squared_s2"
INERTIA = "swing.axis_inertia_kg_m2"
W = 60.0


def record(duration_s: Array, *, periods: float = 10.0, std_s: float | None = None, **more: Any) -> PeriodRecord:
    return PeriodRecord(
        path=Path("periods.csv"),
        source=Source("periods.csv", "0" * 64),
        label=Label(axis="x"),
        periods=np.full(len(duration_s), periods),
        duration_s=duration_s,
        std_s=None if std_s is None else np.full(len(duration_s), std_s),
        **more,
    )


def plant_crossings(release_rad: float) -> tuple[Array, Array]:
    """Return the times at which an integrated pendulum passes its rest to one side, and the amplitudes between."""
    pendulum = Pendulum(axis_inertia_kg_m2=1e-4, gravity_moment_nm=1e-4 * W, viscous_nms_per_rad=2e-6)
    motion = swing([pendulum], [HandRelease(angle_rad=release_rad)], duration_s=40.0, step_s=1e-3, store_every=1)
    time_s, angle = motion.time_s, motion.angle_rad[:, 0]
    up = np.flatnonzero((angle[:-1] < 0) & (angle[1:] >= 0) & (time_s[1:] > 3.0))
    crossings = time_s[up] - angle[up] * (time_s[up + 1] - time_s[up]) / (angle[up + 1] - angle[up])
    amplitudes = [np.ptp(angle[begin:end]) / 2 for begin, end in pairwise(up.tolist())]
    return crossings, np.array(amplitudes)


@pytest.mark.parametrize("release_deg", [5.0, 80.0])
def test_a_plant_s_periods_at_their_amplitudes_give_its_frequency(release_deg: float) -> None:
    crossings, amplitude = plant_crossings(math.radians(release_deg))
    found = timed_frequency(record(np.diff(crossings), periods=1.0, amplitude_rad=amplitude, std_s=1e-4))
    assert found.natural_frequency_squared_s2 == pytest.approx(W, rel=3e-4)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("rows", [3, 12])
def test_intervals_of_a_stopwatch_cover_the_truth(rows: int, stated: bool) -> None:
    random, inside = np.random.default_rng(1), 0
    for _ in range(1000):
        amplitude = np.radians(random.uniform(5, 25, rows))
        exact_s = 10 * 2 * math.pi / math.sqrt(W) * period_ratio(amplitude, NO_THREADS, W)
        timed_s = exact_s + random.normal(0, 0.15, rows)
        found = timed_frequency(record(timed_s, amplitude_rad=amplitude, std_s=0.15 if stated else None))
        inside += abs(found.natural_frequency_squared_s2 - W) < 1.96 * found.std_s2
    assert 930 <= inside <= 970


@pytest.mark.parametrize("amplitude_deg", [0.0, 3.0, 7.0, 9.0])
def test_an_amplitude_that_nobody_states_widens_the_interval(amplitude_deg: float) -> None:
    longer = period_ratio([math.radians(amplitude_deg)], NO_THREADS, W)[0]
    found = timed_frequency(record(np.full(4, 10 * 2 * math.pi / math.sqrt(W) * longer), std_s=1e-4))
    assert abs(found.natural_frequency_squared_s2 - W) < 2 * found.std_s2
    assert [finding.code for finding in found.findings] == ["swing-amplitude-assumed"]


@pytest.mark.parametrize("threads", [NO_THREADS, Threads(0.0, 0.004), Threads(0.2, 0.004)])
def test_the_period_of_a_body_on_threads_is_that_of_its_equation(threads: Threads) -> None:
    """By Runge and Kutta: (1 + W f p^2) phi'' + W f p p' phi'^2 + W p = 0, with p = sin phi / s."""

    def rate(angle: float, speed: float) -> tuple[float, float]:
        s = math.sqrt(1 - 2 * threads.ratio * (1 - math.cos(angle)))
        pull = math.sin(angle) / s
        slope = math.cos(angle) / s + threads.ratio * math.sin(angle) ** 2 / s**3
        carried = 1 + W * threads.fall_s2 * pull**2
        return speed, -(W * pull + W * threads.fall_s2 * pull * slope * speed**2) / carried

    angle, speed, step, time_s = 1.0, 0.0, 1e-4, 0.0
    while angle > 0:
        last, k1 = angle, rate(angle, speed)
        k2 = rate(angle + step / 2 * k1[0], speed + step / 2 * k1[1])
        angle, speed, time_s = angle + step * k2[0], speed + step * k2[1], time_s + step
    quarter_s = time_s - step * angle / (angle - last)
    assert period_ratio([1.0], threads, W)[0] == pytest.approx(4 * quarter_s * math.sqrt(W) / (2 * math.pi), rel=1e-5)


def test_periods_that_scatter_by_more_than_stated_count_by_their_scatter() -> None:
    exact_s = 10 * 2 * math.pi / math.sqrt(W)
    found = timed_frequency(record(exact_s + np.array([0.5, -0.5, 0.4, -0.4]), std_s=0.01))
    assert "swing-periods-scatter" in [finding.code for finding in found.findings]
    assert found.std_s2 > 1.0


def test_two_times_without_a_standard_uncertainty_are_refused() -> None:
    with pytest.raises(DataError):
        timed_frequency(record(np.array([8.1, 8.2])))


def test_tables_of_periods_are_read(tmp_path: Path) -> None:
    one, several = tmp_path / "one.csv", tmp_path / "several.csv"
    one.write_text("period_ms,amplitude_deg\n811,20\n812,18\n810,17\n")
    several.write_text("periods,duration_s,std_s,amplitude_deg,amplitude_std_deg\n10,8.11,0.2,20,1\n20,16.2,0.2,15,1\n")
    assert periods_of(read_recording(one)).duration_s == pytest.approx([0.811, 0.812, 0.81])
    found = periods_of(read_recording(several))
    assert found.periods.tolist() == [10, 20]
    assert found.std_s is not None
    assert found.amplitude_std_rad == pytest.approx(np.radians([1, 1]))


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("periods,std_s\n10,0.2\n", DataError),
        ("period\n0.8\n0.8\n0.8\n", ConfigError),
        ("period_s\n0.8\n-0.8\n0.8\n", DataError),
        ("period_s,amplitude_rad\n0.8,20\n0.8,18\n", DataError),
    ],
)
def test_a_table_that_leaves_periods_open_is_refused(tmp_path: Path, text: str, kind: type[Exception]) -> None:
    (tmp_path / "periods.csv").write_text(text)
    with pytest.raises(kind):
        periods_of(read_recording(tmp_path / "periods.csv"))


def test_a_run_of_periods_gives_the_inertia_of_its_axis_alone_and_among_others(tmp_path: Path) -> None:
    new_campaign(tmp_path)
    rig = load_rig(tmp_path / "rig.toml")
    timed = record(np.array([5.6, 5.62, 5.61]), amplitude_rad=np.radians([15.0, 14.0, 15.0]), std_s=0.02)
    run = made_run(tmp_path, "swing", {PERIODS: timed.columns}, label=Label(axis="x"))

    read = axis_record(run.folder)
    assert isinstance(read, PeriodRecord)
    assert read.duration_s == pytest.approx(timed.duration_s)
    assert read.amplitude_rad == pytest.approx(timed.amplitude_rad)
    result = cfid.swing.fit(run.folder, rig=rig)
    assert set(result.quantities) == {FREQUENCY, INERTIA}
    assert result.quantities[FREQUENCY].value == pytest.approx(
        (2 * math.pi / 0.561) ** 2 * period_ratio([math.radians(14.7)], NO_THREADS, W)[0] ** 2, rel=1e-3
    )
    inertia = result.quantities[INERTIA]
    others = [KnownInertia(axis, 4e-5, 1e-6) for axis in ("y", "z", "xy", "xz", "yz")]
    together = cfid.inertia.fit([run.folder, *others], rig=rig)
    assert together.quantities["inertia.axis_kg_m2.x"].value == pytest.approx(inertia.value, rel=1e-6)


@pytest.mark.parametrize("options", [{"peaks": 5}, {"from_s": 1.0}, {"method": "thesis"}])
def test_an_option_that_periods_do_not_use_is_refused(options: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        cfid.swing.fit(record(np.full(4, 8.1)), **options)  # type: ignore[arg-type]
