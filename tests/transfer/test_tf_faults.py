"""Invalid sine runs give a message with the next step and an exit code, never a traceback."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from cfid.records.run import DeviceRecord, Label
from cfid.records.run_writer import create_run
from tests.lab import new_campaign
from tests.offline.sine_bench import SimulatedSine
from tests.transfer.sines_in_a_folder import Here, Said, sines, write_index, write_run

Spoil = Callable[[Path], None]

PERIODS = (2, 5, 10, 20, 40)


@pytest.fixture(scope="module")
def runs() -> list[SimulatedSine]:
    return sines(PERIODS)


@pytest.fixture(scope="module")
def unspoilt(tmp_path_factory: pytest.TempPathFactory, runs: list[SimulatedSine]) -> Path:
    return write_index(tmp_path_factory.mktemp("sines"), {"": runs}, cells=1)


@pytest.fixture
def index(unspoilt: Path, tmp_path: Path) -> Path:
    shutil.copytree(unspoilt.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / unspoilt.name


def refused(ended: Said, code: int, *words: str) -> None:
    assert (ended.returncode, ended.stdout) == (code, ""), ended.stderr
    last = ended.stderr.splitlines()[-1]
    assert last.startswith("cfid: ")
    for word in words:
        assert word in last


def rewritten(name: str, change: Callable[[list[str]], list[str]]) -> Spoil:
    def spoil(folder: Path) -> None:
        path = folder / name
        path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")

    return spoil


def replaced(name: str, old: str, new: str) -> Spoil:
    return rewritten(name, lambda lines: [line.replace(old, new) for line in lines])


def swapped(folder: Path) -> None:
    one, other = (folder / f"crossings_{l}.csv" for l in (10, 20))  # noqa: E741
    first, second = one.read_text(), other.read_text()
    one.write_text(second)
    other.write_text(first)


FAULTS: dict[str, tuple[Spoil, int, str]] = {
    "an endless N": (replaced("index.csv", "10,2000", "10,1000000000"), 4, "would last 556 hours"),
    "two runs swapped": (swapped, 4, "were two runs swapped?"),
    "a load cell with a gap": (
        rewritten("cell_0.csv", lambda lines: lines[:2000] + lines[2400:]), 4, "does not cover the run"
    ),
    "a load cell that measured nothing": (
        rewritten("cell_0.csv", lambda lines: [lines[0], *(line.split(",")[0] + 6 * ",0" for line in lines[1:])]),
        5,
        "measured nothing",
    ),
    "crossings that are a load cell": (
        replaced("index.csv", "crossings_10.csv", "cell_0.csv"), 4, "cell_0.csv: no column of thrust_rec"
    ),
    "crossings back in time": (
        rewritten("crossings_10.csv", lambda lines: [*lines[:4], *lines[8:3:-1], *lines[9:]]), 4, "time goes back"
    ),
    "an l above N/2": (replaced("index.csv", "10,2000", "1001,2000"), 4, "index.csv:4: l is 1001"),
    "no such motor": (replaced("index.csv", "20000,1", "20000,5"), 4, "motor is 5"),
    "all motors about an arm": (replaced("index.csv", "20000,1", "20000,0"), 4, "use the channel Fz"),
    "a run by two names": (
        rewritten("index.csv", lambda lines: [*lines, lines[2].replace("crossings", "./crossings")]),
        4,
        "name each run once",
    ),
    "one frequency": (rewritten("index.csv", lambda lines: lines[:2]), 5, "1 frequency is too few"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_reported_by_both_methods(tf: Here, index: Path, fault: str) -> None:
    spoil, code, words = FAULTS[fault]
    spoil(index.parent)
    refused(tf("identify", "--index", index, "--no-figures"), code, words)
    by_thesis = tf("identify", "--index", index, "--method", "thesis", "--no-figures")
    assert by_thesis.returncode in (0, 4, 5)


def test_without_stamps_of_the_vehicle_a_cut_and_a_swap_are_found_too(
    tf: Here, tmp_path: Path, runs: list[SimulatedSine]
) -> None:
    index = write_index(tmp_path, {"": runs}, stamped=False)
    swapped(tmp_path)
    refused(tf("identify", "--index", index), 4, "were two runs swapped?")
    rewritten("crossings_20.csv", lambda lines: lines[:-5])(tmp_path)
    swapped(tmp_path)
    ended = tf("identify", "--index", index, "--no-figures")
    assert ended.returncode == 0, ended.stderr
    assert "(crossings_10.csv): the report of the end is missing" in ended.stderr


def test_a_channel_that_does_not_measure_the_motor_gives_no_numbers(tf: Here, index: Path) -> None:
    ended = tf("identify", "--index", index, "--channel", "Tx", "--no-figures")
    assert ended.returncode == 5
    assert "may be noise alone" in ended.stderr
    as_thesis = tf.json("identify", "--index", index, "--channel", "Tx", "--method", "thesis", code=5)
    assert "thesis-peak-elsewhere" in {one["code"] for one in as_thesis["findings"]}


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("", 2),
        ("missing", 4),
        ("crossings_2.csv", 4),
        ("--index missing.csv", 4),
        ("--index index.csv --arm-mm 0", 2),
        ("--index index.csv --yaw-deg nan", 2),
    ],
)
def test_invalid_options_are_refused(tf: Here, index: Path, words: str, code: int) -> None:
    refused(tf("identify", *words.split()), code)


def test_a_run_of_something_else_is_no_sine(tf: Here, tmp_path: Path, runs: list[SimulatedSine]) -> None:
    new_campaign(tmp_path)
    refused(tf("identify"), 2, "no complete sines")
    sine = write_run(tmp_path, runs[0])
    swing = create_run(
        tmp_path / "runs",
        kind="swing",
        label=Label(axis="x"),
        devices={"encoder": DeviceRecord(file="encoder.csv", columns=("t", "phi"))},
        started=sine.header.started,
        cfid_version="0",
    ).close("complete")
    refused(tf("identify", swing.folder), 4, "a run of swing, no sine: its run.toml states no l, n, amplitude, motor")
    (sine.folder / "crossings.csv").unlink()
    refused(tf("identify", sine.folder), 4, "crossings.csv: no such file.")


def hold_readings(folder: Path, interval_s: float) -> int:
    """Repeat each reading in the load cell's file for `interval_s`, and return the number of rows per reading."""
    (cell,) = folder.glob("cell*.csv")
    head, *lines = cell.read_text().splitlines()
    rows = round(interval_s / (float(lines[1].split(",")[0]) - float(lines[0].split(",")[0])))
    held = (lines[at - at % rows].partition(",")[2] for at in range(len(lines)))
    cell.write_text(
        "\n".join([head, *(f"{line.partition(',')[0]},{one}" for line, one in zip(lines, held, strict=True)), ""])
    )
    return rows


def test_readings_of_a_slow_load_cell_that_rows_repeat_count_once(tf: Here, index: Path) -> None:
    before = tf.json("identify", "--index", index, "--no-figures")
    rows = hold_readings(index.parent, 0.0125)
    after = tf.json("identify", "--index", index, "--no-figures")

    for name in ("tf.delay_after_quickest_s", "tf.time_constant_s", "tf.static_gain_n"):
        fast, held = (one["parameters"][name] for one in (before, after))
        assert held["value"] == pytest.approx(fast["value"], abs=3 * held["std"]), name
    codes = [{one["code"] for one in found["findings"]} for found in (before, after)]
    assert rows > 1
    assert ["sine-forces-repeated" in found for found in codes] == [False, True]


def test_sines_that_are_too_fast_for_a_slow_load_cell_are_left_out_by_name(tf: Here, index: Path) -> None:
    hold_readings(index.parent, 0.1)
    ended = tf("identify", "--index", index, "--no-figures", "--verbose")

    assert "Traceback" not in ended.stderr
    assert "10 samples of force a second are too few for a sine of" in " ".join(ended.stderr.split())
