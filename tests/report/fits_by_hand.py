"""Campaigns with fits made by hand, so that a report is tested without recording anything."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from cfid.findings import rejection, warning
from cfid.records.campaign import Campaign
from cfid.records.fits import Fit, keep_fit
from cfid.records.parameters import Parameter, Section, Source
from cfid.report.build import build
from tests.export.thesis_vehicle import (
    CROSS_KG_PER_RAD,
    DRAG_KG_PER_RAD,
    INERTIA_KG_M2,
    SPEED_POLY,
    THRUST_POLY,
    TORQUE_POLY,
)

NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)

_COMPLEX = {
    "k1": ([-8.9158e-7, -8.9158e-7, -3.1574e-7], "kg/rad"),
    "k2": ([-6.8572e-5, -6.8572e-5, 5.2068e-5], "kg/m"),
    "k3": ([1.1254e-10, 1.1254e-10, -2.3662e-10], "N s^2/rad^2"),
    "k4": ([-5.4233e-4, -5.4233e-4, -2.2935e-3], "kg/s"),
    "k5": ([-1.8443e-6, -1.8443e-6, 4.8857e-7], "N s/rad"),
    "k6": ([6.4061e-3, 6.4061e-3, 3.0985e-3], "N"),
}


def _near(value: Any) -> Any:
    """Return a standard uncertainty of one per cent in the value's shape; numbers that are exactly 0 or 1 have 0."""
    if isinstance(value, list):
        return [_near(item) for item in value]
    return 0.0 if value in (0.0, 1.0) else abs(value) / 100


def number(value: Any, unit: str = "", std: Any = "near") -> Parameter:
    return Parameter(value=value, std=_near(value) if std == "near" else std, unit=unit)


# The numbers of the thesis' appendix A, under the keys of the fits.
APPENDIX_A: Mapping[str, Mapping[str, Parameter]] = {
    "inertia": {"inertia.matrix_kg_m2": number(INERTIA_KG_M2, "kg m^2")},
    "thrust": {"motor.thrust_poly": number(THRUST_POLY, "N(cmd)")},
    "speed": {"motor.speed_poly": number(SPEED_POLY, "rad/s(cmd)")},
    "torque": {"motor.torque_poly": number(TORQUE_POLY, "Nm(N)")},
    "tf": {
        "tf.numerator": number([7.2345374e-8], "N"),
        "tf.denominator": number([1.0, -0.9695404], "1"),
        "tf.sample_time_s": number(0.002, "s", None),
        "tf.time_constant_s": number(0.06466, "s"),
        "tf.static_gain_n": number(2.375e-6, "N"),
        "tf.delay_s": number(-0.0271, "s"),
    },
    "drag": {
        "drag.simple_kg_per_rad": number(DRAG_KG_PER_RAD, "kg/rad"),
        **{f"drag.complex.{name}": number(value, unit) for name, (value, unit) in _COMPLEX.items()},
        "drag.cross_coupling_kg_per_rad": number(CROSS_KG_PER_RAD, "kg/rad"),
    },
}


def put(
    campaign: Campaign,
    name: str,
    parameters: Mapping[str, Parameter],
    *,
    sources: Sequence[str] = (),
    minutes: int = 0,
    rejected: str = "",
    warnings: Sequence[str] = (),
    method: str = "default",
    common: Mapping[str, Mapping[str, list[float]]] | None = None,
    **more: Any,
) -> Fit:
    """Keep a fit as a command does."""
    section = Section(
        method=method,
        found=NOON + timedelta(minutes=minutes),
        cfid_version="0.1.0",
        accepted=not rejected,
        sources=tuple(Source(f"runs/{source}/data.csv", source.encode().hex().zfill(64)) for source in sources),
        parameters=parameters,
        common=common or {},
        rejected=dict.fromkeys(parameters, rejected) if rejected else {},
    )
    command = more.pop("command", {"tf": "tf identify"}.get(name, f"fit {name.partition(' ')[0]}"))
    findings = (
        *(warning("of-the-test", text) for text in warnings),
        *([rejection("of-the-test", rejected)] if rejected else []),
    )
    fit = Fit(name=name, command=command, section=section, quality=more.pop("quality", {}), findings=findings, **more)
    return keep_fit(campaign.fits_folder, fit)


def put_appendix_a(campaign: Campaign) -> None:
    for name, parameters in APPENDIX_A.items():
        put(campaign, name, parameters, sources=[f"of_{name}"])


def report_of(campaign: Campaign) -> dict[str, Any]:
    return build(campaign, now=NOON + timedelta(days=1))
