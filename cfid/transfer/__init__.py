"""Identify the transfer function of motor and rotor, from command to thrust, from sine runs."""

from typing import TYPE_CHECKING

from cfid.lazy import attached

if TYPE_CHECKING:
    from cfid.transfer.data import read_sines as read_sines
    from cfid.transfer.result import fit as fit
    from cfid.transfer.result import verify as verify

__getattr__, __dir__ = attached(__name__, {"fit": "result", "read_sines": "data", "verify": "result"})
