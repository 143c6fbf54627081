"""Drag from runs of `cfid log wind`."""

import json
import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from cfid import drag
from cfid.drag.model import DragExperiments
from cfid.drag.plan import WindSetting, recorded
from cfid.errors import DataError
from cfid.records.rig_file import LoadCellMount, RigFacts, Tachometer, WindStand
from cfid.records.run import Run, read_run, write_header
from cfid.sim.propulsion import BatteryTruth, RotorTruth, WindTruth
from tests.drag.wind_in_a_folder import MOUNT
from tests.lab import Cfid, made_run, new_campaign
from tests.motors.stand_in_a_folder import BEGIN_S, COLUMNS, climbed, write_run

COMMANDS = (20000, 40000)
WINDS = (
    WindTruth(),
    WindTruth(angle_deg=0.0, speed_mps=3.1),
    WindTruth(angle_deg=48.4, speed_mps=2.9),
    WindTruth(angle_deg=77.9, speed_mps=3.6),
)


def shown_rpm(command: int) -> float:
    return float(2 * 60 / (2 * np.pi) * RotorTruth().steady_rad_per_s(np.array(command), volts=3.7))


def blown(
    folder: Path,
    wind: WindTruth,
    *,
    volts: float = 3.7,
    typed: int = 2,
    rate_hz: float = 1000.0,
    seed: int = 3,
    facts: RigFacts = MOUNT,
    resumes: str = "",
) -> Run:
    """Write a run as `cfid log wind` records it, in a wind that was read within 2 %."""
    record = climbed(COMMANDS, motors=(1, 2, 3, 4), battery=BatteryTruth(volts=volts), rate_hz=rate_hz, seed=seed)
    speed_sum = np.interp(record.time_s, record.tick_s, record.speed_rad_per_s.sum(axis=1))
    record.wrench[:, :3] += speed_sum[:, np.newaxis] * wind.drag_ns_per_rad + wind.body_n
    windy = wind.speed_mps > 0
    low, high = 0.98 * wind.speed_mps, 1.02 * wind.speed_mps
    setting = WindSetting(angle_deg=wind.angle_deg if windy else None, fan_v=8.0, min_mps=low, max_mps=high)
    counts = dict(zip(COLUMNS[1:7], np.rint(record.wrench * 1e6).astype(np.int64).T, strict=True))
    number = np.arange(1, len(speed_sum) + 1)
    told = typed if windy else 0
    motors = zip(("m1", "m2", "m3", "m4"), record.commands.astype(np.int64).T, strict=True)
    return made_run(
        folder,
        "wind",
        {
            "commands": {"t": BEGIN_S + record.command_time_s, **dict(motors)},
            "loadcell": {
                "t": BEGIN_S + record.time_s,
                **counts,
                **dict(zip(COLUMNS[7:], (number, 7 * number, record.status.astype(np.int64)), strict=True)),
            },
            "crazyflie": {
                "t": BEGIN_S + record.tick_s,
                "vehicle_ms": np.rint(1e3 * record.tick_s).astype(np.int64),
                "pm.vbat": np.round(record.volts, 3),
            },
            "readings": {
                "t": BEGIN_S + np.array([2.9, 5.9])[:told],
                "command": np.array(COMMANDS)[:told],
                "rpm": np.array([shown_rpm(command) for command in COMMANDS])[:told],
            },
        },
        facts_of={"loadcell": {"counts_per_n": 1e6, "counts_per_nm": 1e6}},
        started=datetime(2026, 11, 21, 8, int(10 * wind.speed_mps), tzinfo=UTC),
        facts=facts,
        requested={
            **{"steps": COMMANDS, "motors": (1, 2, 3, 4), "hold_s": 2.0, "rest_s": 1.0, "resumes": resumes},
            **setting.to_run(),
        },
    )


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    return new_campaign(tmp_path).folder


def texts(found: DragExperiments) -> list[str]:
    return [one.text for one in found.findings]


def test_all_runs_of_a_campaign_give_the_coefficients_that_act(campaign: Path, cfid: Cfid) -> None:
    runs = [blown(campaign, wind, seed=seed) for seed, wind in enumerate(WINDS)]
    result = drag.fit(runs)
    ended = cfid("fit", "drag", "--json", folder=campaign)

    true, simple = np.array(WINDS[0].kg_per_rad), result.quantities["drag.simple_kg_per_rad"]
    assert result.quality["experiments"] == 6
    assert np.all(np.abs(simple.value - true) < 3 * simple.std)
    assert np.all(simple.std < 0.1 * np.abs(true))
    assert not any("battery" in one.code for one in result.findings)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)["parameters"]["drag.simple_kg_per_rad"]["value"]
    assert found == pytest.approx(simple.value, rel=1e-9)


