"""`latency.fit` and `cfid tf latency`: round trips of table 3.2, and the vehicle's clock against the host's."""

import json
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pytest

from cfid import latency
from cfid.errors import DataError
from cfid.latency.result import round_trips
from cfid.recordings.recording import How
from cfid.recordings.sines import read_pings
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.records.run import Label, Run
from cfid.sim.link import Direction, RadioTruth
from tests.lab import Cfid, made_run, sections_at

RATE = 84 / 85
ZERO_S = 1.75e9 - 100 / RATE  # the host's time when the vehicle's clock was zero
MEAN_S, JITTER_S = 0.0285, 0.011  # one way


def ping_run(folder: Path, *, count: int = 400, seed: int = 0, stamped: bool = True) -> Run:
    """Write a run of pings like those of table 3.2."""
    radio = RadioTruth(latency_s=MEAN_S, jitter_s=JITTER_S)
    rng = np.random.default_rng(seed)
    there, back = Direction(radio, rng), Direction(radio, rng)
    sent_s = 1.75e9 + 20 * seed + 0.1 * np.arange(count)
    reached_s = np.array([there.arrival_s(time_s) or 0.0 for time_s in sent_s])
    arrived_s = np.array([back.arrival_s(time_s) or 0.0 for time_s in reached_s])
    device_us = np.floor((reached_s - ZERO_S) * RATE * 1e6).astype(np.int64) % 2**32
    columns = {"t": sent_s, "rtt_s": np.round(arrived_s - sent_s, 7), **({"vehicle_us": device_us} if stamped else {})}
    started = pd.Timestamp(sent_s[0], unit="s", tz="UTC").to_pydatetime()
    return made_run(folder, "ping", {"pings": columns}, label=Label(note="just started up"), started=started)


def rtt_file(path: Path, *rtt_s: float) -> Path:
    path.write_text("rtt_s\n" + "".join(f"{one:.4f}\n" for one in rtt_s))
    return path


def test_round_trips_have_the_statistics_of_table_3_2() -> None:
    trips = round_trips(np.array([0.030, 0.060, 0.090, 0.060]))

    assert trips.answers == 4
    assert trips.mean_s == pytest.approx(0.060)
    assert trips.std_s == pytest.approx(0.03 * np.sqrt(2 / 3))
    assert trips.effective == 4
    student = 3.182 / 1.96  # three degrees of freedom
    assert trips.mean_std_s == pytest.approx(student * 0.03 * np.sqrt(2 / 3) / 2, rel=1e-3)
    assert trips.least_s == 0.030
    assert trips.one_way_mean_s == pytest.approx(0.030)
    assert trips.offset_bound_s == 0.015


def test_a_run_gives_round_trips_and_the_vehicles_clock(tmp_path: Path) -> None:
    run = ping_run(tmp_path)
    result = latency.fit([run])
    found = result.quantities
    rtt_s = pd.read_csv(run.device_file("pings")).rtt_s

    assert found["latency.rtt_mean_s"].value == pytest.approx(rtt_s.mean())
    assert found["latency.rtt_mean_s"].std == pytest.approx(rtt_s.std() / 20, rel=0.01)  # of 400, nearly independent
    assert found["latency.rtt_std_s"].value == pytest.approx(rtt_s.std())
    assert found["latency.rtt_min_s"].value == rtt_s.min()
    skew = found["latency.clock_skew"]
    assert skew.value == pytest.approx(RATE - 1, abs=3 * skew.std)
    assert skew.std < 1e-4
    assert result.accepted
    assert not result.findings


def test_several_runs_are_taken_together_with_the_clock_of_the_last_that_has_stamps(tmp_path: Path) -> None:
    runs = [ping_run(tmp_path, seed=seed, count=100, stamped=seed < 2) for seed in range(3)]
    together, last = latency.fit(runs), latency.fit([runs[1]])

    assert together.quality["answers"] == 300
    skew = together.quantities["latency.clock_skew"]
    assert (skew.value, skew.std) == (
        last.quantities["latency.clock_skew"].value,
        last.quantities["latency.clock_skew"].std,
    )


def test_the_clocks_offset_rests_on_round_trips_of_its_own_link(cfid: Cfid, tmp_path: Path) -> None:
    """Pings by a cable, ten times as quick and without stamps, do not shorten the way that stamps take by radio."""
    radio = foreign_pings(tmp_path / "radio.csv", begin_s=1.75e9)  # 8 ms and more there and back, stamps 12.3 s ahead
    usb = rtt_file(tmp_path / "usb.csv", *(0.0008 + 0.0002 * np.random.default_rng(1).random(300)))
    shown = json.loads(cfid("tf", "latency", usb, radio, "--json").stdout)["parameters"]
    offset, least = shown["latency.clock_offset_s"], shown["latency.rtt_min_s"]

    assert least["value"] < 0.001
    assert offset["value"] == pytest.approx(1.75e9 - 12.3, abs=3e-4, rel=0)
    assert offset["std"] < 1e-4


def test_too_few_stamps_take_the_clock_away_and_leave_the_round_trips(tmp_path: Path) -> None:
    result = latency.fit([ping_run(tmp_path, count=2)])

    assert result.accepted
    assert [one.code for one in result.findings if one.severity == "rejection"] == ["clock-stamps-too-few"]
    assert result.findings[0].concerns("latency.clock_skew")
    assert "latency.rtt_mean_s" in result.quantities
    assert not any("clock" in key for key in result.quantities)


