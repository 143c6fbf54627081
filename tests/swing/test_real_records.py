"""Public records of real pendulums (dynamicslab/MultiArm-Pendulum; jensen-benard/rotary-inverted-pendulum)."""

import numpy as np
import pytest

from cfid.recordings.angle import AngleRecord, angle_of, angle_record
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How
from cfid.swing.estimation import fit_swing
from cfid.swing.thesis import fit_damped_cosine
from cfid.swing.window import FreeSwing, find_swing
from tests.lab import DATA

SOUND = DATA / "multiarm_pendulum" / "single_free_swing.csv"
BAD = DATA / "rotary_inverted_pendulum" / "pendulum_free_swing_data_01.txt"

needs_sound = pytest.mark.skipif(not SOUND.exists(), reason="the public pendulum record is not here (CFID_DATA)")
needs_bad = pytest.mark.skipif(not BAD.exists(), reason="the public record of a bad rig is not here (CFID_DATA)")


def sound_swing(**window: float | int) -> FreeSwing:
    record: AngleRecord = angle_record(SOUND)
    return find_swing(record.time_s, record.angle_rad, **window)  # type: ignore[arg-type]


@needs_sound
def test_the_sound_rig_gives_its_authors_natural_frequency() -> None:
    fit = fit_swing(sound_swing())

    # The published parameters give (m g a) / (I + m a^2) = 64.22 1/s^2.
    assert 64.0 <= fit.coefficients.natural_frequency_squared_s2 <= 64.3
    assert fit.accepted
    # Other integrators, with and without a cable, give 64.00 to 64.04.
    assert abs(fit.coefficients.natural_frequency_squared_s2 - 64.02) < 2 * fit.std.natural_frequency_squared_s2 < 0.2


@needs_sound
def test_the_natural_frequency_stays_steady_while_the_amplitude_falls_from_93_to_15_degrees() -> None:
    windows = [(0, 10), (5, 15), (10, 20), (15, 25), (20, 30), (25, 35), (30, 40), (35, 45), (40, 54)]
    fits = [fit_swing(sound_swing(from_s=a, to_s=b)) for a, b in windows]
    found = np.array([fit.coefficients.natural_frequency_squared_s2 for fit in fits])

    assert np.ptp(found) / found.mean() < 3e-3
    assert all(fit.accepted for fit in fits)


@needs_sound
def test_a_damped_cosine_on_the_sound_rig_is_a_quarter_too_low() -> None:
    cosine = fit_damped_cosine(sound_swing(peaks=8)).frequencies

    assert cosine.natural_frequency_squared_s2 == pytest.approx(0.745 * 64.07, rel=0.02)


@needs_bad
@pytest.mark.parametrize("from_s", [None, 1.0, 2.0])
def test_the_bad_rig_is_rejected_whichever_window_is_chosen(from_s: float | None) -> None:
    record = angle_of(read_recording(BAD, How(skip_lines=2, rate_hz=1000, units={"1": "deg"})))
    fit = fit_swing(find_swing(record.time_s, record.angle_rad, from_s=from_s))

    assert not fit.accepted
    assert "swing-waveform-distorted" in {finding.code for finding in fit.findings}
