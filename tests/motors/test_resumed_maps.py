"""The verdict of a run that completes others agrees with that of the fit, which takes all parts together."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.errors import DataError, FitError
from cfid.motors.maps import fit_speed, fit_thrust
from cfid.motors.maps.data import Stand
from cfid.motors.maps.verdict import of_forces, of_readings
from cfid.recordings.vehicle import shown_at_commands
from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.records.run import DeviceRecord, Label, Run, amend_run, read_run, write_header
from cfid.records.run_writer import create_run
from tests.motors.stand_in_a_folder import BEGIN_S, climbed, write_run

COMMANDS = (0, 20000, 30000, 40000, 50000)


def felt(folder: Path, steps: tuple[int, ...], *, torque: float = 1.0, **requested: Any) -> Run:
    """Write a run with the load cell's record of some steps."""
    record = climbed(steps)
    record.wrench[:, 5] *= torque
    return write_run(folder, record, steps=steps, motors=[1, 3], hold_s=2.0, rest_s=1.0, **requested)


def interrupted(run: Run) -> str:
    """Mark a run as interrupted, and return its name."""
    write_header(run.folder, run.header.model_copy(update={"state": "interrupted"}))
    return run.folder.name


def typed(folder: Path, state: Any, rpm: Mapping[int, float], **requested: Any) -> Run:
    """Write a run with the speeds that an operator typed."""
    with create_run(
        folder / "runs",
        kind="speed",
        label=Label(),
        devices={"readings": DeviceRecord(file="readings.csv", columns=("t", "command", "rpm"))},
        started=datetime(2026, 11, 21, tzinfo=UTC),
        cfid_version="0",
        requested={"steps": list(rpm), "motors": [1], "hold_s": 2.0, "rest_s": 1.0, **requested},
    ) as writer:
        if rpm:
            columns = (np.array(list(rpm)), np.array(list(rpm.values())))
            writer.append("readings", (BEGIN_S + np.arange(len(rpm)), *columns))
        return writer.close(state)


def test_the_last_command_of_a_staircase_gives_a_map_together_with_the_run_that_it_completes(tmp_path: Path) -> None:
    first = interrupted(felt(tmp_path, COMMANDS[:3]))
    second = felt(tmp_path, COMMANDS[3:4], resumes=first)

    assert of_forces(second).endswith(f"mN. It gives a map together with {first}, which it completes.")
    assert fit_thrust([read_run(tmp_path / "runs" / first), second]).accepted


def test_parts_that_are_too_short_together_are_counted_together(tmp_path: Path) -> None:
    first = interrupted(felt(tmp_path, COMMANDS[:2]))
    second = felt(tmp_path, COMMANDS[2:3], resumes=first)
    short = (
        f" Too short for a map together with {first}, which it completes: `cfid fit thrust` takes at least 3 commands "
        "above 1000, from these runs and others, and here are 2."
    )
    assert of_forces(second).endswith(short)

    amend_run(read_run(tmp_path / "runs" / first), excluded="the cable touched")
    alone = of_forces(second)
    assert "Too short for a map of its own: `cfid fit thrust` takes at least 3 commands above 1000" in alone
    assert alone.endswith(" from this run and others, and here is 1.")


def test_the_torque_of_a_part_is_judged_together_with_that_of_the_run_that_it_completes(tmp_path: Path) -> None:
    first = interrupted(felt(tmp_path, COMMANDS[:4]))
    second = felt(tmp_path, COMMANDS[4:], torque=3.0, resumes=first)

    assert "Torque: `cfid fit torque` rejects it: " in of_forces(second)


def test_a_speed_that_was_typed_last_gives_a_map_with_the_run_that_it_completes(tmp_path: Path) -> None:
    first = typed(tmp_path, "interrupted", {20000: 11470.0, 25000: 13500.0})
    second = typed(tmp_path, "complete", {30000: 15300.0}, resumes=first.folder.name)

    assert of_readings(second).endswith(f" It gives a map together with {first.folder.name}, which it completes.")
    assert fit_speed([first, second], stand=Stand(markers=1)).accepted


