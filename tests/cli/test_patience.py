"""A command that takes long reports that it is still at work."""

import time

import pytest

from cfid.console.messages import patience


def test_a_command_that_goes_on_says_so_ever_more_rarely_and_nothing_after_its_end(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with patience(0.02):
        time.sleep(1.0)
    during = capsys.readouterr()
    time.sleep(0.3)

    assert during.out == ""
    assert 2 <= len(during.err.splitlines()) <= 6  # after 0.02, 0.04, ... 0.64 s
    assert all("still reading and computing" in line for line in during.err.splitlines())
    assert capsys.readouterr().err == ""
