"""Simulates the motors' supply: a constant voltage, or a lithium cell that sags under load and runs empty."""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from cfid.records.rig_file import Number, Positive, Spread
from cfid.sim.rotors import NOMINAL_V

_SECONDS_AN_HOUR = 3600


class BatteryTruth(BaseModel):
    """A `supply` holds `volts` under any load; the other keys apply to `lipo` only.

    `open_circuit_v` is the voltage of the unloaded cell at equal steps of charge, from empty to full; `charge` is the
    initial charge. The fraction `efficiency` of the electrical power reaches the rotors; `standby_a` is drawn in
    addition. The currents are near those in Bitcraze's table of the Crazyflie 2.0 (2015).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: Literal["supply", "lipo"] = "supply"
    volts: Positive = NOMINAL_V
    capacity_mah: Positive = 240.0
    charge: Annotated[Number, Field(ge=0, le=1)] = 1.0
    open_circuit_v: Annotated[tuple[Positive, ...], Field(min_length=2)] = (
        3.0, 3.45, 3.6, 3.68, 3.73, 3.77, 3.82, 3.89, 3.97, 4.07, 4.2,
    )  # fmt: skip
    resistance_ohm: Spread = 0.15
    standby_a: Spread = 0.24
    efficiency: Annotated[Number, Field(gt=0, le=1)] = 0.5


class Battery:
    """A supply or a cell; its voltage stays that of the last load until the next."""

    def __init__(self, truth: BatteryTruth) -> None:
        """Begin without a load."""
        self.charge = truth.charge
        self.at_most_v = math.inf  # a worn cell holds no more
        self._truth = truth
        self._steps = np.linspace(0, 1, len(truth.open_circuit_v))
        self._volts = truth.volts
        self.load(power_w=0.0, for_s=0.0)

    @property
    def volts(self) -> float:
        """The voltage under the present load."""
        return min(self._volts, self.at_most_v)

    def load(self, *, power_w: float, for_s: float) -> None:
        """Supply the rotors with `power_w` of mechanical power, drawn for the last `for_s` seconds.

        A cell that cannot supply it sags to half its voltage, where its power is largest.
        """
        truth = self._truth
        if truth.kind == "supply":
            return
        unloaded_v = float(np.interp(self.charge, self._steps, truth.open_circuit_v))
        unloaded_v -= truth.resistance_ohm * truth.standby_a
        drawn_w = power_w / truth.efficiency
        self._volts = (unloaded_v + math.sqrt(max(unloaded_v**2 - 4 * truth.resistance_ohm * drawn_w, 0.0))) / 2
        current_a = truth.standby_a + drawn_w / self._volts
        self.charge -= current_a * for_s / (truth.capacity_mah / 1000 * _SECONDS_AN_HOUR)
        self.charge = max(self.charge, 0.0)
