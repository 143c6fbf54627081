"""Fit all models of drag, and find which of them the experiments support.

The sum of squared errors falls with every coefficient that a model has. Therefore each wind setting is predicted from
all others, once per model, and the simplest model is chosen that predicts about as well as the best [HTF]. Since all
forces at a command share the error of its reference, that error is predicted along with them (best linear unbiased
prediction), for every model alike: otherwise everything that depends on the command alone would appear to be drag.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.drag.checks import fit_findings, force_findings, quantities_of
from cfid.drag.estimation import DragFit, design, fit_drag, solve
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import COMPLEX, CROSS, CROSS_MENDED, SIMPLE, DragModel
from cfid.drag.thesis import means_gain
from cfid.errors import ConfigError, FitError
from cfid.findings import Finding, note, rejection, warning

Array = npt.NDArray[np.float64]
Method = Literal["default", "thesis"]

_FEWEST_SETTINGS = 3


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """A model's prediction of each wind setting that was left out (s,).

    `surprise` is minus the log density of the forces measured there, in nats; `sse_n2` is the sum of the squared
    errors.
    """

    model: DragModel
    surprise: Array
    sse_n2: Array


@dataclass(frozen=True, kw_only=True)
class ModelComparison:
    """Predictions from the simplest model on; `chosen` is the simplest within `margin` of the `best` mean surprise.

    `margin` is one standard error of that mean.
    """

    predictions: tuple[Prediction, ...]
    best: Prediction
    chosen: Prediction
    margin: float

    def of(self, model: DragModel) -> Prediction:
        """Return the prediction of a model."""
        return next(one for one in self.predictions if one.model is model)


@dataclass(frozen=True, kw_only=True)
class DragModels:
    """The fits by the models' names `simple`, `cross`, `complex`, without models that are not determined.

    `chosen` is the name of the model that the experiments support; `comparison` is None where the models cannot be
    compared.
    """

    experiments: DragExperiments
    fits: Mapping[str, DragFit]
    comparison: ModelComparison | None
    chosen: str
    findings: tuple[Finding, ...]


def fit_models(
    experiments: DragExperiments,
    *,
    method: Method = "default",
    mended: bool = False,
    intercepts: bool = False,
    parasitic: bool = False,
) -> DragModels:
    """Fit the simple, the cross-coupling and the complex model, and compare those that are determined.

    The thesis method weights all forces equally, and uses the means of C.3.1 for the simple model unless intercepts or
    a parasitic term are fitted with it. `mended` uses |v_xy| in the cross-coupling model.

    Raises ConfigError for intercepts with a parasitic term, and FitError when not even the simple model is determined.
    """
    if intercepts and parasitic:
        raise ConfigError(
            "intercepts and a parasitic term are both constant throughout a wind setting and cannot be distinguished: "
            "choose one."
        )
    fits, undetermined = fit_each(experiments, method=method, mended=mended, intercepts=intercepts, parasitic=parasitic)
    findings = [*experiments.findings, *force_findings(experiments), *undetermined]
    if intercepts and "complex" in fits:
        findings.append(note("drag-complex-no-intercepts", _NO_INTERCEPTS, *quantities_of("complex")))
    try:
        comparison = compare_models(experiments, [fit.model for fit in fits.values()])
    except FitError as error:
        comparison = None
        findings.append(warning("drag-models-not-compared", str(error), "drag.*"))
    for name, fit in fits.items():
        findings += fit_findings(name, fit, experiments)
    supported = SIMPLE if comparison is None else comparison.chosen.model
    chosen = next(name for name, fit in fits.items() if fit.model is supported)
    return DragModels(
        experiments=experiments, fits=fits, comparison=comparison, chosen=chosen, findings=tuple(findings)
    )


def fit_each(
    experiments: DragExperiments, *, method: Method, mended: bool, intercepts: bool, parasitic: bool
) -> tuple[dict[str, DragFit], list[Finding]]:
    """Return the fits of `fit_models` by name, and a rejection for each model that is not determined.

    Raises FitError when not even the simple model is determined.
    """
    weighted = method != "thesis"
    gain = None if weighted or intercepts or parasitic else means_gain(experiments)
    simple = fit_drag(experiments, SIMPLE, weighted=weighted, gain=gain, intercepts=intercepts, parasitic=parasitic)
    fits, findings = {"simple": simple}, list[Finding]()
    for name, model in (("cross", CROSS_MENDED if mended else CROSS), ("complex", COMPLEX)):
        constant = intercepts and model is not COMPLEX
        try:
            fits[name] = fit_drag(experiments, model, weighted=weighted, intercepts=constant, parasitic=parasitic)
        except FitError as error:
            findings.append(rejection("drag-not-determined", str(error), *quantities_of(name)))
    return fits, findings


_NO_INTERCEPTS = (
    "the complex model is fitted without intercepts: within one wind setting v, v^2 and 1 are constants too, which "
    "cannot be distinguished from an intercept."
)


def compare_models(
    experiments: DragExperiments, models: Sequence[DragModel] = (SIMPLE, CROSS, COMPLEX)
) -> ModelComparison:
    """Leave out one wind setting after the other, and choose by the one-standard-error rule.

    Raises FitError for fewer than three settings, or when a model has too many unknowns for the experiments.
    """
    if experiments.settings < _FEWEST_SETTINGS:
        raise FitError(
            f"{experiments.settings} wind settings are too few to leave one out and compare models: "
            f"{_FEWEST_SETTINGS} are needed."
        )
    ordered = sorted(models, key=lambda model: model.unknowns)
    predictions = tuple(_prediction(experiments, model) for model in ordered)
    best = min(predictions, key=lambda one: float(one.surprise.mean()))
    margin = float(best.surprise.std(ddof=1)) / math.sqrt(experiments.settings)
    within = (one for one in predictions if one.surprise.mean() <= best.surprise.mean() + margin)
    return ModelComparison(predictions=predictions, best=best, chosen=next(within), margin=margin)


def _prediction(experiments: DragExperiments, model: DragModel) -> Prediction:
    """Leave out each setting in turn without a new fit [Dub].

    With P = V^-1 - V^-1 X (X' V^-1 X)^-1 X' V^-1 for forces f = X k with covariance V, the errors of predicting some of
    them from all others are (P_ss)^-1 (P f)_s, and their covariance is (P_ss)^-1. Here P = G' G.
    """
    equations = design(experiments, model)
    errors = solve(equations).errors
    fitted = np.linalg.qr(errors.whitened(equations.rows))[0]
    white = errors.whitened(np.eye(len(equations.rows)))
    left = white - fitted @ (fitted.T @ white)
    residual = left @ equations.force_n
    setting = np.repeat(experiments.setting, 3)
    left_out = [_left_out(left[:, setting == one], residual) for one in range(experiments.settings)]
    return Prediction(
        model=model,
        surprise=np.array([one.surprise for one in left_out]),
        sse_n2=np.array([one.sse_n2 for one in left_out]),
    )


class _LeftOut(NamedTuple):
    surprise: float
    sse_n2: float


def _left_out(columns: Array, residual: Array) -> _LeftOut:
    precision, pulled = columns.T @ columns, columns.T @ residual
    error = np.linalg.solve(precision, pulled)
    log_precision = float(np.linalg.slogdet(precision)[1])
    density = (len(error) * math.log(math.tau) + float(error @ pulled) - log_precision) / 2
    return _LeftOut(density, float(error @ error))
