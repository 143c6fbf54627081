"""`cfid log` as an operator sees it: options, labels, where output goes, and the live line."""

import contextlib
import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import pytest

from cfid.records.files import RIG_FILE
from cfid.records.rig_file import new_rig_text
from cfid.records.run import Run
from tests.rig_in_a_folder import Command, Lab, lab_in

pytestmark = pytest.mark.usefixtures("in_time")

Cfid = Callable[..., subprocess.CompletedProcess[str]]

BOTH = pytest.mark.parametrize("device", ["encoder", "loadcell"])
COLUMNS = 80


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with lab_in(tmp_path) as lab:
        yield lab


# Arguments


@pytest.mark.parametrize("words", [("log", "loadcell"), ("rig", "sim")])
def test_a_command_of_the_rig_needs_a_campaign(cfid: Cfid, words: tuple[str, ...]) -> None:
    said = cfid(*words)

    assert said.returncode == 2
    assert said.stderr.startswith("cfid: no rig.toml here or above: `cfid new DIR` makes a campaign")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("encoder --axis q", "--axis q: rig.toml has no such mount of the crazyflie; it has x, y, z, xy, xz, yz."),
        ("encoder --axis y --body testbody", "--axis y: rig.toml has no such mount of the testbody; it has x, z."),
        ("encoder --axis x --weight 50", "--axis is for a swing and --weight for a dropping weight: give one of them."),
        ("encoder --weight 0", "--weight 0: has to be above zero, a number alone or with its standard uncertainty"),
        ("loadcell --pull z --weight 5 --at-mm 1,2:3", "--at-mm 1,2:3: should be three numbers, as in 46,0,0, or with"),
        ("encoder --for 0", "--for 0: has to be above zero."),
        ("loadcell --for=-1", "--for -1: has to be above zero."),
        ("loadcell --for nan", "--for nan: has to be above zero."),
        ("encoder --rate-hz 0", "--rate-hz 0: has to be above zero."),
        ("loadcell --rate-hz 0", "Invalid value for '--rate-hz'"),
    ],
)
def test_an_option_that_cannot_be_meant_so_is_told_before_anything_is_opened(
    cfid: Cfid, tmp_path: Path, words: str, told: str
) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())

    said = cfid("log", *words.split())

    assert said.returncode == 2
    assert told in said.stderr
    assert said.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == [RIG_FILE]


# What the run states


@pytest.mark.parametrize(
    ("words", "kind", "label"),
    [
        ("encoder --axis x --note first", "swing", {"axis": "x", "body": "crazyflie", "note": "first"}),
        ("encoder --axis z --body testbody", "swing", {"axis": "z", "body": "testbody"}),
        ("encoder --weight 50:0.1", "drop", {"weight_g": 50.0, "weight_std_g": 0.1}),
        ("encoder", "encoder", {}),
        (
            "loadcell --pull -z --weight 50 --at-mm 46,0,0:0.3",
            "loadcell",
            {"weight_g": 50.0, "pull": "-z", "at_mm": (46.0, 0.0, 0.0), "at_std_mm": 0.3},
        ),
        ("loadcell --body fixture --note empty", "loadcell", {"body": "fixture", "note": "empty"}),
    ],
)
def test_labels_stand_in_the_run(lab: Lab, words: str, kind: str, label: dict[str, object]) -> None:
    said = lab.cfid("log", *words.split(), "--for", 0.3)
    header = lab.run().header

    assert said.code == 0
    assert header.kind == kind
    assert header.label.model_dump(exclude_none=True) == label
    assert not header.simulated
    assert header.state == "complete"
    assert header.reason == ""


def test_a_continuous_encoder_is_recorded_and_then_quiet(lab: Lab) -> None:
    said = lab.cfid("log", "encoder", "--continuous", "--for", 0.5)

    assert said.code == 0
    assert list(rows_of(lab.run(), "encoder").columns) == ["t", "phi"]
    assert lab.facts("encoder")["asked"] == "continuous"
    assert not lab.e201.continuous


