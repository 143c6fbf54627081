"""One swing of 2500 samples: collocation against solve_ivp output error, and against a linear lmfit fit.

All three fit the same simulated record from the same rough guess; solve_ivp and collocation fit the same
model (viscous damping, zero, start state), lmfit the damped cosine of the thesis. Then a swing of two minutes at 1 kHz:
cfid's whole fit, with its nuisances and the budget, against one integration of the equation by solve_ivp.
"""

import math
import os
import statistics
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as in a command of cfid: the comparison is for one core

import lmfit
import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from cfid.sim.plants import HandRelease, Pendulum, swing
from cfid.swing.estimation import fit_swing
from cfid.swing.pendulum import first_guess, fit_output_error
from cfid.swing.window import find_swing

Array = npt.NDArray[np.float64]

SAMPLES, STEP_S = 2500, 0.004
INERTIA, MOMENT = 3.1e-5, 0.028 * 9.81 * 0.022855
NOISE_RAD = 5e-4
LONG_S = 121.0


def record() -> tuple[Array, Array]:
    pendulum = Pendulum(axis_inertia_kg_m2=INERTIA, gravity_moment_nm=MOMENT, viscous_nms_per_rad=1.2e-5)
    release = HandRelease(angle_rad=math.radians(40))
    motion = swing([pendulum], [release], duration_s=13.0, step_s=5e-4, store_every=8)
    begin = int(np.searchsorted(motion.time_s, release.free_s + 0.05))
    noise = np.random.default_rng(1).normal(0, NOISE_RAD, SAMPLES)
    time_s = motion.time_s[begin : begin + SAMPLES]
    return time_s - time_s[0], motion.angle_rad[begin : begin + SAMPLES, 0] + noise


def collocation(time_s: Array, angle: Array) -> float:
    coefficients, trajectory = first_guess(time_s, angle, start_s=0.0, step_s=STEP_S)
    values, free = np.array([*coefficients, 0.0, 0.0]), np.isin(np.arange(11), [0, 1, 4])
    fit = fit_output_error(time_s, angle, values=values, free=free, trajectory=trajectory)
    return fit.coefficients.natural_frequency_squared_s2


def output_error(time_s: Array, angle: Array) -> float:
    guess, trajectory = first_guess(time_s, angle, start_s=0.0, step_s=STEP_S)
    start = [guess[0], guess[1], guess[4], trajectory.angle_rad[0], trajectory.speed_rad_per_s[0]]

    def residual(p: Array) -> Array:
        def motion(_: float, y: Array) -> list[float]:
            return [y[1], -p[0] * math.sin(y[0] - p[2]) - p[1] * y[1]]

        found = solve_ivp(motion, (0, time_s[-1]), p[3:], t_eval=time_s, rtol=1e-7, atol=1e-9)
        return np.asarray(found.y[0] - angle)

    return float(least_squares(residual, start, x_scale=np.abs(start) + 1e-3).x[0])


def linear_lmfit(time_s: Array, angle: Array) -> float:
    def residual(p: lmfit.Parameters) -> Array:
        decay, omega = p["decay"].value, p["omega"].value
        cosine = np.cos(omega * time_s - p["phase"].value)
        return np.asarray(p["height"].value * np.exp(-decay * time_s) * cosine - angle)

    guess, _ = first_guess(time_s, angle, start_s=0.0, step_s=STEP_S)
    parameters = lmfit.create_params(height=angle[0], decay=guess[1] / 2, omega=math.sqrt(guess[0]), phase=0.0)
    return float(lmfit.minimize(residual, parameters).params["omega"].value ** 2)


def median_seconds(
    function: Callable[[Array, Array], float], data: tuple[Array, Array], runs: int
) -> tuple[float, float]:
    function(*data)
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        value = function(*data)
        times.append(time.perf_counter() - begin)
    return statistics.median(times), value


def long_swing() -> None:
    """Print the processor time of a whole fit of two minutes at 1 kHz, and of one integration by solve_ivp."""
    pendulum = Pendulum(axis_inertia_kg_m2=INERTIA, gravity_moment_nm=MOMENT, viscous_nms_per_rad=8e-7, coulomb_nm=5e-7)
    motion = swing([pendulum], [HandRelease(angle_rad=math.radians(50))], duration_s=LONG_S, step_s=5e-4, store_every=2)
    noise = np.random.default_rng(1).normal(0, NOISE_RAD, len(motion.time_s))
    begin = time.process_time()
    found = find_swing(motion.time_s, motion.angle_rad[:, 0] + noise)
    fit = fit_swing(found)
    fitted = time.process_time()
    frequency, viscous, coulomb = fit.coefficients[:3]

    def equation(_: float, y: Array) -> list[float]:
        return [y[1], -frequency * math.sin(y[0]) - viscous * y[1] - coulomb * math.tanh(y[1] / 2e-3)]

    window_s = found.hands_off[0]
    start = [fit.output_error.start_angle_rad, fit.output_error.start_speed_rad_per_s]
    solve_ivp(equation, (window_s[0], window_s[-1]), start, t_eval=window_s, rtol=1e-7, atol=1e-9)
    integrated = time.process_time()
    print(f"whole fit, {window_s[-1] - window_s[0]:.0f} s at 1 kHz {fitted - begin:14.2f} s    (goal: at most 3)")
    print(f"one integration by solve_ivp     {integrated - fitted:9.2f} s")


def main() -> None:
    data = record()
    truth = MOMENT / INERTIA
    figures = {}
    for name, function, runs in (
        ("collocation (cfid)", collocation, 30),
        ("solve_ivp RK45 + least_squares", output_error, 3),
        ("lmfit, damped cosine", linear_lmfit, 30),
    ):
        seconds, value = median_seconds(function, data, runs)
        figures[name] = seconds
        print(f"{name:<32}{1e3 * seconds:9.2f} ms   W {100 * (value / truth - 1):+8.4f} % off")
    ours, shooting, linear = figures.values()
    print(f"faster than solve_ivp            {shooting / ours:9.1f} times  (goal: at least 20)")
    print(f"time over the linear lmfit fit   {ours / linear:9.2f}        (goal: at most 4)")
    long_swing()


if __name__ == "__main__":
    main()
