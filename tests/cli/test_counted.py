"""A count of one takes the singular."""

import pytest

from cfid.console.losses import counts_of
from cfid.counted import counted
from tests.campaigns import Cfid


@pytest.mark.parametrize(("count", "said"), [(0, "0 gaps"), (1, "1 gap"), (2, "2 gaps")])
def test_a_count_takes_the_singular_of_one_alone(count: int, said: str) -> None:
    assert counted(count, "gap") == said


def test_a_plural_that_is_more_than_an_s_is_given() -> None:
    assert counted(1, "frequency is", "frequencies are") == "1 frequency is"
    assert counted(2, "frequency is", "frequencies are") == "2 frequencies are"


def test_a_single_loss_of_each_kind_is_in_the_singular() -> None:
    kinds = {"malformed_datagrams": 1, "garbled_replies": 1, "late": 1, "duplicates": 2, "device_errors": 0}

    said = " (1 malformed datagram, 1 garbled reply, 1 late, 2 duplicates, 1 gap)"
    assert counts_of({"kinds": kinds, "gaps": 1}) == said


def test_a_series_of_one_sine_is_rehearsed_as_one(cfid: Cfid) -> None:
    assert cfid("new", "lab").returncode == 0
    said = cfid("log", "sine", "--l", 1, "--dry-run", "--campaign", "lab").stdout

    assert "1 sine of " in said