def test_a_load_cell_is_biased_and_sends_singly_when_asked_to(lab: Lab) -> None:
    said = lab.cfid("log", "loadcell", "--bias", "--real-time", "--for", 0.5)
    rows = rows_of(lab.run(), "loadcell")

    assert said.code == 0
    assert lab.facts("loadcell")["asked"] == "real-time"
    assert lab.facts("loadcell")["biased"]
    assert lab.facts("loadcell")["settings"]["buffer_size"] == 1
    assert abs(rows["Fz"].iloc[:20].mean()) < 5e5  # half a newton; the cell's own offset is 1.4 N
    assert lab.facts("loadcell")["settings"]["bias"] == list(lab.box.box.bias_counts)
    assert any(lab.box.box.bias_counts)


def test_a_bias_that_the_box_does_not_show_is_told(lab: Lab) -> None:
    lab.loadcell_suffers(refuse_settings=True)
    lab.box.box.buffer_size = 1  # already the requested value, so that nothing else is set

    said = lab.cfid("log", "loadcell", "--bias", "--real-time", "--for", 0.3)

    assert said.code == 0
    assert "the box' page still shows the earlier bias. Check that the load reads zero now." in said.err


def test_a_box_with_rdt_off_is_told_by_check_and_switched_on_by_log(lab: Lab) -> None:
    lab.box.box.enabled = False

    checked = lab.cfid("rig", "check")
    said = lab.cfid("log", "loadcell", "--for", 0.3)

    assert checked.code == said.code == 0
    assert "RDT is off: `cfid log loadcell` switches it on" in checked.out
    assert "RDT, UDP" not in checked.out


def test_a_figure_is_drawn_when_asked_for(lab: Lab) -> None:
    said = lab.cfid("log", "loadcell", "--plot", "--for", 1)

    assert said.code == 0
    assert "figure: " in said.err
    assert (lab.run().folder / "loadcell_recording.png").stat().st_size > 10_000


def rows_of(run: Run, device: str) -> pd.DataFrame:
    return pd.read_csv(run.device_file(device))


# Where output goes


@BOTH
def test_json_is_one_object_on_stdout_and_nothing_else(lab: Lab, device: str) -> None:
    said = lab.cfid("log", device, "--json", "--for", 0.3)
    content = json.loads(said.out)

    assert said.code == 0
    assert content["run"] == str(lab.run().folder)
    assert content["state"] == "complete"
    assert content["devices"][device]["rows"] == lab.run().header.devices[device].rows
    assert content["devices"][device]["lost"] == 0
    assert said.err.startswith("recording into ")
    assert "\r" not in said.err


@pytest.mark.parametrize("closing", [">&-", "2>&-", ">&- 2>&-"])
def test_a_closed_stdout_or_stderr_costs_words_and_no_rows(lab: Lab, closing: str) -> None:
    closed = ("bash", "-c", f'exec "$@" {closing}', "closed")

    said = lab.start("log", "loadcell", "--for", 0.3, wrapper=closed).end()

    assert said.code == 0
    assert lab.run().header.state == "complete"


def test_a_reader_that_went_away_costs_words_and_no_rows(lab: Lab) -> None:
    reading, writing = os.pipe()
    log = lab.start("log", "loadcell", "--for", 0.3, stdout=writing)
    os.close(writing)
    os.close(reading)
    said = log.end()

    assert said.code == 1
    assert lab.run().header.state == "complete"


