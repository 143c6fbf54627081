"""What a run's folder shows while it grows: curves in their units, losses, rates, state, remaining time."""

import math
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from bokeh.models import Range1d

from cfid.records.run import DeviceRecord, Label, Run, Verdict, amend_run, read_run
from cfid.records.run_writer import RunWriter, create_run
from cfid.watch.facts import facts_html
from cfid.watch.live_run import LiveRun, newest_run, planned_s
from cfid.watch.plots import Colours, SignalPlot
from cfid.watch.spectrum import spectrum_of
from cfid.wire.rls import encode_positions
from cfid.wire.supervisor import Bits

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


Recording = Callable[..., RunWriter]


@pytest.fixture
def recording(tmp_path: Path) -> Iterator[Recording]:
    """Begin runs of one device each, which end with the test."""
    writers: list[RunWriter] = []

    def begin(
        device: str,
        columns: tuple[str, ...],
        *,
        note: str | None = None,
        kind: str = "loadcell",
        asked: Mapping[str, object] = MappingProxyType({}),
        **facts: object,
    ) -> RunWriter:
        record = DeviceRecord.model_validate({"file": f"{device}.csv", "columns": ("t", *columns), **facts})
        writers.append(
            create_run(
                tmp_path,
                kind=kind,
                label=Label(note=note),
                devices={device: record},
                started=datetime.now(UTC),
                cfid_version="0",
                requested=asked,
            )
        )
        return writers[-1]

    yield begin
    for writer in writers:
        if writer.header.state == "recording":
            writer.close("complete")


def rows(writer: RunWriter, device: str, time_s: np.ndarray, *columns: np.ndarray) -> None:
    writer.append(device, (time_s, *columns))


def test_rows_of_the_vehicles_log_that_are_lost_are_counted_by_its_own_time(recording: Recording) -> None:
    begin_s = time.time()
    writer = recording("crazyflie", ("vehicle_ms", "pm.vbat"), kind="thrust")
    run = LiveRun(writer.folder)
    number = np.delete(np.arange(100), [5, 40, 41])
    stamps = (10 * number + number % 2 + 2**24 - 300) % 2**24  # a millisecond late now and then
    for part in np.array_split(np.arange(len(number)), 30):
        rows(writer, "crazyflie", begin_s + number[part] / 100, stamps[part], np.full(len(part), 3.7))
        run.read(1.0)

    assert "97 rows, 3 lost" in facts_html(run, refused=0)


def test_a_short_run_that_is_read_at_once_has_a_rate(recording: Recording) -> None:
    """Its force had no spectrum, because the rate was missing."""
    begin_s = time.time()
    writer = recording("crazyflie", ("vehicle_ms", "pm.vbat"), kind="thrust")
    rows(writer, "crazyflie", begin_s + np.arange(300) / 100, 10 * np.arange(300), np.full(300, 3.7))
    run = LiveRun(writer.folder)
    run.read(1.0)

    assert run.devices["crazyflie"].rate_hz == pytest.approx(100, rel=0.01)


def test_forces_are_drawn_in_millinewtons_above_the_cells_bias_with_losses_rate_and_time_left(
    recording: Recording,
) -> None:
    begin_s = time.time()
    writer = recording(
        "loadcell",
        (*AXES, "rdt_sequence"),
        counts_per_n=1e6,
        counts_per_nm=1e6,
        rate_hz=1000,
        kind="thrust",
        asked={"for_s": 100.0},
    )
    run = LiveRun(writer.folder)
    assert not run.read(1.0)
    for first in (0, 500):
        number = np.arange(first, first + 500)
        force = 7_000_000 + 2_000_000 * (number >= 500)
        lost = 3 * (number >= 700)
        rows(writer, "loadcell", begin_s + number / 1000, force, *[force * 0] * 5, number + 2**32 - 600 + lost)
        assert run.read(1.0)

    seen = run.signals[0].extremes.view(0.0, 1.0, 100)
    assert np.all(seen.low[:, 0] == 2000.0 * (seen.time_s >= 0.5))
    device = run.devices["loadcell"]
    assert (device.rows, device.missing) == (1000, 3)
    assert device.rate_hz == pytest.approx(1000, rel=0.01)
    assert run.left_s == pytest.approx(99.0, abs=0.1)
    assert "1000 of 1000 Hz, 1000 rows, 3 lost" in facts_html(run, refused=0)

    writer.close("failed", reason="the box went silent")
    assert run.read(1.0)
    assert not run.recording
    assert run.left_s is None
    assert "failed: the box went silent" in facts_html(run, refused=0)


