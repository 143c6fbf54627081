"""Sine runs on one time base: the commands over time, the thrust from the load cell, and refused runs."""

from dataclasses import replace

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.sim.app_core import PING, SINE
from cfid.sim.loadcell import LoadCellTruth
from cfid.sim.propulsion import RotorTruth
from cfid.transfer.alignment import RecordedSine, Reports, align, match_reports
from cfid.transfer.data import thrust_of
from cfid.transfer.plan import SAMPLE_S, Sine
from cfid.wire import app
from tests.firmware.stand import MAY_RUN, new_core
from tests.offline.sine_bench import ARM_M, Bench, simulate_sines
from tests.transfer.sine_recordings import USUAL, log_spaced, recorded, simulated

LEAST_LATENCY_S = 0.012


def played_on_board(periods: int, samples: int, amplitude: int) -> tuple[list[int], list[app.Crossing]]:
    """Play a sine with the core of cfid's app; return the commands of motor 1, and the app's reports."""
    core, commands, reports = new_core(), [], []
    core.receive(PING, app.PingChannel.ALIVE, app.encode_alive(0), now_us=0, vehicle=MAY_RUN)
    request = app.SineRequest(1, amplitude, app.omega_of(periods, samples), samples)
    core.receive(SINE, app.SineChannel.START, app.encode_sine(request), now_us=0, vehicle=MAY_RUN)
    for tick in range(1, 2 * samples + 3):
        core.receive(PING, app.PingChannel.ALIVE, app.encode_alive(tick), now_us=1000 * tick, vehicle=MAY_RUN)
        driven = core.tick(now_us=1000 * tick, vehicle=MAY_RUN).held
        commands.append(driven[0] if driven else -1)
        for service, channel, payload in core.sent():
            if (service, channel) == (SINE, app.SineChannel.CROSSING):
                reports.append(app.decode_crossing(payload))
    return commands[0 : 2 * samples : 2], [report for report in reports if report is not None]


@pytest.mark.parametrize(("periods", "samples", "amplitude"), [(12, 400, 20000), (40, 400, 20000), (7, 300, 35000)])
def test_the_input_is_reconstructed_as_the_app_plays_it(periods: int, samples: int, amplitude: int) -> None:
    sine = Sine(periods=periods, samples=samples, amplitude=amplitude)
    commands, reports = played_on_board(periods, samples, amplitude)
    stamped = Reports(
        np.array([1e-6 * (report.microseconds or 0) for report in reports]),
        np.array([float(report.command) for report in reports]),
        np.array([float(report.sample or 0) for report in reports]),
        np.array([float(report.microseconds or 0) for report in reports]),
    )

    assert sine.commands().tolist() == commands
    by_sample = match_reports(sine, stamped)
    by_order = match_reports(sine, stamped._replace(sample=None, vehicle_us=None))
    assert by_sample.sample[:-1].tolist() == by_order.sample.tolist()


@pytest.mark.parametrize("motor", [1, 2, 3, 4])
@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 45.0, -110.0])
def test_the_arm_finds_a_motors_thrust_whatever_the_yaw_and_not_with_another(motor: int, yaw_deg: float) -> None:
    cell = LoadCellTruth(noise_std=(0.0,) * 6, drift_per_s=(0.0,) * 6, yaw_deg=yaw_deg)
    rotors = RotorTruth(unbalance=(0.0,) * 6, blade_pass=(0.0,) * 6)
    bench = Bench(motor=motor, loadcell=cell)
    run = simulate_sines(rotors, periods=[4], samples=500, rng=np.random.default_rng(1), bench=bench)[0]
    wrench = (run.counts - run.counts[:500].mean(axis=0))[1300:2000] / 1e6
    force, torque = wrench[:, :3], wrench[:, 3:]
    right, wrong = (
        thrust_of("arm", force, torque, arm_m=ARM_M, motor=motor, yaw_deg=yaw).mean() for yaw in (yaw_deg, yaw_deg + 60)
    )

    assert right == pytest.approx(force[:, 2].mean(), rel=1e-4)
    assert wrong == pytest.approx(0.5 * right, rel=1e-3)


def test_on_board_stamps_tell_the_start_to_a_tenth_of_a_millisecond_and_the_loop_as_fast_as_it_is() -> None:
    bench = Bench(loop_error=2e-3)
    runs = simulated(log_spaced(20, 100), bench=bench, seed=4)
    series = align(recorded(runs))

    for run, found in zip(runs, series.runs, strict=True):
        true_s = 1.75e9 + run.report_vehicle_us[0] / 1e6 / bench.vehicle_clock
        assert found.start_s == pytest.approx(true_s + LEAST_LATENCY_S, abs=3e-4)
        assert found.sample_s == pytest.approx(SAMPLE_S / 1.002, rel=1e-5)
    assert series.lines[0].skew == pytest.approx(-1 / 85, abs=1e-5)
    assert series.mean_lateness_s == pytest.approx(0.016, abs=3 * series.mean_lateness_std_s)


