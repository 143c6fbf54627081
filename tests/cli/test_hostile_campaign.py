"""Every command on a terminal, in a campaign whose folder, rig and addresses have control sequences in their names."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cfid.cli.table import COMMANDS
from cfid.console.campaign import make_campaign
from cfid.records.campaign import open_campaign
from cfid.rig.sim_file import SIM_FILE
from tests.campaigns import LONGEST_S
from tests.offline.write import write_runs
from tests.processes import started
from tests.terminal import Terminal

pytestmark = pytest.mark.usefixtures("in_time")

EVIL = "\x1b]0;owned\x07\x1b]8;;\x9b31m\r\x85\u202e\u2028\x7f"
ESCAPED = "".join(f"\\u{ord(letter):04x}" for letter in EVIL)
OWN = re.compile(r"\x1b\[[\d;]*m|\a")  # cfid's colours, and the bell that calls the operator

STAIRS = ("--from", 20000, "--to", 20000, "--step", 10000, "--hold", 0.6, "--rest", 0.2)
RECORDINGS = {
    "log encoder",
    "log gyro",
    "log loadcell",
    "log thrust",
    "log speed",
    "log scales",
    "log ping",
    "log wind",
}

# With these arguments a command names the campaign, its runs or its rig; all others get a file that does not exist.
WORDS: dict[str, tuple[object, ...]] = {
    "demo": ("{folder}/demo", "--bogus"),
    "new": ("sub",),
    "show": ("last", "--terminal"),
    "watch": ("--port", 0),
    "report": (),
    "convert": ("{folder}/none.csv", "{folder}/none.ulg"),
    "status": (),
    "next": (),
    "parameters": (),
    "set": ("mass_kg", "0.03"),
    "fits": (),
    "fits drop": (1,),
    "fits repeat": (1,),
    "fleet": ("{folder}", "--details"),
    "fleet fit": ("{folder}", "--out", "refitted", "--jobs", 1),
    "export": ("list",),
    "runs": (),
    "runs exclude": ("last", "--because", EVIL),
    "runs include": ("last",),
    "runs note": ("last", EVIL),
    "rig check": (),
    "rig preflight": ("swing",),
    "log encoder": ("--axis", "x", "--for", 0.5),
    "log gyro": ("--axis", "x", "--for", 0.5),
    "log loadcell": ("--for", 0.5),
    "log thrust": STAIRS,
    "log speed": STAIRS,
    "log scales": STAIRS,
    "log sine": ("--periods", 2, "--samples", 100),
    "log ping": ("--count", 5),
    "log wind": ("--wind", "0,0", "--commands", 20000, "--hold", 0.5, "--rest", 0.2),
    "motors": (),
    "motors set": (20000, "--motor", 1, "--for", 0.3),
    "motors stop": (),
    "motors recover": (),
}


@pytest.fixture
def evil(tmp_path: Path, recordings: list[Any]) -> Iterator[Path]:
    """A campaign with control sequences in its names, and with a simulated rig."""
    folder = tmp_path / f"campaign{EVIL}"
    make_campaign(folder)
    rig = folder / "rig.toml"
    rig.write_text(rig.read_text().replace('name = "', f'name = "{ESCAPED}'))
    write_runs(open_campaign(folder), recordings[:3])
    places = {"TMPDIR": str(tmp_path), "CFID_LOCKS": str(tmp_path / "locks"), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    environment = os.environ | places | {"TERM": "xterm"}
    screen = Terminal(100)
    sim = start_on(screen, ("rig", "sim", "--axis", "x"), folder, environment)
    end_s = time.monotonic() + LONGEST_S
    while not (folder / SIM_FILE).exists() or "until this ends" not in screen.shown():
        assert time.monotonic() < end_s, screen.shown()
        time.sleep(0.05)
    where = folder / SIM_FILE
    where.write_text(
        re.sub(r'uri = "([^"]+)"', rf'uri = "\1/#{ESCAPED.replace(chr(92), chr(92) * 2)}"', where.read_text())
    )
    with pytest.MonkeyPatch.context() as patch:
        for name, place in (places | {"TERM": "xterm"}).items():
            patch.setenv(name, place)
        yield folder
    sim.send_signal(signal.SIGINT)
    sim.wait(LONGEST_S)
    assert not unprintable(screen.shown())
    screen.close()


def start_on(
    screen: Terminal, words: tuple[object, ...], folder: Path, environment: dict[str, str], **options: Any
) -> Any:
    return started(words, cwd=folder, env=environment, stdout=screen.file, stderr=screen.file, **options)


def unprintable(text: str) -> list[str]:
    """Return what a terminal would obey, in context, except colours, line ends and the status line's returns."""
    plain = OWN.sub("", text.replace("\r\n", "\n"))
    found = [place for place, letter in enumerate(plain) if not letter.isprintable() and letter not in "\n\r\a"]
    return [plain[max(place - 60, 0) : place + 20] for place in found]


def shown_by(name: str, folder: Path) -> str:
    """Run a command on a terminal and return what it showed; its questions get a yes, but that of `next` gets a no."""
    words = [str(word).format(folder=folder) for word in WORDS.get(name, ("{folder}/none.csv",))]
    screen = Terminal(100)
    process = start_on(screen, (*name.split(), *words), folder, dict(os.environ), stdin=subprocess.PIPE)
    process.stdin.write(b"n\n" if name == "next" else b"y\n" * 20)
    process.stdin.close()
    end_s, next_s = time.monotonic() + LONGEST_S, 0.0
    while process.poll() is None:
        assert time.monotonic() < end_s, screen.shown()
        if "Ctrl-C ends it" in screen.shown() and time.monotonic() > next_s:
            process.send_signal(signal.SIGINT)
            next_s = time.monotonic() + 2.0  # as an operator would, who waits for what the first one does
        time.sleep(0.02)
    shown = screen.shown()
    screen.close()
    return shown


def test_no_command_shows_what_the_names_of_a_campaign_would_have_a_terminal_do(evil: Path) -> None:
    shown = {}
    names = [name for name, (function, _) in COMMANDS.items() if function and name != "rig sim"]
    for name in sorted(names, key=lambda name: name != "fit swing"):  # first, since others show its result
        shown[name] = shown_by(name, evil)
        assert "Traceback" not in shown[name], (name, shown[name])
        assert not unprintable(shown[name]), (name, unprintable(shown[name]))

    assert {name for name in RECORDINGS if "recording into" in shown[name]} == RECORDINGS
    questions = " ".join(shown["log thrust"].split()), " ".join(shown["motors set"].split())
    assert all("/#?]0;owned??]8;;?31m?????: motor" in question for question in questions)
