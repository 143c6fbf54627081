"""Lists with commas, spans and measured numbers, as every option takes them."""

import pytest

from cfid.console.lists import comma_list, measured, span
from cfid.console.vehicle import motors_of
from cfid.errors import ConfigError
from cfid.sim.faults import parse_faults


def test_a_list_with_commas_may_have_spaces_and_be_repeated() -> None:
    assert comma_list("1, 2,4", "--commands", int, example="1,2") == (1, 2, 4)
    assert comma_list(["1,-0.97", "2e-3"], "--numerator", float, example="1") == (1.0, -0.97, 0.002)
    assert motors_of(["3,1", "1"], (2,)) == motors_of(["1", "3"], (2,)) == (1, 3)
    assert motors_of(None, (2,)) == (2,)
    assert motors_of(["0"], (1,), least=0) == (0,)


@pytest.mark.parametrize("text", ["", "1,", "1,x", "1.5", "0,1", "1,5", "1_0", "1;2"])
def test_a_list_of_something_else_is_refused_with_what_it_should_be(text: str) -> None:
    with pytest.raises(ConfigError, match=f"--motor {text}: should be whole numbers from 1 to 4 with commas between"):
        comma_list(text, "--motor", int, least=1, most=4, example="1,3")


def test_a_span_rises_from_zero_on() -> None:
    for text in ("0,4.5", "0:4.5"):  # the present form, and that of version 0.1
        assert span(text, "--window", unit="seconds", example="4,8") == (0.0, 4.5)
    for text in ("4", "4,4", "8,4", "-1,4", "1,2,3", "nan,4", "0,inf", "a,b"):
        with pytest.raises(ConfigError, match=f"--window {text}: should be FROM,TO in seconds"):
            span(text, "--window", unit="seconds", example="4,8")


def test_a_measured_number_may_have_a_standard_uncertainty() -> None:
    assert measured("0.23:0.001", "--distance-m") == (0.23, 0.001)
    assert measured("0.23", "--distance-m") == (0.23, None)
    assert measured(None, "--distance-m") == (None, None)
    for text in ("0", "-1", "0.2:", "0.2:0", "0.2:-1", "0.2:0.3", "0.2:1:2", "nan", "0.2:nan", "a", ":0.1", ""):
        with pytest.raises(ConfigError, match=f"--distance-m {text}: has to be above zero, a number alone or with"):
            measured(text, "--distance-m")


def test_faults_come_with_commas_or_one_by_one() -> None:
    together = parse_faults(["loadcell.drop_every=100,encoder.split=true"])

    assert together == parse_faults(["loadcell.drop_every=100", "encoder.split=true"])
    assert (together[0].split, together[1].drop_every) == (True, 100)
