"""The cross-coupling model of drag (eq. 4.6, 4.7), and what the winds that there were cannot tell of it."""

from dataclasses import dataclass

import numpy as np

from cfid.drag.estimation import DragFit, fit_drag
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import CROSS, CROSS_MENDED

KAPPA_4 = "kappa_4"

_APART = 0.01  # part of v_x + v_y that |v_xy| does not explain, in squares, from where the two can be told apart


@dataclass(frozen=True, kw_only=True)
class CrossFit:
    """A cross-coupling fit; `unresolved` names coefficients whose meaning the winds left open, `warnings` say why.

    With the mended model the third row's equal entries are kappa_4 in f_z = speed_sum (kappa_4 |v_xy| + kappa_5 v_z).
    """

    fit: DragFit
    unresolved: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def mended(self) -> bool:
        """Whether kappa_4 multiplies |v_xy|."""
        return self.fit.model is CROSS_MENDED


def fit_cross(
    experiments: DragExperiments,
    *,
    mended: bool = False,
    weighted: bool = True,
    intercepts: bool = False,
    parasitic: bool = False,
) -> CrossFit:
    """Fit eq. 4.7; `mended` lets kappa_4 multiply |v_xy| instead of v_x + v_y.

    From one azimuth both are the same up to a factor, so nothing says which of them the air follows: kappa_4 is
    unresolved then, and good for winds from that azimuth alone. See `fit_drag` for the other options.

    Raises FitError when the winds do not tell the five coefficients apart.
    """
    model = CROSS_MENDED if mended else CROSS
    fit = fit_drag(experiments, model, weighted=weighted, intercepts=intercepts, parasitic=parasitic)
    warnings, unresolved = [], not resolves_kappa_4(experiments)
    if unresolved:
        warnings.append(
            "all side winds came from one azimuth (or two that look alike): kappa_4, the force in z from flying "
            "sideways, holds for that direction alone. Turn the vehicle or the wind generator and record again."
        )
    if not mended and abs(fit.value[2, 0]) > 2 * fit.std[2, 0]:
        warnings.append(
            "kappa_4 as in equation 4.7 lifts when flying one way and sinks when flying the other, which no rotor does "
            "(section 4.5): the mended model takes |v_xy|."
        )
    return CrossFit(fit=fit, unresolved=(KAPPA_4,) if unresolved else (), warnings=tuple(warnings))


def resolves_kappa_4(experiments: DragExperiments) -> bool:
    """Return whether the winds tell a force in v_x + v_y from one in |v_xy|, which takes two azimuths."""
    x, y, _ = experiments.velocity_mps.T * experiments.speed_sum_rad_s
    signed, unsigned = x + y, np.hypot(x, y)
    squares = float(signed @ signed) * float(unsigned @ unsigned)
    return bool(squares > 0 and 1 - float(signed @ unsigned) ** 2 / squares > _APART)
