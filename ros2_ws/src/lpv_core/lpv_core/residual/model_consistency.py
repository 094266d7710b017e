"""Do rates, torques and model fit together?  If not, a fault estimate may have another cause.

The observer's rate innovation r = theta^' - v is, in momentum coordinates, what unknown torques and
rate errors leave behind: a position fault does not touch it.  A healthy arm keeps it within the
reachable set and noise.  Where it leaves them, a rate sensor, a torque sensor or the model is
wrong, and which one cannot be told from two encoders and two rates.

Brakes stop an arm with a torque that is not measured.  Until it is known whether an arm that came
to rest was braked, or its rate sensors read nothing, no verdict is given.

A rate that goes wrong suddenly shows for as long as the observer takes to follow, 1/mu.  Smaller
errors of the rates stay unseen.
"""

import math

import numpy as np

from lpv_core.certificate.gains import ExactObserverGains, Gains
from lpv_core.model.arm import ARM_CONSTANTS, ArmParameters
from lpv_core.model.dynamics import coupling
from lpv_core.observer.sampled_observer import Stop
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS, NEVER

_FILTERS = (0.02, 0.2)
"""Time constants of the averages [s]: a jump of a rate, and a lasting contradiction."""
_HOLD = NANOSECONDS
"""An inconsistency is believed to last for this long after it was seen [ns]."""

_SUDDEN, _BRAKED = int(Stop.SUDDEN), int(Stop.BRAKED)

CONSISTENCY_CONSTANTS = record_type(
    ('used', '?'),  # whether the test is made
    ('arm', ARM_CONSTANTS),
    ('inertia', 'f8', (2,)),  # Xi_ii [kg m2]
    ('noise', 'f8', (len(_FILTERS), 2)),  # limit by noise for each average [rad/s]
    ('tolerance', 'f8', (2,)),  # limit by tolerated torques [rad/s]
)
CONSISTENCY_STATE = record_type(
    ('means', 'f8', (len(_FILTERS), 2)),  # averages of the momentum innovation [rad/s]
    ('until', 'i8'),  # end of the inconsistency [ns]
    ('inconsistent', '?'),  # rates, torques and model contradict each other, now or shortly before
)


def consistency_test(arm: ArmParameters, gains: Gains, sigmas: float) -> np.record:
    """`CONSISTENCY_CONSTANTS` for one arm; method ``exact`` only; ``sigmas`` of noise in limits."""
    if not isinstance(gains.observer, ExactObserverGains):
        return new_record(CONSISTENCY_CONSTANTS)
    constants = arm.constants()
    inertia = constants.inertia
    off = abs(coupling(0.0, 0.0, constants))
    # White rates of both links enter a momentum; relative sensors add theirs up.
    rows = np.hypot(1.0, off / inertia) * (1.0 if arm.arrangement == 'absolute' else math.sqrt(2.0))
    noise = [
        sigmas * rows * arm.velocity_noise * math.sqrt(arm.sample_time / (2.0 * tau))
        for tau in _FILTERS
    ]
    return new_record(
        CONSISTENCY_CONSTANTS,
        used=True,
        arm=constants,
        inertia=inertia,
        noise=noise,
        tolerance=tolerated_rates(arm, gains.observer),
    )


def tolerated_rates(arm: ArmParameters, observer: ExactObserverGains) -> np.ndarray:
    """Momentum innovation that tolerated torques make with method ``exact``, by link [rad/s]."""
    inertia = arm.constants().inertia
    return np.asarray(arm.torque_tolerance) / (np.asarray(observer.mu) * inertia)


@njit
def reset_consistency(state: np.record) -> None:
    """Forget the past."""
    state.means[:] = 0.0
    state.until = NEVER
    state.inconsistent = False


@njit
def update_consistency(
    params: np.record, state: np.record, estimate: np.record, healthy: np.ndarray, noise: float
) -> None:
    """Test one sample; fills ``inconsistent`` of the state.

    Parameters
    ----------
    params, state : numpy.record
        Constants and state.
    estimate : numpy.record
        Latest estimate.
    healthy : ndarray, shape (2,)
        Bound on the scaled momentum error of a healthy arm [rad/s].
    noise : float
        Noise of the rates over what is stated.
    """
    if not params.used:
        return
    if estimate.stop == _BRAKED:
        state.means[:] = 0.0
    off = coupling(estimate.absolute_position[0], estimate.absolute_position[1], params.arm)
    for f in range(len(_FILTERS)):
        share = min(1.0, estimate.interval / _FILTERS[f])
        for i in range(2):
            momentum = estimate.innovation[i] + off * estimate.innovation[1 - i] / params.inertia[i]
            state.means[f, i] += share * (momentum - state.means[f, i])
            limit = healthy[i] + params.tolerance[i] + noise * params.noise[f, i]
            if abs(state.means[f, i]) > limit and estimate.stop != _SUDDEN:
                state.until = estimate.stamp + _HOLD
    state.inconsistent = estimate.stamp < state.until