def test_an_angle_goes_on_over_the_end_of_a_turn_without_words_that_fail_their_check(
    recording: Recording,
) -> None:
    writer = recording("encoder", ("phi",), counts_per_turn="rls-13bit-in-22")
    run = LiveRun(writer.folder)
    position = np.arange(8000, 8000 + 1000) % 8192
    words = encode_positions(position)
    words[100] ^= 1
    for part in np.array_split(np.arange(1000), 7):
        rows(writer, "encoder", 1000.0 + part / 1000, words[part])
        run.read(1.0)

    seen = run.signals[0].extremes.view(0.0, 1.0, 2000)
    angle = seen.low[:, 0]
    assert math.isnan(angle[100])
    assert np.nanmax(angle) - np.nanmin(angle) == pytest.approx(360 * 999 / 8192)


def test_texts_of_a_run_are_shown_as_text_without_control_characters(recording: Recording) -> None:
    writer = recording("encoder", ("phi",), note="<script>x</script>\x1b[31m & more")
    shown = facts_html(LiveRun(writer.folder), refused=0)
    assert "&lt;script&gt;x&lt;/script&gt;?[31m &amp; more" in shown
    assert "<script>" not in shown


def test_a_recording_that_is_not_usable_is_so_called(recording: Recording) -> None:
    writer = recording("encoder", ("phi",))
    writer.close("complete")
    amend_run(read_run(writer.folder), verdict=Verdict(usable=False, text="no release found: record again"))

    assert "not usable: no release found: record again" in facts_html(LiveRun(writer.folder), refused=0)


def test_a_vehicles_state_after_the_end_is_the_one_last_seen(recording: Recording) -> None:
    writer = recording("supervisor", ("info",))
    rows(writer, "supervisor", np.array([time.time()]), np.array([Bits.FLYING]))
    run = LiveRun(writer.folder)
    assert run.read(1.0)
    assert "<th>vehicle</th>" in facts_html(run, refused=0)

    writer.close("failed", reason="no link")
    assert run.read(1.0)
    assert "<th>vehicle, last seen</th>" in facts_html(run, refused=0)


def test_a_recorder_that_hangs_leaves_no_rate_and_a_state_that_was_last_seen(recording: Recording) -> None:
    writer = recording("supervisor", ("info",))
    began_s = time.time() - 60.0
    rows(writer, "supervisor", began_s + 0.01 * np.arange(300), np.full(300, Bits.FLYING))
    run = LiveRun(writer.folder)
    assert run.read(1.0)

    shown = facts_html(run, refused=0)
    assert "recording, but no row for" in shown
    assert "<th>vehicle, last seen</th>" in shown
    assert " Hz" not in shown


def test_a_single_typed_reading_has_a_mark_and_many_rows_a_line_alone(recording: Recording) -> None:
    writer = recording("readings", ("command", "rpm", "withdrawn"), kind="speed")
    rows(writer, "readings", np.array([5.0]), np.array([20000.0]), np.array([8120.0]), np.array([0.0]))
    typed, writer = LiveRun(writer.folder), recording("encoder", ("phi",))
    rows(writer, "encoder", 1e-3 * np.arange(1000), np.arange(1000))
    swing = LiveRun(writer.folder)

    assert [marked(one) for one in (typed, swing)] == [[8120.0], []]


def marked(run: LiveRun) -> list[float]:
    """Return the marked values of a run's first signal in a picture of its first seconds."""
    run.read(1.0)
    plot = SignalPlot(run.signals[0], Range1d(0.0, 10.0), Colours(dark=False))
    plot.draw(0.0, 10.0, 10.0)
    marks = next(one for one in plot.figure.renderers if type(one.glyph).__name__ == "Scatter").data_source.data
    return sorted(set(marks[run.signals[0].names[0]]))


def test_typed_readings_are_drawn_without_their_commands_and_reported_commands_as_steps(recording: Recording) -> None:
    typed = LiveRun(recording("readings", ("command", "rpm", "withdrawn"), kind="speed").folder)
    reported = LiveRun(recording("crossings", ("thrust_rec", "sample", "vehicle_us"), kind="sine").folder)

    assert [(one.title, one.names, one.unit) for one in typed.signals] == [("speed", ("rpm",), "rpm")]
    assert [(one.title, one.steps) for one in reported.signals] == [("command, as the vehicle reports it", True)]


def test_a_device_of_no_known_kind_is_drawn_in_its_own_columns(recording: Recording) -> None:
    writer = recording("crazyflie", ("vehicle_ms", "pm.vbat", "gyro.x", "gyro.y"))
    run = LiveRun(writer.folder)
    rows(writer, "crazyflie", np.array([5.0, 6.0]), np.array([1, 2]), *[np.array([3.9, 3.8])] * 3)
    run.read(1.0)
    assert [(signal.title, signal.names) for signal in run.signals] == [
        ("battery", ("pm.vbat",)),
        ("gyro", ("gyro.x", "gyro.y")),
    ]
    assert run.battery_v == 3.8


