"""The commands of README and tutorials run from the first to the last, and print the numbers that the pages show."""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.main import get_command

from cfid.cli.main import app
from cfid.quantities.plausible import implausible
from cfid.quantities.registry import find, unit_of
from tests.lab import DATA, ROOT, run_cfid, sections_at, values_at
from tests.priority import ahead_of_others
from tests.processes import cfid_in_a_shell

# The changelog names what is gone.
PAGES = sorted([ROOT / "README.md", *{*(ROOT / "docs").rglob("*.md")} - {ROOT / "docs/changelog.md"}])
FIRST, REAL = ROOT / "docs/tutorial/first-campaign.md", ROOT / "docs/tutorial/real-recordings.md"
NOTEBOOK = ROOT / "docs/how-to/python.md"
README = ROOT / "README.md"

# Public recordings under the names that the pages give them.
RECORDINGS = {
    "pendulum.csv": "multiarm_pendulum/single_free_swing.csv",
    "arm.txt": "rotary_inverted_pendulum/pendulum_free_swing_data_01.txt",
    "steps.csv": "bitcraze_2021/cf21_stock2.csv",
    "ramp.csv": "bitcraze_2021/cf2.1-stock-prop.csv",
    "log10": "flights/eschmann_log10.usd",
    "log15": "flights/eschmann_log15.usd",
}
BLOCK = re.compile(r"^```(sh|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?")
MARK = "--- end of a block ---"