def test_a_speed_that_the_fit_rejects_beside_those_before_is_of_no_use(tmp_path: Path) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())
    first = typed(tmp_path, "interrupted", {20000: 22940.0, 25000: 27000.0})
    second = typed(tmp_path, "complete", {30000: 30600.0}, resumes=first.folder.name)

    with pytest.raises(FitError, match=r"together with .*, which it completes: .*implausible"):
        of_readings(second)


def test_a_slip_in_a_speed_typed_before_is_named_with_its_command_and_its_run(tmp_path: Path) -> None:
    slipped = typed(tmp_path, "interrupted", {20000: 10000.0, 30000: 9000.0})
    rest = typed(tmp_path, "complete", {at: at / 2 for at in COMMANDS[3:]}, resumes=slipped.folder.name)

    with pytest.raises(FitError) as refused:
        of_readings(rest)
    assert f"together with {slipped.folder.name} (commands 20000 to 30000), which it completes: " in str(refused.value)
    assert "(rms, limit 5 %), most at command 30000: the points" in str(refused.value)


def test_a_part_without_a_reading_adds_nothing(tmp_path: Path) -> None:
    first = typed(tmp_path, "interrupted", {})
    second = typed(tmp_path, "complete", {30000: 15300.0}, resumes=first.folder.name)

    assert "Too short for a map of its own" in of_readings(second)


def shown(folder: Path, state: Any, held_s: Mapping[int, float], device: str, **requested: Any) -> Run:
    """Write a run with the readings of an instrument under commands held for `held_s`, where 4 s were requested.

    The instrument follows with a lag of 1 s: it shows half of the command in rpm, or the grams of a lifting vehicle.
    """
    column, scale, rest = {"tachometer": ("rpm", 0.5, 0.0), "scales": ("grams", -1e-4, 60.0)}[device]
    change_s = np.cumsum([0.0, *(one for held in held_s.values() for one in (6.0, held))])
    commands = np.array([0, *(one for step in held_s for one in (step, 0))], dtype=float)
    time_s = np.arange(0, change_s[-1] + 1, 0.1)
    value = np.zeros(len(time_s))
    for at in range(1, len(time_s)):
        driven = commands[np.searchsorted(change_s[1:], time_s[at], side="right")]
        value[at] = value[at - 1] + 0.1 * (scale * driven - value[at - 1])
    with create_run(
        folder / "runs",
        kind="speed" if device == "tachometer" else "scales",
        label=Label(),
        devices={
            "commands": DeviceRecord(file="commands.csv", columns=("t", "m1", "m2", "m3", "m4")),
            device: DeviceRecord(file=f"{device}.csv", columns=("t", column)),
        },
        started=datetime(2026, 11, 21, tzinfo=UTC),
        cfid_version="0",
        requested={"steps": list(held_s), "motors": [1], "hold_s": 4.0, "rest_s": 6.0, **requested},
    ) as writer:
        off = np.zeros(len(commands))
        writer.append("commands", (BEGIN_S + change_s, commands, off, off, off))
        writer.append(device, (BEGIN_S + time_s, rest + value))
        return writer.close(state)


@pytest.mark.parametrize("device", ["tachometer", "scales"])
@pytest.mark.parametrize("held_s", [0.3, 0.9, 3.0])
def test_an_instrument_counts_at_no_command_that_was_ended_and_is_held_again(
    tmp_path: Path, device: str, held_s: float
) -> None:
    first = shown(tmp_path, "interrupted", {20000: 4.0, 30000: 4.0, 40000: held_s}, device)
    second = shown(tmp_path, "complete", {40000: 4.0, 50000: 4.0}, device, resumes=first.folder.name)
    column = {"tachometer": "rpm", "scales": "grams"}[device]

    commands = [shown_at_commands(run, device, column)[1].tolist() for run in (first, second)]
    assert [[at for at in one if at] for one in commands] == [[20000, 30000], [40000, 50000]]


def test_an_instrument_that_showed_no_whole_command_is_not_blamed(tmp_path: Path) -> None:
    run = shown(tmp_path, "interrupted", {20000: 2.0}, "tachometer")

    with pytest.raises(DataError, match="no command was held to its end"):
        of_readings(run)
    with pytest.raises(DataError, match="no command was held to its end"):
        fit_speed(run)
