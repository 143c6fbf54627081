"""Damaged files and packets are read or refused, a few of each kind in every run of the tests."""

import pytest

from tests.nightly.fuzz import attack
from tests.nightly.readers import READERS, Reader


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.name)
def test_a_damaged_content_is_read_or_refused(reader: Reader) -> None:
    assert attack(reader, cases=20, seed=3) == ""