def test_a_vehicle_restarted_between_runs_makes_two_clocks() -> None:
    first, second = simulated((3, 8, 25)), simulated((60, 5, 12), seed=1)
    later = [
        replace(run, report_host_s=run.report_host_s + 900, time_s=run.time_s + 900) for run in second
    ]  # the vehicle's microseconds restart
    series = align(recorded([*first, *later]))

    assert len(series.lines) == 2
    assert [set(run.shared_s) for run in series.runs[2:4]] == [{"offset 0", "rate 0"}, {"offset 1", "rate 1"}]


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("periods", [1, 30, 100, 400])
def test_a_run_alone_is_aligned_too_and_says_how_well(periods: int, stamped: bool) -> None:
    errors, stated = [], []
    for seed in range(12):
        run = simulated((periods,), seed=seed)[0]
        found = align(recorded([run], stamped=stamped)).runs[0]
        true_s = 1.75e9 + run.report_vehicle_us[0] / 1e6 / USUAL.vehicle_clock
        errors.append(found.start_s - true_s - LEAST_LATENCY_S)
        stated.append(np.hypot(found.start_std_s, np.linalg.norm(list(found.shared_s.values()))))

    assert np.median(np.abs(errors)) < 3 * np.median(stated) + 1e-4
    assert np.median(stated) < 0.05


def test_a_sine_of_the_module_of_2015_may_cross_an_exact_middle_a_sample_late() -> None:
    run = recorded(simulated((10,)), stamped=False)[0]  # N/l is 400, so the sine crosses at 100, 300, ...
    upward = np.flatnonzero(np.diff(run.sine.commands()[np.arange(299, 302)]) > 0)
    command = run.reports.command.copy()
    command[2] += run.sine.amplitude * run.sine.omega_rad
    matched = match_reports(run.sine, run.reports._replace(command=command))

    assert len(upward)
    assert matched.sample[:4].tolist() == [0, 100, 301, 500]


def without(run: RecordedSine, rows: list[int]) -> RecordedSine:
    fields = [None if values is None else np.delete(values, rows) for values in run.reports]
    return replace(run, reports=Reports(*fields))  # type: ignore[arg-type]


def kept(run: RecordedSine, rows: slice) -> RecordedSine:
    return replace(run, reports=Reports(*(None if values is None else values[rows] for values in run.reports)))  # type: ignore[arg-type]


def test_a_record_that_begins_with_the_run_has_no_bias_and_says_so() -> None:
    run = recorded(simulated((12,)))[0]
    begin = int(np.searchsorted(run.time_s, run.reports.host_s[0] - 0.02))
    series = align([replace(run, time_s=run.time_s[begin:], force_n=run.force_n[begin:])], sign="-")

    assert series.runs[0].bias_n is None
    assert series.runs[0].sign == -1
    assert series.findings[0].code == "sine-without-baseline"


@pytest.mark.parametrize("periods", [8, 25, 100])
def test_a_report_that_the_radio_lost_is_no_obstacle_with_stamps_and_refused_without(periods: int) -> None:
    whole = recorded(simulated((5, periods)))
    begun, found = (align(runs).runs[1] for runs in (whole, [whole[0], without(whole[1], [4, 9])]))
    unstamped = recorded(simulated((5, periods)), stamped=False)

    assert abs(found.start_s - begun.start_s) < 3e-4
    with pytest.raises(DataError, match=r"2 of .* reports are missing"):
        align([unstamped[0], without(unstamped[1], [4, 9])])


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("periods", [3, 12, 60])
def test_reports_of_another_sine_are_refused(periods: int, stamped: bool) -> None:
    run = recorded(simulated((periods,)), stamped=stamped)[0]
    others = [
        kept(run, slice(None, -1)),
        without(run, list(range(2, len(run.reports.host_s) - 1))),
        *(replace(run, sine=replace(run.sine, samples=samples)) for samples in (2000, 8000)),
        *(replace(run, sine=replace(run.sine, periods=other)) for other in (periods - 1, periods + 1, 2 * periods)),
        replace(run, sine=replace(run.sine, amplitude=15000)),
        replace(run, time_s=run.time_s[:4000], force_n=run.force_n[:4000]),
        replace(run, time_s=run.time_s[5000:], force_n=run.force_n[5000:]),
        replace(run, time_s=run.time_s + 500),
    ]
    for other in others:
        with pytest.raises(DataError, match=f"l = {periods}: "):
            align([other])
