"""Damaged files and packets are read or refused, a few of each kind in every run of the tests."""

import pytest

from tests.nightly.fuzz import attack
from tests.nightly.readers import READERS, Reader


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_a_damaged_content_is_read_or_refused(reader: Reader) -> None:
    cases = 5 if reader.name == "MATLAB" else 20  # a process for each file
    assert attack(reader, cases=cases, seed=3) == ""
