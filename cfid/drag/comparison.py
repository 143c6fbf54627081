"""Which model of drag the experiments ask for: squared errors as the thesis has them, and winds left out.

The sum of squared errors falls with every coefficient that a model has. So each wind setting is predicted from all
others, once per model, and the simplest model is chosen that does so about as well as the best [HTF]. Since all
forces at a command share the error of its reference, that error is predicted along with them (best linear
unbiased prediction), for every model alike: otherwise whatever depends on the command alone would seem to be drag.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cfid.drag.estimation import DragFit, fit_drag, flat_rows, solve
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import COMPLEX, CROSS, SIMPLE, DragModel
from cfid.errors import FitError

Array = npt.NDArray[np.float64]

_FEWEST_SETTINGS = 3


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A model on trial: its fit, and for each wind setting left out (s,) how it was predicted.

    `surprise` is minus the log density of the forces measured there, in nats; `left_out_sse_n2` the sum of the
    squared errors.
    """

    fit: DragFit
    surprise: Array
    left_out_sse_n2: Array

    @property
    def model(self) -> DragModel:
        """The model."""
        return self.fit.model


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Candidates from the simplest on; `chosen` is the simplest within `margin` of the `best` one's mean surprise.

    `margin` is one standard error of that mean.
    """

    candidates: tuple[Candidate, ...]
    best: Candidate
    chosen: Candidate
    margin: float


class _LeftOut(NamedTuple):
    surprise: float
    sse_n2: float


def compare_models(
    experiments: DragExperiments, models: Sequence[DragModel] = (SIMPLE, CROSS, COMPLEX), *, weighted: bool = True
) -> Comparison:
    """Fit all models, leave out one wind setting after the other, and choose by the one-standard-error rule.

    `weighted` is how the candidates' own fits are found; prediction is always weighted by what is uncertain.

    Raises FitError for fewer than three settings, or when a model has too many unknowns for the experiments.
    """
    if experiments.settings < _FEWEST_SETTINGS:
        raise FitError(
            f"{experiments.settings} wind settings are too few to leave one out and judge between models: "
            f"{_FEWEST_SETTINGS} are needed."
        )
    ordered = sorted(models, key=lambda model: model.unknowns)
    candidates = tuple(_candidate(experiments, model, weighted=weighted) for model in ordered)
    best = min(candidates, key=lambda tried: float(tried.surprise.mean()))
    margin = float(best.surprise.std(ddof=1)) / math.sqrt(experiments.settings)
    within = (tried for tried in candidates if tried.surprise.mean() <= best.surprise.mean() + margin)
    return Comparison(candidates=candidates, best=best, chosen=next(within), margin=margin)


def _candidate(experiments: DragExperiments, model: DragModel, *, weighted: bool) -> Candidate:
    fit = fit_drag(experiments, model, weighted=weighted)
    left_out = _predictions(experiments, model)
    return Candidate(
        fit=fit,
        surprise=np.array([one.surprise for one in left_out]),
        left_out_sse_n2=np.array([one.sse_n2 for one in left_out]),
    )


def _predictions(experiments: DragExperiments, model: DragModel) -> list[_LeftOut]:
    """Leave out each setting in turn without fitting anew [Dub].

    With P = V^-1 - V^-1 X (X' V^-1 X)^-1 X' V^-1 of forces f = X k of covariance V, the errors of predicting some of
    them from all others are (P_ss)^-1 (P f)_s, and their covariance is (P_ss)^-1. Here P = G' G.
    """
    rows = flat_rows(experiments, model)
    errors = solve(experiments, model, rows).errors
    fitted = np.linalg.qr(errors.standardised(rows))[0]
    standardised = errors.standardised(np.eye(len(rows)))
    left = standardised - fitted @ (fitted.T @ standardised)
    residual = left @ experiments.force_n.reshape(-1)
    belongs = np.repeat(experiments.setting, 3)
    return [_left_out(left[:, belongs == setting], residual) for setting in range(experiments.settings)]


def _left_out(columns: Array, residual: Array) -> _LeftOut:
    precision, pulled = columns.T @ columns, columns.T @ residual
    error = np.linalg.solve(precision, pulled)
    log_precision = float(np.linalg.slogdet(precision)[1])
    density = (len(error) * math.log(math.tau) + float(error @ pulled) - log_precision) / 2
    return _LeftOut(density, float(error @ error))
