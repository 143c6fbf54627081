"""Campaigns with fits made by hand, so that a report is tested without recording anything."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from cfid.findings import rejection, warning
from cfid.records.campaign import Campaign
from cfid.records.fits import Fit, keep_fit
from cfid.records.parameters import Parameter, Section, Source
from cfid.report.build import build

NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)

THESIS_MATRIX = [
    [16.571710e-6, 0.830806e-6, 0.718277e-6],
    [0.830806e-6, 16.655602e-6, 1.800197e-6],
    [0.718277e-6, 1.800197e-6, 29.261652e-6],
]
_COMPLEX = {
    "k1": ([-8.9158e-7, -8.9158e-7, -3.1574e-7], "kg/rad"),
    "k2": ([-6.8572e-5, -6.8572e-5, 5.2068e-5], "kg/m"),
    "k3": ([1.1254e-10, 1.1254e-10, -2.3662e-10], "N s^2/rad^2"),
    "k4": ([-5.4233e-4, -5.4233e-4, -2.2935e-3], "kg/s"),
    "k5": ([-1.8443e-6, -1.8443e-6, 4.8857e-7], "N s/rad"),
    "k6": ([6.4061e-3, 6.4061e-3, 3.0985e-3], "N"),
}
_CROSS = [
    [-10.2506e-7, -0.3177e-7, -0.4332e-7],
    [-0.3177e-7, -10.2506e-7, -0.4332e-7],
    [-7.7050e-7, -7.7050e-7, -7.5530e-7],
]


def _near(value: Any) -> Any:
    """Return a standard uncertainty of one per cent in the value's shape; numbers that are exactly 0 or 1 have 0."""
    if isinstance(value, list):
        return [_near(item) for item in value]
    return 0.0 if value in (0.0, 1.0) else abs(value) / 100


def number(value: Any, unit: str = "", std: Any = "near") -> Parameter:
    return Parameter(value=value, std=_near(value) if std == "near" else std, unit=unit)


# The numbers of the thesis' appendix A, under the keys of the fits.
APPENDIX_A: Mapping[str, Mapping[str, Parameter]] = {
    "inertia": {"inertia.matrix_kg_m2": number(THESIS_MATRIX, "kg m^2")},
    "thrust": {"motor.thrust_poly": number([2.130295e-11, 1.032633e-6, 5.484560e-4], "N(cmd)")},
    "speed": {"motor.speed_poly": number([0.04076521, 380.8359], "rad/s(cmd)")},
    "torque": {"motor.torque_poly": number([0.005964552, 1.563383e-5], "Nm(N)")},
    "tf": {
        "tf.numerator": number([7.2345374e-8], "N"),
        "tf.denominator": number([1.0, -0.9695404], "1"),
        "tf.sample_time_s": number(0.002, "s", None),
        "tf.time_constant_s": number(0.06466, "s"),
        "tf.static_gain_n": number(2.375e-6, "N"),
        "tf.delay_s": number(-0.0271, "s"),
    },
    "drag": {
        "drag.simple_kg_per_rad": number([-9.1785e-7, -9.1785e-7, -10.311e-7], "kg/rad"),
        **{f"drag.complex.{name}": number(value, unit) for name, (value, unit) in _COMPLEX.items()},
        "drag.cross_coupling_kg_per_rad": number(_CROSS, "kg/rad"),
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