def test_the_command_keeps_what_it_found_in_the_campaign(cfid: Cfid, tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    for seed in range(2):
        ping_run(tmp_path, seed=seed, count=100)
    ended = cfid("tf", "latency")

    assert ended.returncode == 0, ended.stderr
    section = sections_at(tmp_path)["latency"]
    assert {"latency.rtt_median_s", "latency.rtt_p95_s", "latency.clock_offset_s"} <= set(section.parameters)


@pytest.mark.parametrize(
    ("head", "row", "units"),
    [
        ("rtt_s,t,vehicle_us", "{0:.6f},{1:.3f},{2:.0f}", {}),
        ("Time (ms);RTT (ms);vehicle time (ms)", "{3:.1f};{4:.3f};{5:.3f}", {}),
        ("time;round trip;vehicle", "{3:.1f};{4:.3f};{2:.0f}", {"time": "ms", "round trip": "ms"}),
        ("timestamp,latency [us],vehicle_us", "{1:.4f},{6:.0f},{2:.0f}", {}),
    ],
)
@pytest.mark.parametrize("decimal", [".", ","])
def test_pings_of_others_are_read_by_their_names_and_units(
    tmp_path: Path, head: str, row: str, units: dict[str, str], decimal: Literal[".", ","]
) -> None:
    rtt_s, sent_s = 0.004 + 1e-4 * np.arange(50), 100 + 0.1 * np.arange(50)
    device_us = 1e6 * sent_s - 5e6
    rows = [
        row.format(*each)
        for each in zip(rtt_s, sent_s, device_us, 1e3 * sent_s, 1e3 * rtt_s, device_us / 1e3, 1e6 * rtt_s, strict=True)
    ]
    text = "\n".join([head, *rows, ""])
    path = tmp_path / "pings.csv"
    path.write_text(text.replace(",", ";").replace(".", ",") if decimal == "," else text)
    found = read_pings(path, How(units=units, decimal=decimal))
    np.testing.assert_allclose(found.rtt_s, rtt_s, rtol=1e-9)
    assert found.sent_s is not None
    assert found.vehicle_us is not None
    np.testing.assert_allclose(found.sent_s, sent_s)
    np.testing.assert_allclose(found.vehicle_us, device_us)


@pytest.mark.parametrize(
    ("fault", "code"), [("", "rows-without-number"), ("lost", "rows-without-number"), ("1e300", "impossible-trip")]
)
def test_round_trips_without_a_number_are_left_out_and_impossible_ones_refused(
    tmp_path: Path, fault: str, code: str
) -> None:
    rtt_ms = [50.0 + place % 7 for place in range(100)]
    rows = [f"{place / 10:.1f},{value}" for place, value in enumerate(rtt_ms)]
    rows[40] = f"4.0,{fault}"
    path = tmp_path / "pings.csv"
    path.write_text("\n".join(["t,rtt_ms", *rows, ""]))
    if code == "impossible-trip":
        with pytest.raises(DataError, match=r"pings\.csv:42") as caught:
            read_pings(path)
        assert caught.value.code == code
        return
    found = read_pings(path)
    np.testing.assert_allclose(found.rtt_s, np.delete(rtt_ms, 40) / 1e3)
    assert [finding.code for finding in found.findings] == [code]


def foreign_pings(path: Path, *, begin_s: float, stamps: dict[int, float] | None = None) -> Path:
    """Write pings in the form of another program, with wrong stamps in some rows."""
    rng = np.random.default_rng(4)
    sent_s = begin_s + 0.1 * np.arange(400)
    there_s, back_s = rng.uniform(0.004, 0.006, 400), rng.uniform(0.004, 0.006, 400)
    vehicle_us = np.floor(1e6 * (sent_s + there_s - begin_s + 12.3))
    for row, stamp in (stamps or {}).items():
        vehicle_us[row] = stamp
    rows = zip(sent_s, 1e3 * (there_s + back_s), vehicle_us, strict=True)
    path.write_text("t,rtt_ms,vehicle_us\n" + "".join(f"{a:.6f},{b:.4f},{c:.0f}\n" for a, b, c in rows))
    return path


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("t,delay\n1,2\n2,3\n", 4),
        ("rtt_s\n0.05\n-0.05\n", 4),
        ("rtt_s\n0.05\n", 5),
        (None, 4),
    ],
)
def test_a_file_without_usable_round_trips_is_refused(cfid: Cfid, tmp_path: Path, text: str | None, code: int) -> None:
    if text is not None:
        (tmp_path / "rtt.csv").write_text(text)
    ended = cfid("tf", "latency", "rtt.csv")

    assert (ended.returncode, ended.stdout) == (code, "")
    assert cfid("tf", "latency").returncode == 2  # no campaign to take runs from


def test_a_host_clock_that_jumped_leaves_the_round_trips_and_rejects_the_vehicles_clock(
    cfid: Cfid, tmp_path: Path
) -> None:
    run = ping_run(tmp_path)
    path = run.device_file("pings")
    pings = pd.read_csv(path, dtype={"vehicle_us": np.int64})
    pings.loc[200:, "t"] += 5.0
    pings.to_csv(path, index=False, float_format="%.7f")
    content = json.loads(cfid("tf", "latency", run.folder, "--json").stdout)

    assert content["accepted"]
    assert not any("clock" in key for key in content["parameters"])
