"""How the program starts and ends: quickly, and with one sentence for an error."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.lab import Cfid

HEAVY = ("numpy", "scipy", "pandas", "matplotlib", "pydantic", "twisted", "serial", "cflib", "tomlkit")


def test_help_imports_nothing_heavy() -> None:
    words = "import sys\ntry:\n    from cfid.cli.main import app\n    app(['--help'])\nexcept SystemExit:\n    pass\n"
    words += f"print('loaded:', [name for name in {HEAVY} if name in sys.modules])"
    ended = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)

    assert ended.stdout.strip().endswith("loaded: []")


def test_a_fit_that_draws_nothing_does_not_wait_for_matplotlib() -> None:
    swings = [f"{axis}=3e-05:1e-07" for axis in ("x", "y", "z", "xy", "xz", "yz")]
    words = (
        "import sys\ntry:\n    from cfid.cli.main import main\n    main(sys.argv[1:])\nexcept SystemExit:\n    pass\n"
    )
    words += "print('loaded:', [name for name in ('matplotlib', 'cfid.inertia.result') if name in sys.modules])"
    command = [sys.executable, "-c", words, "fit", "inertia", *swings, "--geometry", "thesis", "--json"]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)

    assert ended.stdout.strip().endswith("loaded: ['cfid.inertia.result']"), ended.stderr


def test_an_error_is_one_sentence_on_stderr_and_nothing_on_stdout(cfid: Cfid) -> None:
    ended = cfid("fit", "swing", "missing.csv")

    assert ended.returncode == 4
    assert ended.stdout == ""
    assert ended.stderr == "cfid: missing.csv: no such file.\n"


def test_output_into_a_closed_pipe_is_no_traceback(files: Path) -> None:
    words = f"{sys.executable} -m cfid.cli.main fit swing {files / 'x.csv'} --no-figures --json | head -1"
    ended = subprocess.run(["bash", "-c", words], capture_output=True, text=True, check=False)

    assert "Traceback" not in ended.stderr
    assert ended.stdout == "{\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux that takes nothing")
@pytest.mark.parametrize("words", [("--help",), ("--version",), ("fit", "swing", "--help")])
def test_an_output_that_cannot_be_written_ends_in_a_sentence(words: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "cfid.cli.main", *words]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == 1
    assert ended.stderr == "cfid: the output cannot be written: No space left on device.\n"
