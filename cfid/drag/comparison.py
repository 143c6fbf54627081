"""Fit all models of drag, choose the one that the experiments support, and check forces and fits.

The sum of squared errors falls with every coefficient that a model has. Therefore the model with the smallest Bayesian
information criterion is chosen [Sch]. Its likelihood has the covariance of the forces: all forces at a command share
the error of its reference, so that what depends on the command alone does not appear to be drag.
"""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.special import ndtri

from cfid.drag.estimation import DragFit, fit_drag, regressors
from cfid.drag.model import COMPLEX, CROSS, CROSS_MENDED, SIMPLE, DragExperiments
from cfid.drag.thesis import means_gain
from cfid.errors import ConfigError, FitError
from cfid.findings import Finding, rejection, warning

Array = npt.NDArray[np.float64]
Method = Literal["default", "thesis"]

UNEXPLAINED_LIMIT = 0.5  # sum of squared errors over sum of squared forces

_UNLIKELY = 6.0  # of the information criterion: strong evidence [KR]
_DRIVEN = 0.2  # cosine between all forces and all velocities, the limit
_ACROSS = 0.5  # the same across velocities: 30 degrees if there is no noise
# The part of v_x + v_y, in squares, that |v_xy| has to leave unexplained for the two to be distinguished.
_APART = 0.01
_OUTLIER = 5.0  # robust standard deviations
_GROSS = 0.5  # of the root mean square force: smaller residuals may be the model's own errors
_ROBUST_ROUNDS = 3
_LEAST_NOISE_N = 1e-6  # of a table that states no noise: less is rounding
_MOST_NAMES = 4

_KEYS = {"simple": "drag.simple_kg_per_rad", "cross": "drag.cross_coupling_kg_per_rad", "complex": "drag.complex.*"}


@dataclass(frozen=True, kw_only=True)
class DragModels:
    """The fits by the models' names `simple`, `cross`, `complex`, without models that are not determined.

    `bic` is each model's information criterion, without intercepts and parasitic terms; `chosen` is the name of the
    model with the smallest.
    """

    experiments: DragExperiments
    fits: Mapping[str, DragFit]
    bic: Mapping[str, float]
    chosen: str
    findings: tuple[Finding, ...]


def quantities_of(name: str) -> tuple[str, str]:
    """Return the patterns of all keys that the model `simple`, `cross` or `complex` provides."""
    return _KEYS[name], f"drag.*.{name}"


def fit_models(
    experiments: DragExperiments,
    *,
    method: Method = "default",
    mended: bool = False,
    intercepts: bool = False,
    parasitic: bool = False,
) -> DragModels:
    """Fit the simple, the cross-coupling and the complex model, and choose among those that are determined.

    The thesis method weights all forces equally, and uses the means of C.3.1 for the simple model unless intercepts or
    a parasitic term are fitted with it. `mended` uses |v_xy| in the cross-coupling model. The complex model has no
    intercepts: within one wind setting v, v^2 and 1 are constants too.

    Raises ConfigError for intercepts with a parasitic term, and FitError when not even the simple model is determined.
    """
    if intercepts and parasitic:
        raise ConfigError(
            "intercepts and a parasitic term are both constant throughout a wind setting and cannot be distinguished: "
            "choose one."
        )
    weighted = method != "thesis"
    gain = None if weighted or intercepts or parasitic else means_gain(experiments)
    simple = fit_drag(experiments, SIMPLE, weighted=weighted, gain=gain, intercepts=intercepts, parasitic=parasitic)
    fits, findings = {"simple": simple}, [*experiments.findings, *force_findings(experiments)]
    for name, model in (("cross", CROSS_MENDED if mended else CROSS), ("complex", COMPLEX)):
        constant = intercepts and model is not COMPLEX
        try:
            fits[name] = fit_drag(experiments, model, weighted=weighted, intercepts=constant, parasitic=parasitic)
        except FitError as error:
            findings.append(rejection("drag-not-determined", str(error), *quantities_of(name)))
    more = intercepts or parasitic
    bic = {name: (fit_drag(experiments, fit.model) if more else fit).bic for name, fit in fits.items()}
    chosen = min(bic, key=lambda name: bic[name])
    findings += outlying(experiments, fits[chosen])
    for name, fit in fits.items():
        findings += fit_findings(name, fit, experiments)
    findings += unlikely(fits, experiments) if weighted else ()
    return DragModels(experiments=experiments, fits=fits, bic=bic, chosen=chosen, findings=tuple(findings))


