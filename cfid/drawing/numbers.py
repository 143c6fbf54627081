"""Format numbers with their standard uncertainties for figures."""

import math

MICRO = 1e6  # of a unit
FIT_ALONE = "± leaves out", "instruments' errors"  # a row below numbers of a fit; a sheet's ± includes those errors

_ROOM = 19  # characters: six digits with their uncertainty


def plus_minus(value: float, std: float, *, unit: str = "") -> str:
    """Return a value and its standard uncertainty, both to the second digit of the latter if they fit."""
    return _plus_minus(value, std, unit).replace("-", "−")


def _plus_minus(value: float, std: float, unit: str) -> str:
    if not (math.isfinite(std) and math.isfinite(value) and std > 0):
        return f"{value:.5g} {unit}".rstrip()
    digits = max(1 - math.floor(math.log10(std)), 0)
    plain = f"{value:.{digits}f} ± {std:.{digits}f}"
    return f"{plain if len(plain) <= _ROOM else f'{value:.6g} ± {std:.1g}'} {unit}".rstrip()


def shortened(text: str, characters: int) -> str:
    """Return a text shortened in the middle, where names of runs differ least."""
    if len(text) <= characters:
        return text
    tail = (characters - 1) // 2
    return f"{text[: characters - 1 - tail]}…{text[-tail:]}"