def play(page: Path, folder: Path) -> None:
    """Run a page's shell blocks in one shell, as a reader would, and compare what they print with what it shows."""
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    shell = [text for kind, text in blocks if kind == "sh"]
    environment = {**os.environ, "CFID_LOCKS": str(folder / "locks"), "COLUMNS": "80", "NO_COLOR": "1"}
    # A file rather than a pipe: no process that stays in the background can keep this waiting.
    with (
        (folder / "printed.txt").open("w+", encoding="utf-8") as file,
        cfid_in_a_shell() as programs,
        ahead_of_others(),
    ):
        code = subprocess.run(
            ["bash", "-c", "set -e\n" + f"\necho '{MARK}'\n".join(shell)],
            check=False,
            cwd=folder,
            env={**environment, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"},
            stdout=file,
            stderr=subprocess.STDOUT,
            timeout=900,
        ).returncode
        file.seek(0)
        text = file.read()
    assert code == 0, text[-3000:]
    printed = iter(alike(text, folder).split(f"{MARK}\n"))
    for kind, shown in blocks:
        if kind == "sh":
            output = next(printed)
            lines = iter(output.splitlines())
            continue
        for line in (alike(line, folder) for line in shown.splitlines() if line != "..."):
            assert any(agrees(line, other) for other in lines), f"not printed:\n{line}\nbut\n{output}"


def alike(text: str, folder: Path) -> str:
    """Return a text without what differs between runs: dates in names, the folder, and how wide columns are."""
    text = re.sub(r"\d{4}-\d\d-\d\d_\d{6}", "DATE", text.replace(str(folder), "..."))
    return "\n".join(" ".join(line.split()) for line in text.splitlines()) + "\n"


def agrees(shown: str, printed: str) -> bool:
    """Return whether a printed line agrees with a line of a page; ` ...` at its end stands for any text.

    Whole numbers and words are the same. Other numbers may differ by two of their last digit, or by one in two
    thousand, and a value by a fifth of its standard uncertainty. Files store times as Unix time, to a
    quarter of a microsecond, so a recording with the same seed is rounded differently at another hour.
    """
    shown = shown.rstrip()
    if shown.endswith(" ..."):
        shown = shown.removesuffix(" ...").rstrip()
        printed = printed[: len(shown)]
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return False
    numbers = NUMBER.findall(shown)
    rooms = [0.0] * len(numbers)
    if " ± " in shown:
        std = len(NUMBER.findall(shown.partition(" ± ")[0]))
        rooms[std - 1] = abs(float(numbers[std])) / 5
    return all(map(_near, numbers, NUMBER.findall(printed), rooms))


def _near(shown: str, printed: str, room: float) -> bool:
    if "." not in shown:
        return shown == printed
    mantissa, _, exponent = shown.partition("e")
    digit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return abs(float(shown) - float(printed)) <= max(2.01 * digit, room or 5e-4 * abs(float(shown)))


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which the first tutorial was played."""
    folder = tmp_path_factory.mktemp("tutorial")
    play(FIRST, folder)
    return folder


def test_all_that_the_first_tutorials_fits_find_is_as_the_registry_has_it(campaigns: Path) -> None:
    found = [(value.key, value.parameter) for path in campaigns.rglob("rig.toml") for value in values_at(path.parent)]

    assert len(found) > 40
    for key, parameter in found:
        assert find(key) is not None, key
        assert parameter.unit == unit_of(key), key
        assert implausible(key, parameter.value) == ""


def test_the_page_for_notebooks_runs_on_the_tutorials_campaign(
    campaigns: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = next(path.parent for path in sorted(campaigns.rglob("rig.toml")) if [*path.parent.glob("runs/*_sine_*")])
    monkeypatch.chdir(campaign.parent)
    blocks = re.findall(r"^```python\n(.*?)^```$", NOTEBOOK.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    for block in blocks:
        exec(block.replace('"cfid-demo"', f'"{campaign.name}"'), names)

    kept = sections_at(campaign)["inertia"].parameters["inertia.matrix_kg_m2"]
    assert len(blocks) > 5
    assert names["result"].accepted
    assert np.all(np.array(kept.value) == names["matrix"].value)
    assert (campaign.parent / "swing.csv").exists()


def test_the_fits_of_how_tos_run_on_the_tutorials_campaign(campaigns: Path) -> None:
    campaign = next(path.parent for path in sorted(campaigns.rglob("rig.toml")) if [*path.parent.glob("runs/*_sine_*")])
    ran = []
    for name in ("swing.md", "motors.md", "campaign.md"):
        for words in commands_of(ROOT / "docs/how-to" / name):
            ready = words[0] in ("fit", "tf", "status") and not re.search(r"\b[A-Z]{2}", " ".join(words))
            if ready and words not in ran:
                ended = run_cfid([*words, *(["--no-figures"] if words[0] != "status" else [])], campaign)
                assert ended.returncode == 0, f"{name}: cfid {' '.join(words)}: {ended.stderr}"
                ran.append(words)
    assert len(ran) > 8


def commands_of(page: Path) -> Iterator[list[str]]:
    """Yield the arguments of each command in a page's blocks and in its code within lines."""
    text = page.read_text(encoding="utf-8")
    blocks = "".join(re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    text = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    lines = [*blocks.splitlines(), *re.findall(r"^ {4,}(.*)$", text, re.MULTILINE)]
    for line in [*lines, *(" ".join(code.split()) for code in re.findall(r"`([^`]+)`", text))]:
        for part in re.split(r" && | \|\| | > | 2> | \| |  +#| &$", line):
            if part.startswith("cfid "):
                yield part.replace('"', "").split()[1:]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_names_only_commands_and_options_of_the_program(page: Path) -> None:
    root: Any = get_command(app)
    context = root.context_class(root, info_name="cfid")
    options = {word for parameter in root.params for word in (*parameter.opts, *parameter.secondary_opts)}
    for words in commands_of(page):
        command, rest = root, words
        while rest and hasattr(command, "commands") and re.fullmatch(r"[a-z]+", rest[0]):
            _, command, rest = command.resolve_command(context, rest)
        known = options | {word for one in command.params for word in (*one.opts, *one.secondary_opts)} | {"--help"}
        named = {word.rstrip(",)").partition("=")[0] for word in rest if re.match("--[a-z]", word)}
        assert named <= known, f"cfid {' '.join(words)}"


def test_the_readme_shows_of_the_demo_what_the_first_tutorial_plays() -> None:
    shown = re.search(r"^ +truth  measured\n(?: {4}.*\n)+", README.read_text(encoding="utf-8"), re.MULTILINE)
    assert shown is not None
    assert {line.removeprefix("    ") for line in shown[0].splitlines()} <= set(FIRST.read_text("utf-8").splitlines())


@pytest.mark.skipif(not DATA.exists(), reason="the public recordings are not here (CFID_DATA)")
@pytest.mark.parametrize("page", [README, REAL], ids=["README", "real recordings"])
def test_the_commands_on_public_recordings_print_what_the_page_shows(page: Path, tmp_path: Path) -> None:
    for name, place in RECORDINGS.items():
        shutil.copy(DATA / place, tmp_path / name)

    play(page, tmp_path)