def force_findings(experiments: DragExperiments) -> list[Finding]:
    """Reject forces that cannot be drag, for example due to a wrong yaw, azimuth or sign."""
    findings = []
    for axes, part in (("x and y", slice(0, 2)), ("z", slice(2, 3))):
        force, velocity = experiments.force_n[:, part], experiments.velocity_mps[:, part]
        if np.sum(force * velocity) > _DRIVEN * np.linalg.norm(force) * np.linalg.norm(velocity):
            text = (
                f"along {axes} the forces have the direction of the vehicle's motion relative to the air, and would "
                "drive it: check yaw, azimuth, angle and the signs of force and velocity."
            )
            findings.append(rejection("drag-drives", text, "drag.*"))
    force, against = experiments.force_n[:, :2], -experiments.velocity_mps[:, :2]
    along = float(np.sum(force * against))
    leftward = float(np.sum(against[:, 0] * force[:, 1] - against[:, 1] * force[:, 0]))
    if abs(leftward) > _ACROSS * np.linalg.norm(force) * np.linalg.norm(against):
        degrees = math.degrees(math.atan2(leftward, along))
        text = (
            f"in x and y the forces point {abs(degrees):.0f} degrees {'left' if degrees > 0 else 'right'} of the wind "
            "that should cause them: check yaw and azimuth."
        )
        findings.append(rejection("drag-across-wind", text, "drag.*"))
    return findings


def outlying(experiments: DragExperiments, fit: DragFit) -> list[Finding]:
    """Reject forces that lie grossly, and beyond five robust standard deviations, off a model: were files exchanged?

    The residuals are those of a robust fit with the relative error of each setting's wind as an unknown that has the
    stated uncertainty. A standard deviation contains noise as large as the median residual shows, at least that stated,
    and the wind's, which is not as steady from run to run as one error.
    """
    rows, slopes = regressors(experiments, fit.model, parasitic=fit.parasitic, intercepts=fit.intercepts)
    length, settings = np.linalg.norm(rows, axis=0), np.arange(experiments.settings)
    moved = np.repeat(experiments.wind_relative_std, 3) * (slopes @ fit.values)
    wind = moved[:, np.newaxis] * (np.repeat(experiments.setting, 3)[:, np.newaxis] == settings)
    columns = np.hstack([rows / length, wind])
    prior = np.eye(len(columns.T))[len(length) :]
    values = np.concatenate([fit.values * length, np.zeros(len(settings))])
    stated = np.hypot(experiments.force_std_n, experiments.reference_std_n)
    residual = fit.residual_n
    for _ in range(_ROBUST_ROUNDS):
        noise = np.empty_like(stated)
        for axes in (slice(0, 2), slice(2, 3)):
            ratio = np.abs(residual[:, axes] / stated[:, axes])
            unknowns = int(np.any(columns.reshape(*stated.shape, -1)[:, axes], axis=(0, 1)).sum())
            expected = float(ndtri(0.75)) * math.sqrt(max(ratio.size - unknowns, 1) / ratio.size)
            least = 1.0 if experiments.noise_known else _LEAST_NOISE_N
            noise[:, axes] = stated[:, axes] * max(float(np.median(ratio)) / expected, least)
        white = np.vstack([columns / noise.reshape(-1, 1), prior])
        force = np.concatenate([(experiments.force_n / noise).reshape(-1), np.zeros(len(settings))])
        values = _robust(white, force, values)
        residual = experiments.force_n - (columns @ values).reshape(-1, 3)
    std = np.hypot(noise, moved.reshape(-1, 3))
    distance = np.abs(residual / std).max(axis=1)
    usual = math.sqrt(np.mean(np.sum(experiments.force_n**2, axis=1)))
    gross = np.linalg.norm(residual, axis=1) > _GROSS * usual
    off = np.flatnonzero((distance > _OUTLIER) & gross)
    if not len(off):
        return []
    names = [experiments.names[row] for row in off[:_MOST_NAMES]]
    more = f" and {len(off) - len(names)} more" if len(off) > len(names) else ""
    worst = off[np.argmax(distance[off])]
    newtons = ", ".join(f"{value:z.4f}" for value in residual[worst])
    text = (
        f"{', '.join(names)}{more}: the force is off the {fit.model.name} model by more than {_OUTLIER:g} robust "
        f"standard deviations, in {experiments.names[worst]} by ({newtons}) N: is it the file of another run, or are "
        "its reference, angle and wind speed those of other files?"
    )
    return [rejection("drag-run-off", text, "drag.*")]


