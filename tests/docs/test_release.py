"""A release has one version, consistent Python versions, and a wheel that runs the README's tour."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from zipfile import ZipFile

import pytest

from cfid.rig.sim_file import SIM_FILE
from cfid.version import __version__
from tests.lab import ROOT
from tests.priority import ahead_of_others

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOW = (ROOT / ".github/workflows/check.yml").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")
INSTALLED = ("cfid", "firmware_patches", "pyproject.toml", "README.md", "LICENSE")
LONGEST_S, RIG_WITHIN_S = 1200.0, 60.0


def interpreters() -> list[Path]:
    """Return one interpreter of each supported version that is installed, sorted by version."""
    minor = int(PROJECT["requires-python"].rpartition(".")[2])
    pyenv = sorted(Path("~/.pyenv/versions").expanduser().glob("3.*/bin/python"))
    found = [str(path) for path in pyenv] + [shutil.which(f"python3.{each}") or "" for each in range(minor, 20)]
    versions: dict[str, Path] = {}
    for python in [sys.executable, *filter(None, found)]:
        words = [python, "-c", "import sys; print(*sys.version_info[:2], sep='.')"]
        version = subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
        if version.startswith("3.") and int(version[2:]) >= minor:
            versions.setdefault(version, Path(python))
    return [versions[each] for each in sorted(versions, key=lambda text: int(text[2:]))]


def tour() -> list[str]:
    """Return the arguments of each command that the README shows for one's own rig."""
    lines = README.partition("## On your rig")[2].partition("**Hardware.**")[0].splitlines()
    parts = [part.split() for line in lines for part in line.partition("#")[0].split("&&")]
    return [" ".join(words[1:]) for words in parts if words[:1] == ["cfid"]]


def test_the_citation_has_the_programs_version_and_licence() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")

    assert f"\nversion: {__version__}\n" in citation
    assert f"\nlicense: {PROJECT['license']}\n" in citation
    assert "title: System Identification of the Crazyflie 2.0 Nano Quadrocopter" in citation


def test_the_workflow_runs_the_checks_on_every_python_that_is_claimed() -> None:
    (matrix,) = re.findall(r"python: \[(.*)\]", WORKFLOW)
    claimed = [text.rpartition(" ")[2] for text in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d", text)]

    assert claimed
    assert set(claimed) <= set(re.findall(r"\d\.\d+", matrix))
    assert "bash .ci/run" in WORKFLOW


def test_completion_lists_commands_below_a_group() -> None:
    asked = {**os.environ, "COMP_WORDS": "cfid fit ", "COMP_CWORD": "2", "_CFID_COMPLETE": "complete_bash"}
    program = Path(sys.executable).with_name("cfid")
    ended = subprocess.run([program], env=asked, capture_output=True, text=True, check=True)

    assert {"swing", "friction", "inertia", "thrust"} <= set(ended.stdout.split())


@pytest.mark.slow
def test_the_tour_of_the_readme_runs_in_an_empty_environment_with_the_wheel(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for name in INSTALLED:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name)
    for python in interpreters():
        environment, lab = tmp_path / python.parts[-3], tmp_path / f"lab-{python.parts[-3]}"
        programs = environment / "bin"
        subprocess.run([python, "-m", "venv", environment], check=True)
        if not any(tmp_path.glob("*.whl")):
            subprocess.run([programs / "pip", "wheel", "-q", "--no-deps", "-w", tmp_path, source], check=True)
        (wheel,) = tmp_path.glob("*.whl")
        data = {f"cfid/{path.relative_to(ROOT / 'cfid')}" for path in (ROOT / "cfid").rglob("*") if path.is_file()}
        assert {name for name in data if not name.endswith((".py", ".pyc"))} <= set(ZipFile(wheel).namelist())
        subprocess.run([programs / "pip", "install", "-q", wheel], check=True)
        _walk(programs / "cfid", lab)
        print(f"{python.parts[-3]}: the tour's {len(tour())} commands ran")


def _walk(program: Path, lab: Path) -> None:
    """Run the tour at a simulated rig, in a demo campaign, since fits need more recordings than the tour's one."""

    def cfid(words: str, folder: Path) -> None:
        ended = subprocess.run(
            [program, *words.split()], cwd=folder, capture_output=True, text=True, check=False, timeout=LONGEST_S
        )
        assert ended.returncode == 0, f"cfid {words}: {ended.stdout}{ended.stderr}"

    cfid(f"demo {lab.name} --no-figures", lab.parent)
    shutil.rmtree(lab / "exports")  # the tour writes these files itself
    with (
        ahead_of_others(),
        subprocess.Popen([program, "rig", "sim", "--axis", "x"], cwd=lab, stderr=subprocess.DEVNULL) as rig,
    ):
        try:
            end_s = time.monotonic() + RIG_WITHIN_S
            while not (lab / SIM_FILE).exists() and time.monotonic() < end_s:
                time.sleep(0.1)
            for words in tour():
                cfid(f"{words} --for 14" if words.startswith("log") else words, lab)
        finally:
            rig.send_signal(signal.SIGINT)
    assert (lab / "report.html").exists()
