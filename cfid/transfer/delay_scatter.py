"""Estimate delays that differ from run to run, for example if the radio's shortest latency changes between them.

Such an error rotates a response by an angle that grows with its frequency and does not change its size; noise changes
both. Its standard deviation is chosen so that it explains the observed rotations (R. C. Paule, J. Mandel, Consensus
values and weighting factors, Journal of Research of the National Bureau of Standards 87, 1982).
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from cfid.findings import Finding, warning
from cfid.lazy import later
from cfid.transfer.frequency_response import Response
from cfid.transfer.likelihood import Found, Shape, StackedResponses, deviance, model_at, points_of, search
from cfid.transfer.model import Complex

_brentq = later("scipy.optimize", "brentq")  # imported only where delays scatter

Array = npt.NDArray[np.float64]

_BY_LUCK = 2.0  # standard deviations of chi-squared above which a scatter of delays is considered
_CLEARLY = 4.0  # the least decrease of the deviance
_ROUNDS = 3  # in which model and scatter are estimated alternately


def search_with_scatter(series: Sequence[Sequence[Response]], shape: Shape) -> tuple[StackedResponses, Found, float]:
    """Return the points of series, their parameters, and the scatter of their delays in s, zero unless significant."""
    points = points_of(series)
    found = search(points, shape)
    best = points, found, 0.0
    freedom = 2 * len(points.value) - len(found.values)
    if shape == "first" or found.cost <= freedom + _BY_LUCK * math.sqrt(2 * freedom):
        return best
    responses = [response for own in series for response in own]
    taken, before, scatter_s = len(found.values) - 1, deviance(points, found), 0.0
    for _ in range(_ROUNDS):
        scatter_s = delay_scatter_s(responses, model_at(points, found.values, shape), taken=taken)
        points = points_of(series, scatter_s=scatter_s)
        found = search(points, shape, polar=True)
    return (points, found, scatter_s) if deviance(points, found) + _CLEARLY < before else best


def delay_scatter_s(responses: Sequence[Response], model: Complex, *, taken: int) -> float:
    """Return the standard deviation in s of responses' (n,) delays about a model (n,), beyond known uncertainties.

    `taken` is the number of the model's parameters that were fitted to the phases.
    """
    value = np.array([own.value for own in responses])
    omega, size = np.array([own.frequency_rad_s for own in responses]), np.abs(value)
    across = np.stack([-value.imag, value.real], axis=1) / size[:, np.newaxis]
    late_s = np.angle(model / value) / omega
    noise = np.einsum("ni,nij,nj->n", across, np.array([own.covariance for own in responses]), across)
    known = noise / (omega * size) ** 2 + np.array([own.start_std_s for own in responses]) ** 2
    freedom = len(late_s) - taken

    def excess(variance: float) -> float:
        return float(np.sum(late_s**2 / (known + variance))) - freedom

    if freedom < 1 or excess(0.0) <= 0:
        return 0.0
    return math.sqrt(_brentq(excess, 0.0, float(np.sum(late_s**2)) / freedom))


def scatter_findings(scatter_s: float, keys: Sequence[str]) -> list[Finding]:
    """Return a warning about quantities `keys` where delays scatter."""
    text = (
        f"delays differ by {1e3 * scatter_s:.1f} ms from run to run (standard deviation), as where the radio's "
        "shortest latency wanders: the standard uncertainties contain it."
    )
    return [warning("transfer-delays-scatter", text, *keys)] if scatter_s else []