def _robust(rows: Array, data: Array, values: Array) -> Array:
    """Return the solution of rows (n, q) times values = data (n,), in which large residuals count little."""
    solution = least_squares(lambda v: rows @ v - data, values, jac=lambda _: rows, loss="cauchy")
    return np.asarray(solution.x)


def unlikely(fits: Mapping[str, DragFit], experiments: DragExperiments) -> list[Finding]:
    """Warn of fits that lack what the forces show: another one, or drag of the body beside the simple model, has it."""
    rivals, findings = [*fits.values()], []
    with suppress(FitError):
        rivals.append(fit_drag(experiments, SIMPLE, parasitic=True))
    likeliest = min(rivals, key=lambda fit: fit.bic)
    body = " with `parasitic` drag of the body" if likeliest.parasitic else ""
    for name, fit in fits.items():
        more = (len(fit.values) - len(likeliest.values)) * math.log(experiments.force_n.size)
        if (above := fit.bic - likeliest.bic) > max(_UNLIKELY, more):  # not by its number of coefficients alone
            text = (
                f"the {name} model lacks what the forces show: its information criterion is {above:.0f} above that of "
                f"the {likeliest.model.name} model{body} (limit {_UNLIKELY:g}): its coefficients are further off than "
                "stated."
            )
            findings.append(warning("drag-unexplained", text, *quantities_of(name)))
    return findings


def fit_findings(name: str, fit: DragFit, experiments: DragExperiments) -> list[Finding]:
    """Return the findings about the fit of the model `simple`, `cross` or `complex`."""
    findings = []
    part = fit.sse_n2 / float(np.sum(experiments.force_n**2))
    if part > UNEXPLAINED_LIMIT:
        text = (
            f"the {name} model leaves {100 * part:.0f} % of the forces' sum of squares unexplained (limit "
            f"{100 * UNEXPLAINED_LIMIT:.0f} %)."
        )
        findings.append(rejection("drag-unexplained", text, *quantities_of(name)))
    if fit.model is CROSS and abs(fit.value[2, 0]) > 2 * fit.std[2, 0]:
        text = (
            "kappa_4 as in equation 4.7 lifts when flying one way and sinks when flying the other, which no rotor does "
            "(section 4.5): the mended model takes |v_xy|."
        )
        findings.append(warning("drag-kappa4-sign", text, _KEYS["cross"]))
    return findings


def resolves_kappa_4(experiments: DragExperiments) -> bool:
    """Return whether the winds distinguish a force in v_x + v_y from one in |v_xy|, which requires two azimuths."""
    x, y, _ = experiments.velocity_mps.T * experiments.speed_sum_rad_s
    signed, unsigned = x + y, np.hypot(x, y)
    squares = float(signed @ signed) * float(unsigned @ unsigned)
    return bool(squares > 0 and 1 - float(signed @ unsigned) ** 2 / squares > _APART)