def test_runs_keep_yaw_azimuth_markers_and_sign_whatever_rig_toml_says_later(campaign: Path) -> None:
    facts = RigFacts(
        loadcell=LoadCellMount(yaw_deg=10.0, flip_fz=True),
        tachometer=Tachometer(markers=4),
        wind=WindStand(azimuth_deg=-60.0),
    )
    mounted = WindTruth(angle_deg=77.9, speed_mps=3.6, azimuth_deg=-60.0, yaw_deg=10.0)
    usual: list[Run] = []
    own: list[Run] = []
    for into, stated, wind in ((own, facts, mounted), (usual, MOUNT, WINDS[3])):
        into += [blown(campaign, WINDS[0], facts=stated), blown(campaign, wind, facts=stated)]
    found, of_thesis = drag.read_runs(own), drag.read_runs(usual)

    velocity, force = (np.mean(each, axis=0) for each in (found.velocity_mps, found.force_n))
    assert math.degrees(math.atan2(-velocity[1], velocity[0])) == pytest.approx(-60)
    assert -force[:2] @ velocity[:2] / np.linalg.norm(force[:2]) / np.linalg.norm(velocity[:2]) > 0.98
    assert found.speed_sum_rad_s * 2 == pytest.approx(of_thesis.speed_sum_rad_s)
    assert force[2] > 0 > of_thesis.force_n[:, 2].mean()


@pytest.mark.parametrize(
    ("stated", "lacks"),
    [
        (RigFacts(wind=WindStand(azimuth_deg=0.0), tachometer=Tachometer(markers=2)), "yaw"),
        (RigFacts(wind=WindStand(yaw_deg=0.0), tachometer=Tachometer(markers=2)), "azimuth"),
        (RigFacts(wind=WindStand(yaw_deg=0.0, azimuth_deg=0.0)), "markers"),
    ],
)
def test_a_mount_that_nothing_states_is_asked_for(campaign: Path, cfid: Cfid, stated: RigFacts, lacks: str) -> None:
    for wind in (WINDS[0], WINDS[3]):
        blown(campaign, wind, facts=stated)
    ended = cfid("fit", "drag", "--json", folder=campaign)

    assert (ended.returncode, lacks in ended.stderr) == (2, True)


def test_a_reading_that_was_not_typed_is_estimated_from_vibration(campaign: Path) -> None:
    found = drag.read_runs([blown(campaign, WINDS[0]), blown(campaign, WINDS[2], typed=0, rate_hz=2000.0)])

    assert any("estimated from vibration" in text for text in texts(found))
    true = [4 * RotorTruth().steady_rad_per_s(np.array(command), volts=3.7) for command in COMMANDS]
    assert found.speed_sum_rad_s == pytest.approx(true, rel=0.005)


def resumed(campaign: Path, *, first_typed: int) -> list[Run]:
    """Write a reference, a run in wind that ended at a prompt, and the run that completes it."""
    first = blown(campaign, WINDS[2], typed=first_typed)
    record = first.header.model_copy(update={"state": "interrupted"})
    write_header(first.folder, record)
    completing = blown(campaign, WINDS[2], resumes=first.folder.name, seed=4)
    return [blown(campaign, WINDS[0]), read_run(first.folder), completing]


@pytest.mark.parametrize("first_typed", [0, 1])
def test_a_command_whose_reading_was_typed_in_the_run_that_completes_it_is_taken_from_that_one(
    campaign: Path, first_typed: int
) -> None:
    runs = resumed(campaign, first_typed=first_typed)
    found = drag.read_runs(runs)

    assert sorted(found.command.tolist()) == [20000] * (1 + first_typed) + [40000]
    assert not any(one.code == "drag-rotor-speed-unknown" for one in found.findings)


@pytest.mark.parametrize("rows", [0, 1])
def test_a_part_that_ended_before_a_motor_turned_is_left_out_beside_the_run_that_completes_it(
    campaign: Path, rows: int
) -> None:
    reference, first, completing = resumed(campaign, first_typed=0)
    for device in ("commands", "readings"):
        file = first.device_file(device)
        lines = file.read_text().splitlines(keepends=True)
        file.write_text("".join(lines[: 1 + rows * (device == "commands")]))
    ended = {name: one.model_copy(update={"rows": None}) for name, one in first.header.devices.items()}
    write_header(first.folder, first.header.model_copy(update={"devices": ended}))
    found = drag.read_runs([reference, read_run(first.folder), completing])

    assert sorted(found.command.tolist()) == [20000, 40000]
    (left_out,) = (one.text for one in found.findings if one.code == "run-left-out")
    assert first.folder.name in left_out
    with pytest.raises(DataError):
        drag.read_runs([reference, read_run(first.folder)])  # which no other run completes


def test_a_command_of_an_interrupted_run_counts_as_recorded_once_its_reading_is_typed(campaign: Path) -> None:
    first = resumed(campaign, first_typed=1)[1]

    assert [run.command for run in recorded([first])] == [20000]


def test_a_command_without_a_reading_is_left_out_and_another_of_the_run_is_not(campaign: Path) -> None:
    found = drag.read_runs([blown(campaign, WINDS[0]), blown(campaign, WINDS[2], typed=1)])

    assert found.command.tolist() == [20000]
    assert "drag-rotor-speed-unknown" in {one.code for one in found.findings}


def test_what_is_no_run_in_wind_and_a_run_named_twice_are_refused(campaign: Path) -> None:
    other = write_run(campaign, climbed(COMMANDS), steps=COMMANDS)
    with pytest.raises(DataError, match="not a run of `cfid log wind` that states its wind"):
        drag.read_runs([other])
    (campaign / "some.csv").write_text("t,Fx\n")
    with pytest.raises(DataError, match="not a run folder"):
        drag.read_runs([campaign / "some.csv"])
    still, windy = blown(campaign, WINDS[0]), blown(campaign, WINDS[2])
    with pytest.raises(DataError, match=r"the same recording as .*: name each once"):
        drag.read_runs([still, windy, windy.folder])
