"""Finds and locks the encoder and the load cell, whichever kind rig.toml names."""

from contextlib import ExitStack

from cfid.errors import ConfigError
from cfid.records.rig_file import EncoderLines, EncoderPort, LoadCellBox, LoadCellLines
from cfid.rig import encoder, loadcell
from cfid.rig.hardware import Hardware
from cfid.rig.instrument import Say
from cfid.rig.text_lines import TextLines, ready_lines


def ready_encoder(
    setting: EncoderPort | EncoderLines,
    hardware: Hardware,
    held: ExitStack,
    *,
    counts_per_turn: float | str,
    say: Say,
) -> encoder.Encoder | TextLines:
    """Find and lock the encoder. Raises ConfigError or DeviceError."""
    if isinstance(setting, EncoderLines):
        return ready_lines("encoder", setting, hardware, held, say=say, counts_per_turn=counts_per_turn)
    return encoder.ready_encoder(setting, hardware, held, counts_per_turn=counts_per_turn, say=say)


def ready_loadcell(
    setting: LoadCellBox | LoadCellLines,
    hardware: Hardware,
    held: ExitStack,
    *,
    say: Say,
    buffered: bool = True,
    bias: bool = False,
    patient: bool = True,
) -> loadcell.LoadCell | TextLines:
    """Lock the load cell, set its rate and read its settings; without `patient` the run ends as its stream breaks off.

    Raises ConfigError or DeviceError.
    """
    if not isinstance(setting, LoadCellLines):
        return loadcell.ready_loadcell(setting, hardware, held, buffered=buffered, bias=bias, say=say, patient=patient)
    if bias:
        raise ConfigError("`bias`: only a Net F/T box has a bias; fits take the zero from pauses.")
    return ready_lines("loadcell", setting, hardware, held, say=say, patient=patient)
