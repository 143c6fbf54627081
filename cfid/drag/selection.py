"""All models of drag fitted to one campaign's experiments, which of them is chosen, and what is to be said of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
import numpy.typing as npt

from cfid.drag.comparison import Comparison, compare_models
from cfid.drag.cross_coupling import CrossFit, fit_cross
from cfid.drag.estimation import DragFit, fit_drag
from cfid.drag.experiments import DragExperiments
from cfid.drag.model import COMPLEX, SIMPLE, DragModel
from cfid.drag.thesis import SimpleGroupings, group_simple
from cfid.errors import FitError

Array = npt.NDArray[np.float64]
Found = TypeVar("Found")
Method = Literal["default", "thesis"]

NO_INTERCEPTS = (
    "the complex model is fitted without intercepts: within one wind v, v^2 and 1 are constants too, and nothing tells "
    "them from an intercept."
)

MENDED = (
    "the cross-coupling model is the mended one: kappa_4, twice in the third row, multiplies |v_xy|; the matrix times "
    "v is not its force."
)


@dataclass(frozen=True, kw_only=True)
class DragChoices:
    """How drag is fitted: see `fit_drag` and `fit_cross`."""

    method: Method = "default"
    mended: bool = False
    intercepts: bool = False
    parasitic: bool = False

    @property
    def weighted(self) -> bool:
        """Whether forces count by what they are uncertain by."""
        return self.method != "thesis"


@dataclass(frozen=True, kw_only=True)
class DragResult:
    """The models' fits, None where the experiments do not tell one's coefficients apart.

    `simple_kg_per_rad` (3,) with deviations and covariance (3, 3) are those of the method: of the fit, or the means of
    C.3.1 (eq. 4.8), which `simple_residual_n` (n, 3) belongs to. `chosen` is the model's name.
    """

    experiments: DragExperiments
    simple: DragFit
    simple_kg_per_rad: Array
    simple_std_kg_per_rad: Array
    simple_covariance: Array
    simple_residual_n: Array
    cross: CrossFit | None
    complex_: DragFit | None
    groups: SimpleGroupings | None
    comparison: Comparison | None
    chosen: DragFit
    warnings: tuple[str, ...]

    @property
    def fits(self) -> dict[str, DragFit]:
        """The fits there are, by their keys in the contract of parameters."""
        cross = None if self.cross is None else self.cross.fit
        named = {"simple": self.simple, "cross": cross, "complex": self.complex_}
        return {name: fit for name, fit in named.items() if fit is not None}

    @property
    def sse_n2(self) -> dict[str, float]:
        """Sum of squared errors of each model, as C.3.1 defines it."""
        found = {name: fit.sse_n2 for name, fit in self.fits.items()}
        return {**found, "simple": float(np.sum(self.simple_residual_n**2))}


def fit_models(experiments: DragExperiments, choices: DragChoices) -> DragResult:
    """Fit the simple, the cross-coupling and the complex model, and judge between those that could be fitted.

    Raises FitError when not even the simple model's coefficients can be told apart.
    """
    said: list[str] = []
    more = {"weighted": choices.weighted, "parasitic": choices.parasitic}
    simple = fit_drag(experiments, SIMPLE, intercepts=choices.intercepts, **more)
    cross = _tried(lambda: fit_cross(experiments, mended=choices.mended, intercepts=choices.intercepts, **more), said)
    complex_ = _tried(lambda: fit_drag(experiments, COMPLEX, **more), said)
    groups = _tried(lambda: group_simple(experiments), said)
    if choices.intercepts and complex_ is not None:
        said.append(NO_INTERCEPTS)
    if cross is not None and cross.mended:
        said.append(MENDED)
    models = [fit.model for fit in (simple, cross and cross.fit, complex_) if fit]
    comparison = _tried(lambda: compare_models(experiments, models, weighted=choices.weighted), said)
    value, std, residual = simple.value, simple.std, simple.residual_n
    covariance = simple.value_covariance
    if choices.method == "thesis" and groups is not None:
        value, std, covariance = groups.value, groups.std, groups.covariance
        residual = experiments.force_n - _force_n(experiments, SIMPLE, SIMPLE.coefficients(value))
    result = DragResult(
        experiments=experiments,
        simple=simple,
        simple_kg_per_rad=value,
        simple_std_kg_per_rad=std,
        simple_covariance=covariance,
        simple_residual_n=residual,
        cross=cross,
        complex_=complex_,
        groups=groups,
        comparison=comparison,
        chosen=simple,
        warnings=(),
    )
    chosen = simple if comparison is None else _fit_of(result, comparison.chosen.model)
    return replace(
        result, chosen=chosen, warnings=(*said, *(cross.warnings if cross else ()), *_doubted(result, chosen))
    )


def _fit_of(result: DragResult, model: DragModel) -> DragFit:
    return next(fit for fit in result.fits.values() if fit.model is model)


def _doubted(result: DragResult, chosen: DragFit) -> list[str]:
    """Return the doubts about models that were not chosen; those about the chosen one decide on belief."""
    fits = {name: fit for name, fit in result.fits.items() if fit is not chosen}
    return [
        f"{name} model: {doubt}" for name, fit in fits.items() for doubt in fit.doubts if doubt not in chosen.doubts
    ]


def _force_n(experiments: DragExperiments, model: DragModel, coefficients: Array) -> Array:
    return model.force_n(
        coefficients, velocity_mps=experiments.velocity_mps, speed_sum_rad_s=experiments.speed_sum_rad_s
    )


def _tried(attempt: Callable[[], Found], said: list[str]) -> Found | None:
    try:
        return attempt()
    except FitError as error:
        said.append(str(error))
        return None
