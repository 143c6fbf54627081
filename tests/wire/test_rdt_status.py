"""Status words as text, for both families."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cfid.wire.rdt_status import Family, Status, family_of, read_status

FEW = settings(max_examples=200, deadline=None, derandomize=True)
MANY = settings(FEW, max_examples=100_000, suppress_health_check=list(HealthCheck))
FAMILIES: tuple[Family, Family] = ("netft", "axia")
WARNING_BITS = {"netft": 1 << 16, "axia": 1 << 3 | 1 << 16 | 1 << 26 | 1 << 28}

families = st.sampled_from(FAMILIES)
words = st.integers(0, 2**32 - 1)


def check_that_each_bit_is_told_once(word: int, family: Family) -> None:
    status = read_status(word, family)
    found = status.faults + status.warnings
    bits = word & 0x7FFFFFFF
    assert len(set(found)) == len(found)
    assert len(status.warnings) == (bits & WARNING_BITS[family]).bit_count()
    assert len(status.faults) == (bits & ~WARNING_BITS[family]).bit_count() + (word == 0x80000000)


@FEW
@given(word=words, family=families)
def test_each_bit_of_any_word_is_told_once(word: int, family: Family) -> None:
    check_that_each_bit_is_told_once(word, family)


@pytest.mark.slow
@MANY
@given(word=words, family=families)
def test_each_bit_of_very_many_words_is_told_once(word: int, family: Family) -> None:
    check_that_each_bit_is_told_once(word, family)


@pytest.mark.parametrize("family", FAMILIES)
def test_zero_is_healthy(family: Family) -> None:
    assert read_status(0, family) == Status((), ())


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("bit", range(31))
def test_a_single_bit_is_one_sentence_with_or_without_the_bit_that_sums_up(bit: int, family: Family) -> None:
    alone, summed_up = read_status(1 << bit, family), read_status(0x80000000 | 1 << bit, family)
    assert alone == summed_up
    assert len(alone.faults) + len(alone.warnings) == 1


@pytest.mark.parametrize("family", FAMILIES)
def test_the_bit_that_sums_up_is_alone_a_fault_without_a_name(family: Family) -> None:
    assert read_status(0x80000000, family) == Status(("an error without a name",), ())


def test_a_latched_threshold_is_a_warning_only() -> None:
    assert read_status(0x80010000, "netft") == Status((), ("a threshold is latched",))


def test_saturation_is_a_fault() -> None:
    assert read_status(0x80020000, "netft") == Status(("saturation, or the converter failed",), ())


def test_saturation_with_a_latched_threshold_is_a_fault_and_a_warning() -> None:
    status = read_status(0x80030000, "netft")
    assert status == Status(("saturation, or the converter failed",), ("a threshold is latched",))


@pytest.mark.parametrize(
    ("word", "fault"), [(0x88000000, "a gage is out of range"), (0xC0000000, "force or torque out of range")]
)
def test_an_axia_tells_what_is_out_of_range(word: int, fault: str) -> None:
    assert read_status(word, "axia") == Status((fault,), ())


@pytest.mark.parametrize(
    ("bit", "fault"),
    [
        (5, "supply of the analog board too low"),
        (20, "RDT failed"),
        (27, "the link to the transducer failed"),
        (30, "processor or memory failed"),
    ],
)
def test_a_net_ft_tells_what_failed(bit: int, fault: str) -> None:
    assert read_status(0x80000000 | 1 << bit, "netft") == Status((fault,), ())


@pytest.mark.parametrize("bit", [3, 16, 28])
def test_what_an_axias_maker_calls_no_error_is_a_warning(bit: int) -> None:
    status = read_status(1 << bit, "axia")
    assert status.faults == ()
    assert len(status.warnings) == 1


@pytest.mark.parametrize(
    ("product", "family"), [("Net F/T", "netft"), ("Ethernet Axia80", "axia"), ("ETHERNET AXIA", "axia"), ("", "netft")]
)
def test_the_products_name_says_the_family(product: str, family: Family) -> None:
    assert family_of(product) == family


@pytest.mark.parametrize(("bit", "family"), [(0, "netft"), (15, "netft"), (4, "axia"), (17, "axia")])
def test_a_bit_that_no_table_has_is_told_by_its_number(bit: int, family: Family) -> None:
    assert read_status(1 << bit, family) == Status((f"status bit {bit}",), ())
