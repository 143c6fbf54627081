"""Sines under imperfect conditions: delays that differ between runs, uneven motors, runs without their end."""

from dataclasses import replace

import numpy as np
import pytest

from cfid.transfer.alignment import Reports, align
from cfid.transfer.estimation import MeasuredSeries, fit_transfer, identify, measure
from cfid.transfer.frequency_response import Response
from cfid.transfer.plan import SAMPLE_S
from tests.transfer.sine_recordings import LAG_S as PLANT_LAG_S
from tests.transfer.sine_recordings import USUAL, exact, log_spaced, recorded, simulated

AMPLITUDE, STEADY_RAD_S, SWING_RAD_S = 20000, 1700.0, 800.0
GAIN_N, LAG_S, DELAY_S = 2.4e-6, 0.065, -0.02
OMEGA_RAD_S = 2 * np.pi * np.geomspace(0.2, 12.5, 12)


def responses(late_s: np.ndarray, rng: np.random.Generator, *, relative: float = 1e-3) -> tuple[Response, ...]:
    """Return responses of a first-order lag, each run with its own additional delay from `late_s`."""
    half = OMEGA_RAD_S * SAMPLE_S / 2
    plant = GAIN_N / (1 + 1j * OMEGA_RAD_S * LAG_S) * np.sinc(half / np.pi) * np.exp(-1j * half)
    std = relative * np.abs(plant) / np.sqrt(2)
    noise = std * (rng.standard_normal(len(std)) + 1j * rng.standard_normal(len(std)))
    values = plant * np.exp(-1j * OMEGA_RAD_S * (DELAY_S + late_s)) + noise
    return tuple(
        Response(
            name=f"{place}",
            periods=place + 1,
            frequency_rad_s=float(OMEGA_RAD_S[place]),
            sample_s=SAMPLE_S,
            value=complex(value),
            covariance=own**2 * np.eye(2),
            start_std_s=0.0,
            shared_s={},
        )
        for place, (value, own) in enumerate(zip(values, std, strict=True))
    )


def test_delays_that_differ_from_run_to_run_are_found_and_leave_the_intervals_true() -> None:
    rng, held, sizes = np.random.default_rng(1), [], []
    for _ in range(40):
        series = MeasuredSeries(name="a", responses=responses(rng.normal(0, 5e-3, 12), rng))
        fit = fit_transfer([series])
        held += [
            abs(fit.gain_n - GAIN_N) < 1.96 * fit.std[0],
            abs(fit.time_constant_s - LAG_S) < 1.96 * fit.time_constant_std_s,
            abs(fit.mean_delay.after_quickest_s - DELAY_S) < 1.96 * fit.mean_delay.after_quickest_std_s,
        ]
        sizes.append(fit.delay_scatter_s)
        assert "transfer-delays-scatter" in {one.code for one in fit.findings(["tf.delay_s"])}
    print(f"{100 * np.mean(held):.0f} % of {len(held)}")

    assert np.mean(held) >= 0.93
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(5e-3, rel=0.25)


def test_one_delay_for_all_runs_does_not_scatter() -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        fit = fit_transfer([MeasuredSeries(name="a", responses=responses(np.zeros(12), rng))])
        assert fit.delay_scatter_s == 0.0


def uneven_second(part: float, omega_rad_s: float) -> tuple[complex, complex]:
    """Integrate a speed that follows a sine at two rates; return the fundamental and second harmonic of its thrust."""
    period_s = 2 * np.pi / omega_rad_s
    count = 20 * int(np.ceil(period_s / 4e-3))
    step_s, periods = period_s / count, int(np.ceil(0.7 / period_s)) + 1
    speed, found = 0.0, np.zeros(count)
    for place in range(periods * count):
        ahead = SWING_RAD_S * np.cos(omega_rad_s * place * step_s) - speed
        speed += step_s / LAG_S * (1 + part * np.sign(ahead)) * ahead
        found[place % count] = speed
    wave = np.exp(-2j * np.pi * np.arange(count) / count)
    thrust = 2e-8 * (STEADY_RAD_S + found) ** 2
    return complex(2 * np.mean(thrust * wave)), complex(2 * np.mean(thrust * wave**2))


@pytest.mark.parametrize("part", [0.0, 0.2])
def test_the_second_harmonic_shows_a_motor_that_slows_down_more_slowly(part: float) -> None:
    rng, uneven = np.random.default_rng(3), []
    for own in responses(np.zeros(12), rng):
        first, second = uneven_second(part, own.frequency_rad_s)
        value = first / AMPLITUDE * np.exp(-1j * own.frequency_rad_s * DELAY_S)
        shape = second * np.conj(first) ** 2 / abs(first) ** 3
        noise = (1e-3 * abs(value)) ** 2 * np.eye(2)
        uneven.append(replace(own, value=complex(value), second=complex(shape), covariance=noise))
    fit = fit_transfer([MeasuredSeries(name="a", responses=tuple(uneven))])

    if not part:
        assert fit.lag_ratio == 1
        return
    assert fit.lag_ratio == pytest.approx(1.5, rel=0.1)
    assert "transfer-uneven-lag" in {one.code for one in fit.findings(["tf.time_constant_s"])}
    assert abs(fit.time_constant_s - LAG_S / (1 - part**2)) < 1.96 * fit.time_constant_std_s


def test_a_run_whose_last_report_was_lost_is_left_out_with_a_warning() -> None:
    runs = exact(6e-8, 0.97, periods=[2, 5, 10, 20], samples=4000)
    reports = runs[1].reports
    lost = replace(runs[1], reports=Reports(reports.host_s[:-1], reports.command[:-1]))
    found = identify({"bench": [runs[0], lost, *runs[2:]]})

    assert [run.sine.periods for run in found.used["bench"]] == [2, 10, 20]
    (warned,) = [one for one in found.findings if one.code == "sine-without-end"]
    assert warned.severity == "warning"
    assert "l = 5" in warned.text
    assert "1 of 4" in warned.text


@pytest.mark.parametrize("skew", [0.0, 3e-4, -3e-4])
def test_a_load_cell_whose_clock_runs_off_the_hosts_keeps_its_delay(skew: float) -> None:
    errors = []
    for seed in range(6):
        runs = recorded(simulated(log_spaced(12, 100), seed=seed))
        skewed = [
            replace(run, time_s=run.time_s[0] + (run.time_s - run.time_s[0]) * (1 + skew), own_clock=True)
            for run in runs
        ]
        measured = measure("a", align(skewed))
        fit = fit_transfer([measured])
        delay = fit.mean_delay
        errors.append((delay.delay_s - USUAL.delay_s) / delay.std_s)
        assert measured.skew == pytest.approx(skew, abs=4 * measured.skew_std)
        assert measured.skew_std < 5e-5
        assert fit.time_constant_s == pytest.approx(PLANT_LAG_S, rel=0.01)

    assert np.sqrt(np.mean(np.square(errors))) < 1.7