def test_the_newest_run_is_the_one_that_is_recorded_else_the_last(recording: Recording, tmp_path: Path) -> None:
    assert newest_run(tmp_path) is None
    first = recording("encoder", ("phi",))
    second = recording("encoder", ("phi",))
    second.close("complete")
    os.utime(first.folder / "encoder.csv", (0, 0))  # it waits for its device
    assert newest_run(tmp_path) == first.folder
    first.close("complete")
    assert newest_run(tmp_path) == second.folder


def test_a_recording_without_rows_is_told_from_one_that_was_cut(recording: Recording, tmp_path: Path) -> None:
    writer = recording("encoder", ("phi",), asked={"for_s": 20})
    writer.append("encoder", ([time.time() - 60], [0]))
    os.utime(writer.folder / "encoder.csv", (0, 0))

    def shown(folder: Path) -> str:
        run = LiveRun(folder)
        run.read(1.0)
        return facts_html(run, refused=0)

    alive, cut = shown(writer.folder), shown(shutil.copytree(writer.folder, tmp_path / "copied"))
    assert "recording, but no row for 60 s" in alive
    assert "0:20 min left" in alive
    assert "cut, no row for 60 s" in cut
    assert "left" not in cut


def test_nobody_knows_how_long_typing_takes(recording: Recording) -> None:
    asked = {"steps": [1, 2], "motors": [1], "hold_s": 3.0, "rest_s": 1.0}

    assert LiveRun(recording("readings", ("command", "rpm", "withdrawn"), asked=asked).folder).left_s is None


def test_a_device_without_new_rows_has_no_rate_any_more(tmp_path: Path) -> None:
    """Commands, for example, have a row per change: two rows would give some 6 Hz for as long as the second holds."""
    columns = {"commands": ("t", "m1"), "crazyflie": ("t", "pm.vbat")}
    begin_s = time.time()
    with create_run(
        tmp_path,
        kind="speed",
        label=Label(),
        devices={name: DeviceRecord(file=f"{name}.csv", columns=own) for name, own in columns.items()},
        started=datetime.now(UTC),
        cfid_version="0",
    ) as writer:
        writer.append("commands", (begin_s + np.array([0.0, 0.15]), [0, 20000]))
        writer.append("crazyflie", (begin_s + np.arange(1000) / 100, np.full(1000, 3.7)))
        run = LiveRun(writer.folder)
        run.read(1.0)
        shown = facts_html(run, refused=0)

    assert "100 Hz, 1000 rows" in shown
    assert ">2 rows" in shown


@pytest.mark.parametrize(
    ("asked", "seconds"),
    [
        ({"for_s": 20}, 20.0),
        ({"steps": [1, 2], "motors": [1], "hold_s": 3.0, "rest_s": 1.0}, 9.0),
        ({"l": 3, "n": 1000, "amplitude": 1, "motor": 1}, 2.0),
        ({}, None),
        ({"steps": "wrong"}, None),
    ],
)
def test_the_planned_duration_is_that_of_the_request(
    recording: Recording, asked: dict[str, object], seconds: float | None
) -> None:
    writer = recording("encoder", ("phi",), asked=asked)
    assert planned_s(Run(folder=writer.folder, header=read_run(writer.folder).header)) == seconds


def test_lines_of_two_rotors_are_labelled_and_a_line_that_stands_alone_is_not() -> None:
    random = np.random.default_rng(3)
    time_s = np.arange(3500) / 7000
    force = random.normal(scale=0.02, size=(3500, 3))
    for turning_hz in (240.0, 290.0):
        for harmonic, height in ((1, 0.02), (2, 0.03)):
            force += height * np.sin(2 * np.pi * harmonic * turning_hz * time_s + harmonic)[:, np.newaxis]

    seen = spectrum_of(time_s, force)

    assert seen is not None
    labelled = {(line.label, round(line.frequency_hz, -1)) for line in seen.rotors}
    assert {("rotor", 240.0), ("blade pass", 480.0), ("rotor", 290.0), ("blade pass", 580.0)} <= labelled


def test_a_line_that_may_be_folded_from_above_half_the_sampling_rate_is_not_labelled() -> None:
    time_s = np.arange(350) / 700
    noise = np.random.default_rng(5).normal(scale=0.01, size=(350, 3))
    folded = spectrum_of(time_s, noise + np.sin(2 * np.pi * 641 * time_s)[:, np.newaxis])
    assert folded is not None
    assert folded.rotors == ()


def test_noise_alone_has_no_rotor() -> None:
    random = np.random.default_rng(4)
    seen = spectrum_of(np.arange(3500) / 7000, random.normal(size=(3500, 3)))
    assert seen is not None
    assert seen.rotors == ()


def test_samples_with_a_gap_have_no_spectrum() -> None:
    time_s = np.arange(3500) / 7000
    time_s[2000:] += 5.0
    assert spectrum_of(time_s, np.zeros((3500, 3))) is None