class Terminal:
    """A terminal, 80 columns wide by default, and everything that was shown on it."""

    def __init__(self, columns: int = COLUMNS) -> None:
        self.screen, self.end = pty.openpty()
        fcntl.ioctl(self.end, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        os.set_blocking(self.screen, False)
        self._shown = b""

    def shown(self) -> str:
        """Return everything that was shown so far; a program may wait for this before it shows more."""
        with contextlib.suppress(OSError):  # no data yet, or no writer any more
            while data := os.read(self.screen, 4096):
                self._shown += data
        return self._shown.decode("utf-8", "ignore")

    def hang_up(self) -> None:
        os.close(self.screen)

    def press(self, key: bytes) -> None:
        os.write(self.screen, key)

    def fill(self) -> None:
        """Write until the terminal accepts no more, since nobody reads its screen."""
        end = os.open(os.ttyname(self.end), os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
        with contextlib.suppress(BlockingIOError):
            while os.write(end, b"." * 512):
                pass
        os.close(end)


def started(lab: Lab, terminal: Terminal, *words: object) -> Command:
    lab.environment["TERM"] = "xterm"
    log = lab.start(*words, stderr=terminal.end)
    os.close(terminal.end)
    return log


def test_a_terminal_that_states_no_width_shows_the_line_in_80_columns(lab: Lab) -> None:
    terminal = Terminal(columns=0)
    log = started(lab, terminal, "log", "encoder")
    line = re.compile(r"\r +\d+\.\d s  [^\r]*0 lost  [1-9]\d* Hz[^\r]*")
    log.wait_until(lambda: len(line.findall(terminal.shown())) > 1, "a line")
    log.ask_to_end()
    terminal.hang_up()

    assert all(len(frame) < COLUMNS for frame in line.findall(terminal.shown()))


@BOTH
def test_a_terminal_shows_a_line_that_lives_and_never_wraps(lab: Lab, device: str) -> None:
    terminal = Terminal()
    log = started(lab, terminal, "log", device)
    reading = r" *-?[\d.]+ deg" if device == "encoder" else r"Fz +-?\d+ mN"
    line = re.compile(rf"\r +(\d+\.\d) s  {reading}  0 lost  [1-9]\d* Hz  [▁-█]+")
    log.wait_until(lambda: len(line.findall(terminal.shown())) > 3, "a line")
    said = log.ask_to_end()
    shown = terminal.shown()
    terminal.hang_up()
    times = [float(seconds) for seconds in line.findall(shown)]

    assert said.code == 0
    assert times == sorted(times)
    for text in shown.split("\r\n"):
        if "/runs/" not in text:  # a path is one word
            assert all(len(frame) < COLUMNS for frame in text.split("\r"))
    assert "Traceback" not in shown
    assert shown.endswith("\r\a")
    assert shown.rstrip("\r\a").rpartition("\r")[2].strip() == ""  # the live line is erased


@BOTH
def test_a_terminal_shows_how_long_a_device_is_silent_in_place_of_its_last_value(lab: Lab, device: str) -> None:
    terminal = Terminal()
    log = started(lab, terminal, "log", device)
    log.wait_until(lambda: re.search(r"0 lost  \d+ Hz", terminal.shown()), "a line")
    if device == "encoder":
        lab.encoder_suffers(silent_after_s=0)
    else:
        lab.loadcell_suffers(silent_after_s=0)
    log.wait_until(lambda: re.search(rf"{device}: no data [12]\.\d s", terminal.shown()), "its silence")
    silent = terminal.shown().rpartition("no data")[0].rpartition("\r")[2]
    if device == "encoder":
        lab.encoder_suffers()
    else:
        lab.loadcell_suffers()
    log.wait_until(lambda: re.search(r"(deg|mN)  ", terminal.shown().rpartition("no data")[2]), "a value again")
    log.ask_to_end()
    terminal.hang_up()

    assert not re.search(r"deg|mN", silent)


def test_a_sentence_stands_on_a_line_of_its_own_on_a_terminal(lab: Lab) -> None:
    terminal = Terminal()
    log = started(lab, terminal, "log", "loadcell")
    log.wait_until(lambda: re.search(r"0 lost  \d+ Hz", terminal.shown()), "a line")
    lab.box.box.status = 0x80010000
    log.wait_until(lambda: "threshold" in terminal.shown(), "a sentence")
    said = log.ask_to_end()
    shown = terminal.shown()
    terminal.hang_up()

    assert said.code == 0
    assert re.search(r"\r +\rnote: [^\r]*a threshold is latched [^\r]*\r\n", shown)


def test_a_terminal_that_hangs_up_ends_no_recording(lab: Lab) -> None:
    terminal = Terminal()
    log = started(lab, terminal, "log", "loadcell")
    log.wait_until(lambda: re.search(r"0 lost  \d+ Hz", terminal.shown()), "a line")
    terminal.hang_up()
    log.wait_for_rows(500)
    said = log.ask_to_end()

    assert said.code == 0
    assert lab.run().header.state == "complete"


@pytest.mark.parametrize("stopped_by", ["Ctrl-S", "nobody reads"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_terminal_that_takes_nothing_holds_up_no_recording(lab: Lab, stopped_by: str, number: signal.Signals) -> None:
    terminal = Terminal()
    if stopped_by == "nobody reads":
        terminal.fill()
    log = started(lab, terminal, "log", "loadcell")
    if stopped_by == "Ctrl-S":
        log.wait_until(lambda: re.search(r"0 lost  \d+ Hz", terminal.shown()), "a line")
        terminal.press(b"\x13")
    log.wait_for_rows(500)
    lab.box.box.status = 0x80010000  # a fault that has to be reported
    log.wait_for_rows(500)
    said = log.ask_to_end(number)
    terminal.hang_up()

    assert said.code == 0
    assert lab.run().header.state == "complete"
    assert lab.run().header.devices["loadcell"].lost == 0
    assert lab.facts("loadcell")["said"] == ["a threshold is latched"]


def test_a_terminal_that_goes_on_shows_what_was_said_meanwhile(lab: Lab) -> None:
    terminal = Terminal()
    log = started(lab, terminal, "log", "loadcell")
    log.wait_until(lambda: re.search(r"0 lost  \d+ Hz", terminal.shown()), "a line")
    terminal.press(b"\x13")
    lab.box.box.status = 0x80010000
    log.wait_for_rows(500)
    silent = "threshold" not in terminal.shown()
    terminal.press(b"\x11")
    log.wait_until(lambda: "threshold" in terminal.shown(), "a sentence")
    said = log.ask_to_end()
    terminal.hang_up()

    assert silent
    assert said.code == 0


def test_a_pipe_that_nobody_reads_holds_up_no_recording(lab: Lab) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while os.write(writing, b"." * 4096):
            pass
    os.set_blocking(writing, True)
    log = lab.start("log", "loadcell", "--for", 1, stderr=writing)
    os.close(writing)
    log.end()
    os.close(reading)

    assert lab.run().header.state == "complete"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("encoder --axis x --for 20", "would record the encoder into"),
        ("loadcell", "until Ctrl-C. Nothing was opened."),
        ("ping --count 200 --interval 0.05", "would record 200 pings into"),
        ("ping --yes", "would record 1000 pings into"),  # as version 0.1 accepted it
        ("thrust", "33 commands from 0 to 64000"),
        ("speed", "commands from"),
        ("scales", "17 commands from 0 to 64000"),
        ("sine --l 5,20", "min"),
    ],
)
def test_a_dry_run_says_what_would_be_done_and_opens_nothing(cfid: Cfid, tmp_path: Path, words: str, told: str) -> None:
    (tmp_path / RIG_FILE).write_text(new_rig_text())

    said = cfid("log", *words.split(), "--dry-run")

    assert said.returncode == 0, said.stderr
    assert told in " ".join(said.stdout.split())
    assert not (tmp_path / "runs").exists()


def test_the_live_line_counts_down_where_the_end_is_known(lab: Lab) -> None:
    terminal = Terminal()
    log = started(lab, terminal, "log", "loadcell", "--for", "1.5")
    log.wait_until(lambda: len(re.findall(r"\r +(\d\.\d) s left", terminal.shown())) > 2, "a line")
    log.end()
    left = [float(seconds) for seconds in re.findall(r"\r +(\d\.\d) s left  Fz", terminal.shown())]
    terminal.hang_up()

    assert 1.5 >= left[0] > left[-1]
    assert left == sorted(left, reverse=True)


@pytest.mark.parametrize(("words", "bells"), [((), 1), (("--quiet",), 0)])
def test_a_bell_calls_the_operator_at_the_end(lab: Lab, words: tuple[str, ...], bells: int) -> None:
    terminal = Terminal()
    log = started(lab, terminal, "log", "loadcell", "--for", "0.5", *words)
    log.end()
    shown = terminal.shown()
    terminal.hang_up()

    assert shown.count("\a") == bells
