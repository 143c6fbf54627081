"""The angle of a file: found by name, in the stated unit, continuous over turns; or the user is asked."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from cfid.errors import CfidError, ConfigError, DataError
from cfid.recordings.angle import AngleRecord, angle_of, counts_per_turn
from cfid.recordings.read import read_recording
from cfid.recordings.recording import How
from cfid.records.rig_file import EncoderScale
from cfid.swing.pendulum import NO_THREADS
from cfid.swing.result import estimate
from cfid.wire.rls import encode_positions

Array = npt.NDArray[Any]

TURN = 2 * np.pi
TIME_S = np.arange(2000) * 1e-3
ANGLE_RAD = 0.9 * np.exp(-0.4 * TIME_S) * np.cos(9 * TIME_S)
EPOCH_S = 1_600_000_000.0


def text_of(time: npt.ArrayLike, values: npt.ArrayLike, head: str = "t,phi", time_format: str = ".6f") -> str:
    rows = zip(np.asarray(time).tolist(), np.asarray(values).tolist(), strict=True)
    return "".join([f"{head}\n" if head else "", *(f"{t:{time_format}},{value}\n" for t, value in rows)])


def read(folder: Path, text: str, *, of_rig: float | None = None, **options: Any) -> AngleRecord:
    path, how = folder / "swing.csv", How(**options)
    path.write_text(text)
    return angle_of(read_recording(path, how, kind="angle"), how, rig_counts_per_turn=of_rig)


def refusal(folder: Path, text: str, kind: type[CfidError] = DataError, **options: Any) -> CfidError:
    with pytest.raises(kind) as caught:
        read(folder, text, **options)
    return caught.value


def codes(record: AngleRecord) -> list[str]:
    return [finding.code for finding in record.findings if finding.code != "file-read"]


def words(angle_rad: Array) -> npt.NDArray[np.int64]:
    """Return the 22-bit words that a 13-bit encoder sends for an angle."""
    return encode_positions(np.floor(angle_rad / TURN * 8192).astype(np.int64) % 8192)


def counts(angle_rad: Array, per_turn: int) -> npt.NDArray[np.int64]:
    return np.floor(angle_rad / TURN * per_turn).astype(np.int64) % per_turn


def off_by(record: AngleRecord, angle_rad: Array) -> float:
    """Return the largest difference from an angle, without the whole turns by which the first samples differ."""
    difference = record.angle_rad - angle_rad
    return float(np.abs(difference - TURN * np.round(difference[0] / TURN)).max())


# Columns and units


@pytest.mark.parametrize(
    ("head", "per_s", "per_rad"),
    [
        ("t [s],theta [rad]", 1.0, 1.0),
        ("time (ms),angle(deg)", 1e3, 180 / np.pi),
        ("timestamp_us,position [deg]", 1e6, 180 / np.pi),
        ("t [µs],φ [°]", 1e6, 180 / np.pi),
        ("%time [ms],field.position0 [rad]", 1e3, 1.0),
    ],
)
def test_names_and_units_are_read_from_the_head(tmp_path: Path, head: str, per_s: float, per_rad: float) -> None:
    record = read(tmp_path, text_of(TIME_S * per_s, ANGLE_RAD * per_rad, head))
    assert record.time_s == pytest.approx(TIME_S, abs=1e-9)
    assert record.angle_rad == pytest.approx(ANGLE_RAD, abs=1e-8)
    assert codes(record) == []


@pytest.mark.parametrize("values", [ANGLE_RAD, words(ANGLE_RAD)], ids=["rad", "words"])
def test_an_angle_without_a_unit_is_asked_about(tmp_path: Path, values: Array) -> None:
    error = refusal(tmp_path, text_of(TIME_S, values), ConfigError)
    assert error.code == "no-unit"
    assert "`unit` phi=deg" in str(error)


@pytest.mark.parametrize(
    ("head", "options", "kind", "code"),
    [
        ("t,speed", {}, ConfigError, "no-column"),
        ("t,phi,theta", {}, ConfigError, "no-column"),
        ("x,phi_rad", {}, ConfigError, "no-time"),
        ("t,phi [N]", {}, DataError, "other-unit"),
        ("t,phi_rad", {"counts_per_turn": 8192.0}, ConfigError, "unused"),
        ("t,phi", {"units": {"phi": "counts"}}, ConfigError, "no-counts-per-turn"),
        ("t,phi", {"counts_per_turn": 8192.0}, DataError, "counts-with-fractions"),
        ("t,phi_rad", {"units": {"psi": "deg"}}, ConfigError, "no-column"),
        ("t,phi_rad", {"clock": "84/85"}, ConfigError, "unused"),
        ("t,phi_rad", {"esc_us": (1000.0, 2000.0)}, ConfigError, "unused"),
    ],
)
def test_what_a_file_leaves_open_or_contradicts_is_asked_about(
    tmp_path: Path, head: str, options: dict[str, Any], kind: type[CfidError], code: str
) -> None:
    between = ",".join(["{0}"] * (head.count(",") - 1))
    rows = "".join(
        f"{t:.3f},{between.format(a)}{',' * bool(between)}{a}\n" for t, a in zip(TIME_S[:40], ANGLE_RAD, strict=False)
    )
    assert refusal(tmp_path, f"{head}\n{rows}", kind, **options).code == code


def test_columns_are_named_by_an_option(tmp_path: Path) -> None:
    rows = "".join(f"{1000 * t:.3f},{a:.9f},{2 * a:.9f}\n" for t, a in zip(TIME_S, ANGLE_RAD, strict=True))
    text = f"when_ms,phi_rad,psi_rad\n{rows}"
    for columns in (("t=when_ms", "phi=psi_rad"), ("t=1", "phi=3"), ("1", "3")):
        record = read(tmp_path, text, columns=columns)
        assert record.time_s == pytest.approx(TIME_S, abs=1e-9)
        assert record.angle_rad == pytest.approx(2 * ANGLE_RAD, abs=1e-8)


def test_times_in_nanoseconds_of_unix_time_are_read_and_keep_their_date(tmp_path: Path) -> None:
    time_s = 0.02 * np.arange(1000)
    stamps = (EPOCH_S * 1e9 + np.rint(1e9 * time_s)).astype(np.int64)
    swung = 0.5 * np.exp(-0.05 * time_s) * np.cos(8 * time_s)
    text = "%time,field.position0\n" + "".join(f"{t},{a:.6f}\n" for t, a in zip(stamps, swung, strict=True))
    assert "=ns" in str(refusal(tmp_path, text, ConfigError, units={"field.position0": "rad"}))
    record = read(tmp_path, text, units={"time": "ns", "field.position0": "rad"})
    assert record.time_s == pytest.approx(time_s, abs=1e-6)
    assert record.begin_s == pytest.approx(EPOCH_S)


# Counts


@pytest.mark.parametrize("start_rad", [-TURN, 0.5 * TURN])
@pytest.mark.parametrize("per_turn", [4194304, "rls-13bit-in-22", "rad", "deg"])
def test_an_angle_is_continuous_wherever_its_turn_ends(tmp_path: Path, start_rad: float, per_turn: int | str) -> None:
    angle = ANGLE_RAD + start_rad
    folded, options, step = angle % TURN, dict[str, Any](), 1e-6
    if per_turn in ("rad", "deg"):
        values, options = np.round(folded if per_turn == "rad" else np.degrees(folded), 6), {"units": {"phi": per_turn}}
    elif isinstance(per_turn, int):
        values, options, step = counts(angle, per_turn), {"counts_per_turn": float(per_turn)}, TURN / per_turn
    else:
        values, options, step = words(angle), {"counts_per_turn": per_turn}, TURN / 8192
    assert off_by(read(tmp_path, text_of(TIME_S, values), **options), angle) < step + 1e-8


def test_many_turns_are_counted_whether_the_counts_are_folded_or_not(tmp_path: Path) -> None:
    falling = 300 * TIME_S**2
    steps = np.floor(falling / TURN * 8192).astype(int)
    for values, per_turn, sign in [
        (words(falling), "rls-13bit-in-22", 1),
        (counts(falling, 4194304), 4194304.0, 1),
        (steps, 8192.0, 1),
        (-steps, 8192.0, -1),
        (steps * 8, 8192.0, 8),  # faster than half a turn from one row to the next
    ]:
        record = read(tmp_path, text_of(TIME_S, values), counts_per_turn=per_turn)
        assert off_by(record, sign * falling) < 8 * TURN / 8192 + 1e-8


def test_counts_are_those_of_the_rig_where_none_are_given(tmp_path: Path) -> None:
    text = text_of(TIME_S, np.rint(4096 / TURN * ANGLE_RAD), "t,enc_counts")
    found, given = read(tmp_path, text, of_rig=4096.0), read(tmp_path, text, counts_per_turn=4096.0)
    np.testing.assert_array_equal(found.angle_rad, given.angle_rad)


def test_a_few_words_that_fail_their_check_are_left_out_and_many_are_refused(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    values = words(ANGLE_RAD)
    few = random.choice(2000, 10, replace=False)
    values[few] = values[few] ^ 4
    record = read(tmp_path, text_of(TIME_S, values), counts_per_turn="rls-13bit-in-22")
    kept = np.delete(np.arange(2000), few)
    assert off_by(record, ANGLE_RAD[kept]) < TURN / 8192 + 1e-9
    assert codes(record) == ["angle-words-failed"]

    many = random.choice(2000, 100, replace=False)
    values[many] = values[many] ^ 4
    error = refusal(tmp_path, text_of(TIME_S, values), counts_per_turn="rls-13bit-in-22")
    assert error.code == "words-failed"


@pytest.mark.parametrize("text", ["0", "-1", "nan", "many"])
def test_counts_per_turn_that_make_no_turn_are_a_usage_error(text: str) -> None:
    with pytest.raises(ConfigError):
        counts_per_turn(text)
    assert counts_per_turn("4194304") == 4194304.0
    assert counts_per_turn("rls-13bit-in-22") == "rls-13bit-in-22"


# Faults of a sensor


@pytest.mark.parametrize("value", [np.pi, 1e300])
@pytest.mark.parametrize("in_row", [1, 3])
def test_wrong_readings_are_left_out_before_turns_are_counted(tmp_path: Path, value: float, in_row: int) -> None:
    wrong = [place + one for place in range(150, 2000, 401) for one in range(in_row)]
    angle = ANGLE_RAD.copy()
    angle[wrong] = value
    record = read(tmp_path, text_of(TIME_S, angle, "t,phi_rad"))
    assert off_by(record, np.delete(ANGLE_RAD, wrong)) < 1e-6
    assert codes(record) == ["angle-outliers" if value < 1e300 else "rows-without-number"]
    assert any("line 152" in finding.text for finding in record.findings)


@pytest.mark.parametrize("end", [906, None])
def test_a_jump_is_named_and_costs_no_readings(tmp_path: Path, end: int | None) -> None:
    slipped = ANGLE_RAD.copy()
    slipped[900:end] += 1.8
    record = read(tmp_path, text_of(TIME_S, slipped, "t,phi_rad"))
    assert len(record.time_s) == 2000
    assert codes(record) == ["angle-jumps"]
    noise = np.random.default_rng(0).integers(0, 4194304, 2000)
    assert refusal(tmp_path, text_of(TIME_S, noise), counts_per_turn=4194304.0).code == "angle-jumps"


@pytest.mark.parametrize("rate_hz", [1000, 25])
def test_a_swing_s_own_extremes_are_no_faults(tmp_path: Path, rate_hz: float) -> None:
    time_s = np.arange(0, 20, 1 / rate_hz)
    swung = np.where(time_s > 15, 1.2 * np.cos(14 * (time_s - 15)), 1.2)
    record = read(tmp_path, text_of(time_s, swung, "t,phi_rad"))
    assert len(record.time_s) == len(time_s)


def test_a_file_of_unknown_clock_gives_the_swing_s_frequency(tmp_path: Path) -> None:
    """Integrated with a step of 0.5 ms: omega squared is 60 1/s^2."""
    step_s, angle, speed, angles = 5e-4, 0.7, 0.0, []
    for _ in range(40_000):
        angles.append(angle)
        speed += step_s * (-60 * np.sin(angle) - 0.02 * speed)
        angle += step_s * speed
    text = text_of(2e-3 * np.arange(10_000) + EPOCH_S, np.degrees(angles[::4]), "timestamp,angle_deg")
    found = estimate(read(tmp_path, text), NO_THREADS, EncoderScale(), method="default")
    assert found.coefficients.natural_frequency_squared_s2 == pytest.approx(60, rel=2e-4)
