"""What a truth file states about the simulated Crazyflie."""

from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from cfid.records.rig_file import Number, Spread

Platform = Literal["cf2", "cf21bl"]


def _current(firmware: object) -> object:
    if firmware in ("old", "thesis"):
        raise ValueError(
            "no firmware that cfid can reach has the modules of 2015: write app, whose ports and payloads are theirs, "
            "or stock"
        )
    return firmware


class CrazyflieTruth(BaseModel):
    """Firmware `app` includes cfid's app, `stock` no addition.

    Platform `cf2` is a Crazyflie 2.x, `cf21bl` a Crazyflie 2.1 Brushless: its motors report their speeds, 0 below
    `stall_rpm`, have idle thrust, and run only while armed. An `rpm_deck` measures speeds too. The vehicle was switched
    on `powered_for_s` before the rig opened; its clock counts 1 + `clock_skew` microseconds in a true one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    firmware: Annotated[Literal["app", "stock"], BeforeValidator(_current)] = "app"
    platform: Platform = "cf2"
    rpm_deck: bool = False
    stall_rpm: Spread = 60.0
    clock_skew: Annotated[Number, Field(gt=-1)] = 0.0
    powered_for_s: Spread = 100.0

    @property
    def brushless(self) -> bool:
        """Whether the motors are brushless."""
        return self.platform == "cf21bl"
