"""Status words of both families: which bits are faults, and which are warnings."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cfid.wire.rdt_status import Family, family_of, read_status
from tests.wire.pieces import FEW

FAMILIES: tuple[Family, Family] = ("netft", "axia")
WARNING_BITS = {"netft": 1 << 16, "axia": 1 << 3 | 1 << 16 | 1 << 26 | 1 << 28}  # what the makers call no errors
SUMMARY = 1 << 31


@FEW
@given(word=st.integers(0, 2**32 - 1), family=st.sampled_from(FAMILIES))
def test_each_bit_of_any_word_is_one_fault_or_one_warning(word: int, family: Family) -> None:
    status = read_status(word, family)
    bits = word & ~SUMMARY
    assert len(set(status.faults + status.warnings)) == len(status.faults + status.warnings)
    assert len(status.warnings) == (bits & WARNING_BITS[family]).bit_count()
    assert len(status.faults) == (bits & ~WARNING_BITS[family]).bit_count() + (word == SUMMARY)


@pytest.mark.parametrize(
    ("product", "family"),
    [
        ("Net F/T", "netft"),
        ("Ethernet Axia80", "axia"),
        ("ETHERNET AXIA", "axia"),
        ("AXIA80-M20", "axia"),
        ("", "netft"),
    ],
)
def test_the_product_name_gives_the_family(product: str, family: Family) -> None:
    assert family_of(product) == family
