"""Make the figures of docs/explanation from simulated swings: `python docs/make_figures.py`."""

import functools
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cfid.drawing.save import save_figure
from cfid.sim.plants import HandRelease, Pendulum, swing
from cfid.swing.bias_figures import bias_figure, peaks_figure
from cfid.swing.estimation import fit_swing
from cfid.swing.figures import swing_figure
from cfid.swing.free_swing import FreeSwing, find_swing
from cfid.swing.thesis import fit_damped_cosine

Array = npt.NDArray[np.float64]

FIGURES = Path(__file__).parent / "explanation" / "figures"

# The pendulum whose damped-cosine fits come nearest to table 2.3's two rows for the x axis.
MOMENT_NM = 0.028 * 9.81 * 0.022855127980389874
INERTIA_KG_M2, VISCOUS, COULOMB, RELEASE_DEG = 3.0185e-5, 1.564e-5, 4.564e-5, 49.6
TABLE_2_3 = {8: 3.144988e-5, 11: 3.119770e-5}


@functools.cache
def record(degrees: float) -> tuple[Array, Array]:
    """Return time and angle, to a 13-bit encoder's steps, of the pendulum let go at an angle."""
    pendulum = Pendulum(
        axis_inertia_kg_m2=INERTIA_KG_M2,
        gravity_moment_nm=MOMENT_NM,
        viscous_nms_per_rad=VISCOUS,
        coulomb_nm=COULOMB,
    )
    release = HandRelease(angle_rad=math.radians(degrees), tremor_rad=0.0, wait_s=0.05, lift_s=0.3, hold_s=0.2)
    motion = swing([pendulum], [release], duration_s=9.0, step_s=1e-3, store_every=1)
    step = 2 * math.pi / 8192
    return motion.time_s, step * np.round(motion.angle_rad[:, 0] / step)


def swung(degrees: float, peaks: int | None = None) -> FreeSwing:
    """Return the free swing of a record."""
    return find_swing(*record(degrees), peaks=peaks)


def inertias(degrees: float, peaks: int | None = None) -> tuple[float, float]:
    """Return the axis inertia by the damped cosine and by the output-error fit."""
    found = swung(degrees, peaks)
    cosine = fit_damped_cosine(found).frequencies.natural_frequency_squared_s2
    return MOMENT_NM / cosine, MOMENT_NM / fit_swing(found).coefficients.natural_frequency_squared_s2


def main() -> None:
    """Write all figures."""
    degrees = np.arange(10.0, 71.0, 5.0)
    by_angle = np.array([inertias(angle) for angle in degrees]) / INERTIA_KG_M2 - 1
    amplitude = np.radians(degrees)
    theory = (1 + amplitude**2 / 16 + 11 * amplitude**4 / 3072) ** 2 - 1
    peaks = np.arange(4, len(swung(RELEASE_DEG).peak_time_s) + 1)
    by_peaks = np.array([inertias(RELEASE_DEG, int(count)) for count in peaks])
    FIGURES.mkdir(parents=True, exist_ok=True)
    for name, page in {
        "bias_against_amplitude": bias_figure(degrees, by_angle[:, 0], by_angle[:, 1], theory),
        "inertia_against_peaks": peaks_figure(peaks, by_peaks[:, 0], by_peaks[:, 1], INERTIA_KG_M2),
        "swing": swing_figure(swung(RELEASE_DEG), fit_swing(swung(RELEASE_DEG)), title="A simulated swing"),
    }.items():
        save_figure(page, FIGURES / name)
    for angle, (cosine, error) in zip(degrees, by_angle, strict=True):
        print(f"{angle:4.0f} degrees: damped cosine {100 * cosine:+6.2f} %, output error {100 * error:+8.4f} %")
    for count, (cosine, ours) in zip(peaks, by_peaks, strict=True):
        printed = f", table 2.3: {1e5 * TABLE_2_3[count]:.4f}" if count in TABLE_2_3 else ""
        print(f"{count:3d} peaks: damped cosine {1e5 * cosine:.4f}, output error {1e5 * ours:.4f} 1e-5 kg m^2{printed}")


if __name__ == "__main__":
    main()
