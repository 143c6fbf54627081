"""The C sources under test, compiled with strict warnings that count as errors."""

import shutil
import subprocess
from pathlib import Path

import pytest

from cfid.sim.app_core import find_source

HERE = Path(__file__).parent
STRICT = ("-std=c11", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-pedantic")
SANITISED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def program(driver: str, folder: Path, *flags: str) -> Path:
    """Compile a driver of this folder with the core, and return the program."""
    compiler, core = shutil.which("gcc"), find_source()
    if compiler is None:
        pytest.skip("there is no gcc to compile the app's core with")
    made = folder / Path(driver).stem
    sources = [str(HERE / driver), str(core)]
    subprocess.run(
        [compiler, *STRICT, *flags, f"-I{core.parent}", "-o", str(made), *sources, "-lm"],
        check=True,
    )
    return made
