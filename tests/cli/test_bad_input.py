"""Bad input gets a sentence that names the fault and the next step, an exit code, and never a traceback."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.lab import Cfid, new_campaign

Spoil = Callable[[list[str]], list[str]]


def refused(ended: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    assert ended.returncode == code, ended.stderr
    assert "Traceback" not in ended.stderr
    for word in words:
        assert word in ended.stderr
    assert '"value"' not in ended.stdout


def replaced(row: int, text: str) -> Spoil:
    return lambda lines: [*lines[:row], text, *lines[row + 1 :]]


def in_unit(head: str, factor: float) -> Spoil:
    """Return a function that rewrites an angle with another head, `factor` times the angle in rad."""

    def spoil(lines: list[str]) -> list[str]:
        rows = [line.split(",") for line in lines[1:]]
        angle = np.unwrap(np.radians([float(row[1]) for row in rows]))
        angle = factor * (angle - angle[-1])
        return [head, *(f"{row[0]},{value:.7f}" for row, value in zip(rows, angle, strict=True))]

    return spoil


# What spoils a swing, the exit code, and the option or the line that the message names.
CASES: dict[str, tuple[Spoil, int, str]] = {
    "a missing column": (replaced(0, "t,speed"), 2, "--columns"),
    "an angle without a unit": (in_unit("t,phi", 5.0), 2, "--unit phi=deg"),
    "degrees called radians": (in_unit("t,phi_rad", 180 / np.pi), 4, ""),
    "time going back": (lambda lines: [*lines[:900], *lines[500:]], 4, ":901:"),
    "fewer than four usable peaks": (lambda lines: lines[:3200], 4, ""),
    "prose": (lambda _: ["This is a letter.", "It has two lines."], 4, ""),
}


@pytest.mark.parametrize("case", CASES)
def test_a_swing_from(cfid: Cfid, files: Path, tmp_path: Path, case: str) -> None:
    spoil, code, named = CASES[case]
    path = tmp_path / "spoilt.csv"
    path.write_text("".join(line + "\n" for line in spoil((files / "x.csv").read_text().splitlines())))

    refused(cfid("fit", "swing", path, "--json"), code, named)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--mass-kg 0 --distance-m 0.02", "--mass-kg"),
        ("--mass-kg 0.03 --distance-m -0.02", "--distance-m"),
        ("--peaks 3", "4 peaks"),
    ],
)
def test_an_option_that_cannot_be_meant_is_named(cfid: Cfid, files: Path, options: str, named: str) -> None:
    refused(cfid("fit", "swing", files / "x.csv", *options.split(), "--json"), 2, named)


def test_a_swing_that_is_rejected_gives_no_number_unless_forced(cfid: Cfid, files: Path, tmp_path: Path) -> None:
    lines = (files / "x.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    time_s = np.array([float(row[0]) for row in rows])
    angle = np.unwrap(np.radians([float(row[1]) for row in rows]))
    shaken = angle + 0.02 * np.sin(45 * time_s)
    path = tmp_path / "shaken.csv"
    path.write_text("t,theta_rad\n" + "".join(f"{t:.6f},{a:.7f}\n" for t, a in zip(time_s, shaken, strict=True)))

    ended = cfid("fit", "swing", path, "--json")
    refused(ended, 5, "--force")
    assert '"accepted": false' in ended.stdout
    forced = cfid("fit", "swing", path, "--json", "--force")
    assert forced.returncode == 0
    assert '"accepted": false' in forced.stdout
    assert "swing.natural_frequency_squared_s2" in forced.stdout


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["diagonal=3.1e-5"], "no mount"),
        (["x=-3.1e-5"], "above zero"),
        (["x=3.1e-5:-1e-8"], "standard uncertainty"),
        (["--mass-kg", "-1", "x=3.1e-5"], "--mass-kg"),
        (["--gravity-mps2", "0", "x=3.1e-5"], "--gravity-mps2"),
        (["fixture=3e-8", "x=3.1e-5"], "[fixture]"),
    ],
)
def test_an_inertia_from_wrong_words_is_a_usage_error(cfid: Cfid, words: list[str], named: str) -> None:
    refused(cfid("fit", "inertia", *words, "--geometry", "thesis", "--json"), 2, named)


def test_a_run_outside_a_campaign_and_a_campaign_that_is_none_are_refused(cfid: Cfid, tmp_path: Path) -> None:
    refused(cfid("runs"), 2, "cfid new")
    refused(cfid("runs", "--campaign", tmp_path / "nowhere"), 2)
    (tmp_path / "empty").mkdir()
    refused(cfid("fit", "swing", tmp_path / "empty"), 4)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of Unix")
@pytest.mark.parametrize("words", [("fit", "swing"), ("show",), ("fit", "torque")])
def test_a_pipe_or_a_device_is_refused_and_not_read_for_ever(
    cfid: Cfid, tmp_path: Path, words: tuple[str, ...]
) -> None:
    new_campaign(tmp_path)
    os.mkfifo(tmp_path / "pipe.csv")
    for path in (tmp_path / "pipe.csv", Path("/dev/zero")):
        ended = cfid(*words, path)

        assert ended.returncode in (2, 4), ended.stderr
        assert "Traceback" not in ended.stderr
