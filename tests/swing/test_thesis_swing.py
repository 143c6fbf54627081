"""The thesis methods for a swing, and their errors."""

import functools
import math

import numpy as np
import numpy.typing as npt
import pytest

from cfid.sim.plants import HandRelease, Pendulum, swing
from cfid.swing.thesis import fit_damped_cosine, fit_flexible, log_decrement
from cfid.swing.window import FreeSwing, find_swing

Array = npt.NDArray[np.float64]

THESIS_MOMENT = 0.028 * 9.81 * 0.022855127980389874


@functools.cache
def simulated(degrees: float, viscous: float, coulomb: float, inertia: float) -> tuple[Array, Array]:
    pendulum = Pendulum(
        axis_inertia_kg_m2=inertia,
        gravity_moment_nm=THESIS_MOMENT,
        viscous_nms_per_rad=viscous,
        coulomb_nm=coulomb,
    )
    release = HandRelease(angle_rad=math.radians(degrees), tremor_rad=0.0, wait_s=0.05, lift_s=0.3, hold_s=0.2)
    motion = swing([pendulum], [release], duration_s=9.0, step_s=1e-3, store_every=1)
    return motion.time_s, motion.angle_rad[:, 0]


def free(degrees: float, *, viscous: float = 1e-5, coulomb: float = 0.0, peaks: int | None = None) -> FreeSwing:
    return find_swing(*simulated(degrees, viscous, coulomb, 3.1e-5), peaks=peaks)


def test_data_made_from_eq_2_11_give_its_parameters_back() -> None:
    decay, omega, start, speed = 0.35, 14.2, 0.9, -0.4
    time_s = np.arange(0, 30, 0.004)  # until rest
    sine = (speed + decay * start) / omega
    amplitude, phase = math.hypot(start, sine), math.atan(sine / start)
    angle = amplitude * np.exp(-decay * time_s) * np.cos(omega * time_s - phase)
    found = fit_damped_cosine(find_swing(time_s, angle, from_s=0.0, peaks=10))

    assert found.frequencies.natural_frequency_squared_s2 == pytest.approx(omega**2 + decay**2, rel=1e-6)
    assert found.frequencies.viscous_per_s == pytest.approx(2 * decay, rel=1e-4)
    assert found.start_speed_rad_per_s == pytest.approx(speed, rel=0.02)


@pytest.mark.parametrize("degrees", [10, 20, 30, 40, 50])
def test_a_cosine_over_few_periods_is_too_high_by_what_the_period_grows_with_amplitude(degrees: float) -> None:
    # The swing is nearly undamped and free of the hand: its record begins at a peak and keeps its amplitude.
    time_s, angle = simulated(degrees, 2e-7, 0.0, 3.1e-5)
    begin = int(np.searchsorted(time_s, find_swing(time_s, angle).peak_time_s[1]))
    found = fit_damped_cosine(find_swing(time_s[begin:], angle[begin:], from_s=0.0, peaks=4))
    excess = THESIS_MOMENT / 3.1e-5 / found.frequencies.natural_frequency_squared_s2 - 1
    amplitude = abs(found.start_angle_rad)
    series = (1 + amplitude**2 / 16 + 11 * amplitude**4 / 3072) ** 2 - 1

    assert excess == pytest.approx(series, rel=0.03)


def test_the_fall_from_8_to_11_peaks_of_table_2_3_is_that_of_a_pendulum_let_go_at_50_degrees() -> None:
    record = simulated(49.6, 1.564e-5, 4.564e-5, 3.0185e-5)
    found = [
        1e5 * THESIS_MOMENT / fit_damped_cosine(find_swing(*record, peaks=n)).frequencies.natural_frequency_squared_s2
        for n in (8, 11)
    ]

    # Table 2.3, x axis; the pendulum's true inertia is 3.4 to 4.0 % below both rows.
    assert found == pytest.approx([3.144988, 3.119770], rel=2e-3)
    assert found[0] / found[1] == pytest.approx(3.144988 / 3.119770, abs=2.5e-3)


def test_the_nonlinear_equation_on_the_flexible_function_comes_nearer_than_the_cosine() -> None:
    given = free(50)
    truth = THESIS_MOMENT / 3.1e-5
    cosine = fit_damped_cosine(given).frequencies.natural_frequency_squared_s2
    flexible = fit_flexible(given).frequencies.natural_frequency_squared_s2

    # The search of the thesis stayed at the cosine's values (table 2.4 repeats table 2.3).
    assert abs(flexible - truth) < 0.5 * abs(cosine - truth)


def test_the_logarithmic_decrement_is_a_viscous_damping_and_scatters_where_friction_is_another() -> None:
    small, viscous, coulomb = (
        log_decrement(free(degrees, viscous=1e-5, coulomb=dry)) for degrees, dry in ((12, 0.0), (40, 0.0), (40, 4e-5))
    )

    assert small[0].viscous_per_s == pytest.approx(1e-5 / 3.1e-5, rel=0.02)
    assert small[1] < 0.1 * small[0].viscous_per_s
    assert coulomb[1] > 3 * viscous[1]
