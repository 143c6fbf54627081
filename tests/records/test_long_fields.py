"""A field or header of tens of kilobytes, as a damaged file has, is refused in a moment, whatever it is made of."""

import time
from pathlib import Path

import pytest

from tests.campaigns import Cfid

ROWS = "".join(f"{at / 100:.2f},{at}\n" for at in range(300))
SIGNS = ["1", "1,", "1.", "_", "a_", " ", "a ", "(", "a(", ".", '"', "\t", "-", ":", "a:1 ", "1 "]
LONG = 60_000
LONGEST_S = 4.0  # of computing: twenty times what it takes


def at_once(cfid: Cfid, path: Path, content: str) -> None:
    """Check that commands end within a moment with an exit code of theirs, and not with a traceback."""
    path.write_text(content)
    for words in (("show", path, "--no-figures"), ("fit", "thrust", "--table", path, "--no-figures")):
        begun_s = time.process_time()
        answer = cfid(*words)
        took_s = time.process_time() - begun_s
        assert answer.returncode in (0, 2, 4, 5)
        assert "Traceback" not in answer.stderr
        assert took_s < LONGEST_S, (words, took_s)


@pytest.mark.parametrize("sign", SIGNS)
def test_a_long_field_takes_no_longer_than_its_length(cfid: Cfid, tmp_path: Path, sign: str) -> None:
    field = sign * (LONG // len(sign))
    at_once(cfid, tmp_path / "a.csv", f"t_s,phi_rad\n{ROWS}3.00,{field}x\n{ROWS}")
    at_once(cfid, tmp_path / "b.csv", f"t_s;phi_rad\n{ROWS.replace(',', ';').replace('.', ',')}3,00;{field}x\n")


@pytest.mark.parametrize("sign", SIGNS)
def test_a_long_header_takes_no_longer_than_its_length(cfid: Cfid, tmp_path: Path, sign: str) -> None:
    name = sign * (LONG // len(sign))
    at_once(cfid, tmp_path / "a.csv", f"cmd,Thrust{name}\n{ROWS}")
    at_once(cfid, tmp_path / "b.csv", f"{name}\nt_s,phi_rad\n{ROWS}")
