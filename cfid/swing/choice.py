"""Choose between models of one swing by BIC, and estimate the effect of the choice."""

import math
from typing import NamedTuple

import numpy as np

from cfid.swing.free_swing import FreeSwing
from cfid.swing.model import TERMS, OutputError
from cfid.swing.uncertainty import inflation, shows_despite_friction, spring_beside

# A spring or an eccentricity stays in the model only if it exceeds this many standard uncertainties: noise causes
# smaller ones, which change W.
_TAKEN_STD = 5.0

Ranked = list[tuple[float, OutputError]]


class Choice(NamedTuple):
    """Models with their BIC, best first, and any that were better but have a part that noise may have caused."""

    ranked: Ranked
    with_spring: OutputError | None
    with_eccentricity: OutputError | None


def chosen(swing: FreeSwing, fits: list[OutputError]) -> Choice:
    """Choose by BIC; if the spring or eccentricity of the best may be noise, choose among the models without it."""
    ranked = ranked_by_bic(fits)
    with_spring = with_eccentricity = None
    for _ in range(2):
        best = ranked[0][1]
        if _weakly_sprung(swing, best):
            with_spring = best
            fits = [fit for fit in fits if not fit.setup.spring_per_s2]
        elif _weakly_eccentric(best, fits):
            with_eccentricity = best
            fits = [fit for fit in fits if not fit.eccentric]
        else:
            break
        ranked = ranked_by_bic(fits)
    return Choice(ranked, with_spring, with_eccentricity)


def _weakly_sprung(swing: FreeSwing, fit: OutputError) -> bool:
    if not (spring := fit.setup.spring_per_s2):
        return False
    shows_alone = spring >= _TAKEN_STD * spring_beside(swing, fit)[1]
    return not (shows_alone and shows_despite_friction(swing, fit, least_std=_TAKEN_STD))


def _weakly_eccentric(best: OutputError, fits: list[OutputError]) -> bool:
    if not best.eccentric:
        return False
    centred = min((fit.sum_of_squares_rad2 for fit in fits if not fit.eccentric), default=math.inf)
    return _effective(best) * math.log(centred / best.sum_of_squares_rad2) < _TAKEN_STD**2


def _effective(fit: OutputError) -> float:
    """Return the number of samples of white noise with the same information."""
    return max(len(fit.residual_rad) / inflation(fit.residual_rad, fit), len(TERMS) + 5)


def ranked_by_bic(fits: list[OutputError]) -> Ranked:
    """Sort by BIC. The effective number of samples is that of the best-fitting model's residual."""
    closest = min(fits, key=lambda fit: fit.sum_of_squares_rad2)
    count, effective = len(closest.residual_rad), _effective(closest)
    scored = [
        (effective * math.log(fit.sum_of_squares_rad2 / count) + _count(fit) * math.log(effective), i)
        for i, fit in enumerate(fits)
    ]
    return [(score, fits[i]) for score, i in sorted(scored)]


def _count(fit: OutputError) -> int:
    return sum(fit.free) + 2 * fit.eccentric + bool(fit.setup.spring_per_s2)


def spread_of_choices(ranked: Ranked) -> float:
    """Return the scatter of W over the choices of damping, weighted by the likelihood from their BIC [HMRV]."""
    likely = np.exp(-0.5 * np.array([score - ranked[0][0] for score, _ in ranked]))
    frequencies = np.array([fit.coefficients.natural_frequency_squared_s2 for _, fit in ranked])
    return float(np.sqrt(likely @ (frequencies - frequencies[0]) ** 2 / likely.sum()))
