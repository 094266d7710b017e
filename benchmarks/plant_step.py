"""Cost of the simulated plant, against SciPy's solve_ivp at the same accuracy.

Both integrate the arm of the paper over the same samples with a held torque.  The figure is the
ratio of the two times in this very run, with the difference of the two results.
"""

import time

import numpy as np
from scipy.integrate import solve_ivp

from lpv_core.model.arm import load_arm
from lpv_core.model.dynamics import acceleration, rk4_step
from lpv_core.support.resources import bringup_file

SAMPLES = 1000
ROUNDS = 5
TORQUE = (5.0, -2.0)


def ours(constants, dt):
    """Two Runge-Kutta steps a sample, as the simulator makes them."""
    state = (0.1, -0.2, 0.0, 0.0)
    rk4_step(state, TORQUE, (0.0, 0.0), dt, constants)
    start = time.perf_counter()
    for _ in range(SAMPLES):
        for _ in range(2):
            state = rk4_step(state, TORQUE, (0.0, 0.0), dt / 2, constants)
    return time.perf_counter() - start, np.array(state)


def peer(constants, dt):
    """SciPy, one call a sample: the torque changes with every sample in a loop."""
    state = np.array([0.1, -0.2, 0.0, 0.0])

    def rates(_, x):
        return [x[2], x[3], *acceleration(*x, *TORQUE, constants)]

    start = time.perf_counter()
    for _ in range(SAMPLES):
        state = solve_ivp(rates, (0.0, dt), state, method='RK45', rtol=1e-9, atol=1e-12).y[:, -1]
    return time.perf_counter() - start, state


def main():
    """Measure in turns, and print the median ratio."""
    arm = load_arm(bringup_file('arms', 'paper'))
    constants = arm.constants()
    pairs = [
        (ours(constants, arm.sample_time), peer(constants, arm.sample_time)) for _ in range(ROUNDS)
    ]
    ratio = np.median([a[0] / b[0] for a, b in pairs])
    gap = np.abs(pairs[0][0][1] - pairs[0][1][1]).max()
    print(
        f'plant step / scipy.integrate.solve_ivp: {ratio:.4f} (median of {ROUNDS} rounds), '
        f'results differ by {gap:.1e} after {SAMPLES * arm.sample_time:g} s'
    )


if __name__ == '__main__':
    main()
