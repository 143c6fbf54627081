"""Choose between models of one swing by BIC, and state how much the choice matters."""

import math

import numpy as np

from cfid.swing.model import TERMS, OutputError
from cfid.swing.uncertainty import inflation


def ranked_by_bic(fits: list[OutputError]) -> list[tuple[float, OutputError]]:
    """Sort by BIC. The effective number of samples is that of the best-fitting model's residual."""
    closest = min(fits, key=lambda fit: fit.sum_of_squares_rad2)
    count = len(closest.residual_rad)
    effective = max(count / inflation(closest.residual_rad, closest), len(TERMS) + 5)
    scored = [
        (effective * math.log(fit.sum_of_squares_rad2 / count) + _count(fit) * math.log(effective), i)
        for i, fit in enumerate(fits)
    ]
    return [(score, fits[i]) for score, i in sorted(scored)]


def _count(fit: OutputError) -> int:
    return sum(fit.free) + 2 * fit.eccentric + bool(fit.setup.spring_per_s2)


def spread_of_choices(ranked: list[tuple[float, OutputError]]) -> float:
    """Return how far W scatters over the choices of damping, each as likely as its BIC makes it [HMRV]."""
    likely = np.exp(-0.5 * np.array([score - ranked[0][0] for score, _ in ranked]))
    frequencies = np.array([fit.coefficients.natural_frequency_squared_s2 for _, fit in ranked])
    return float(np.sqrt(likely @ (frequencies - frequencies[0]) ** 2 / likely.sum()))
