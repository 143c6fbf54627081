"""Faults of the simulated devices are set by words; a word that cannot be meant is refused."""

import re

import pytest

from cfid.errors import ConfigError
from cfid.sim.faults import (
    SOUND_CRAZYFLIE,
    SOUND_ENCODER,
    SOUND_LOADCELL,
    CrazyflieFaults,
    EncoderFaults,
    LoadCellFaults,
    parse_faults,
)


def test_words_name_faults_of_all_devices() -> None:
    encoder, loadcell, crazyflie = parse_faults(
        [
            "loadcell.drop_every=100",
            "encoder.split=true",
            "crazyflie.busy=true",
            "loadcell.status=0x80020000",
            "loadcell.silent_after_s=2.5",
            "crazyflie.tumble_after_s=3",
        ]
    )
    assert encoder == EncoderFaults(split=True)
    assert loadcell == LoadCellFaults(drop_every=100, status=0x80020000, silent_after_s=2.5)
    assert crazyflie == CrazyflieFaults(busy=True, tumble_after_s=3.0)
    assert parse_faults([]) == (SOUND_ENCODER, SOUND_LOADCELL, SOUND_CRAZYFLIE)


@pytest.mark.parametrize(
    "word",
    [
        "loadcell.dorp_every=3",
        "drop_every=3",
        "loadcell.drop_every=x",
        "loadcell.drop_every=1.5",
        "loadcell.drop_every=-1",
        "loadcell.slow_s=nan",
        "loadcell.slow_s=inf",
        "loadcell.status=0x1_0000_0000",
        "encoder.split=maybe",
        "encoder.split",
        "encoder.wrong_width=33",
        "crazyflie.tumble_deg=181",
    ],
)
def test_a_fault_that_cannot_be_is_told(word: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(word.partition("=")[0])):
        parse_faults([word])
