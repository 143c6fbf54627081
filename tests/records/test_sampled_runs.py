"""Runs of instruments that sample by themselves: gaps are reported, and a slow rate is no wrong unit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cfid.errors import DataError
from cfid.recordings.angle import angle_record
from cfid.recordings.read import read_recording
from cfid.recordings.wrench import AXES, wrench_of
from tests.lab import STARTED_S, made_run


def encoder(folder: Path, *, rate_hz: float = 100, **facts: Any) -> Path:
    columns = {"t": STARTED_S + np.arange(40) / rate_hz, "phi": np.arange(40)}
    facts_of = {"encoder": {"counts_per_turn": 8192.0, **facts}}
    return made_run(folder, "encoder", {"encoder": columns}, facts_of=facts_of).folder


def loadcell(folder: Path, *, rate_hz: float) -> Path:
    counts = dict(zip(AXES, np.arange(240).reshape(6, 40), strict=True))
    columns = {"t": STARTED_S + np.arange(40) / rate_hz, **counts}
    facts_of = {"loadcell": {"counts_per_n": 1e6, "counts_per_nm": 1e6}}
    return made_run(folder, "loadcell", {"loadcell": columns}, facts_of=facts_of).folder


def test_spans_in_which_an_encoder_gave_nothing_are_said(tmp_path: Path) -> None:
    reasons = ("no position came", "unplugged", "no position came")
    gaps = [
        {"from_s": STARTED_S + i, "to_s": STARTED_S + i + 0.5, "reason": reason} for i, reason in enumerate(reasons)
    ]
    folder = encoder(tmp_path, gaps=gaps)

    notes = angle_record(folder).notes

    assert f"{folder.name}: no samples for 1.5 s in 3 gaps: no position came, unplugged." in notes


def test_an_encoders_gap_that_makes_no_sense_is_refused_by_key(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"run.toml: devices.encoder.gaps.0.to_s is missing"):
        angle_record(encoder(tmp_path, gaps=[{"from_s": 1.0}]))


@pytest.mark.parametrize("rate_hz", [0.5, 7, 1000, 100_000])
def test_a_run_of_any_rate_is_in_seconds(tmp_path: Path, rate_hz: float) -> None:
    angle = angle_record(encoder(tmp_path / "a", rate_hz=rate_hz))
    wrench = wrench_of(read_recording(loadcell(tmp_path / "b", rate_hz=rate_hz)))

    assert angle.time_s[-1] == pytest.approx(39 / rate_hz, abs=1e-6)
    assert wrench.time_s[-1] == pytest.approx(39 / rate_hz, abs=1e-6)
    assert angle.notes == wrench.notes == ()
