"""Repeat a fit through the Python interface, from what its file in fits/ states: command, method, runs and model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from cfid import drag, friction, inertia, latency, loadcell, swing, transfer
from cfid.errors import DataError
from cfid.motors import lag, maps, steps, vibration
from cfid.motors.lag.data import of_log
from cfid.motors.vibration.data import Rotors
from cfid.quantities.values import is_rows
from cfid.records.fits import Fit
from cfid.records.logs.run import log_of_run
from cfid.records.result import Result
from cfid.records.rig_file import Rig
from cfid.records.run import Run

Method = Literal["default", "thesis"]


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What a fit is made of: the kept fit, its runs, the rig, and the campaign's thrust over command, if it has one."""

    kept: Fit
    runs: Sequence[Run]
    rig: Rig
    thrust_poly: Sequence[float] | None = None
    method: Method | None = None  # in place of the kept fit's

    @property
    def _method(self) -> Any:
        found = self.method or self.kept.section.method
        if found not in get_args(Method):
            raise DataError(f"its method '{found}' is none of {', '.join(get_args(Method))}: fit it by hand.")
        return found

    @property
    def _order(self) -> dict[str, Any]:
        """The order of the map, from the length of its polynomial."""
        key = f"motor.{self.kept.name}_poly"
        found = self.kept.section.parameters.get(key)
        return {} if found is None else {"order": len(found.value) - 1}

    def fit(self) -> Result:
        """Fit again. Raises DataError for what cannot be repeated, and what the fit raises."""
        again = _AGAIN.get(self.kept.command)
        if again is None:
            raise DataError(f"`cfid {self.kept.command}` is not repeated from its file: fit it by hand.")
        return again(self)


def _inertia(recipe: Recipe) -> Result:
    swings = recipe.kept.quality.get("swings", ())
    known = [str(one.get("axis")) for one in swings if "known_kg_m2" in one] if is_rows(swings) else []
    if known:
        raise DataError(f"axis inertias of {', '.join(known)} were given as numbers: fit it by hand.")
    repeated = inertia.fit_testbody if recipe.kept.command == "fit testbody" else inertia.fit
    return repeated(recipe.runs, rig=recipe.rig, method=recipe._method)


def _thrust(recipe: Recipe) -> Result:
    gravity = recipe.rig.site.gravity_mps2
    return maps.fit_thrust(recipe.runs, gravity_mps2=gravity, method=recipe._method, **recipe._order)


def _speed(recipe: Recipe) -> Result:
    return maps.fit_speed(recipe.runs, rotors=Rotors(), method=recipe._method, **recipe._order)


def _dynamics(recipe: Recipe) -> Result:
    run = recipe.runs[0]
    return lag.fit(of_log(log_of_run(run))) if run.header.kind == "flight" else steps.fit(run)


def _transfer(recipe: Recipe) -> Result:
    model = {} if recipe.kept.section.method == "thesis" else recipe.kept.quality
    chosen: dict[str, Any] = {name: model[name] for name in ("shape", "form") if isinstance(model.get(name), str)}
    return transfer.fit(recipe.runs, method=recipe._method, thrust_poly=recipe.thrust_poly, **chosen)


def _drag(recipe: Recipe) -> Result:
    keys = " ".join(recipe.kept.section.parameters)
    return drag.fit(
        recipe.runs,
        rig=recipe.rig.facts,
        mended=recipe.kept.quality.get("kappa_4_times") == "|v_xy|",
        intercepts="drag.intercepts_n." in keys,
        parasitic="drag.parasitic_kg_per_m." in keys,
        method=recipe._method,
    )


_AGAIN: Mapping[str, Callable[[Recipe], Result]] = {
    "fit swing": lambda recipe: swing.fit(recipe.runs[0], rig=recipe.rig, method=recipe._method),
    "fit friction": lambda recipe: friction.fit(recipe.runs, rig=recipe.rig, method=recipe._method),
    "fit inertia": _inertia,
    "fit testbody": _inertia,
    "fit loadcell": lambda recipe: loadcell.fit(recipe.runs, gravity_mps2=recipe.rig.site.gravity_mps2),
    "fit thrust": _thrust,
    "fit speed": _speed,
    "fit torque": lambda recipe: maps.fit_torque(recipe.runs, method=recipe._method, **recipe._order),
    "fit rotor": lambda recipe: vibration.fit(recipe.runs[0]),
    "fit dynamics": _dynamics,
    "fit drag": _drag,
    "tf identify": _transfer,
    "tf latency": lambda recipe: latency.fit(recipe.runs),
}
