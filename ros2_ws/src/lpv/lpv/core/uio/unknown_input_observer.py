"""The designed unknown-input observer of a planar arm, with the reachable set of its errors.

It says at every sample where the links are and what the sensors' faults are, with a bound that
holds for every healthy arm inside its file whose rates are right; see `lpv.core.uio.bound`.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.limits import MAX_GAP
from lpv.core.support.records import memory, new_record, plain, record_type
from lpv.core.uio.bound.error_bound import (
    BOUND_CONSTANTS,
    BOUND_STATE,
    error_bound,
    reset_bound,
    update_bound,
)
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.observer.sampled_observer import (
    OBSERVER_CONSTANTS,
    OBSERVER_STATE,
    observe,
    observer_constants,
    reset_observer,
)
from lpv.core.uio.planar import planar_model

CHOICES = ('tightest', 'uio', 'horizon')
"""Whose estimate of the faults is published: that of the smaller bound, or one observer's alone."""
_NO_OBSERVER, _TIGHTEST, _UIO, _HORIZON = range(-1, len(CHOICES))

UIO_CONSTANTS = record_type(
    ('observer', OBSERVER_CONSTANTS),
    ('bound', BOUND_CONSTANTS),
    ('choice', 'i8'),  # index in `CHOICES`, or that no observer is asked
)
UIO_STATE = record_type(
    ('observer', OBSERVER_STATE),
    ('bound', BOUND_STATE),
    ('valid', '?'),  # whether there is an estimate
    # Of faults that were there at the start: the largest that the horizon leaves possible [rad],
    # until an alarm, and the share that the estimates may still lack.
    ('initial', 'f8', (2,)),
    ('alarmed', '?'),
    ('left', 'f8'),
)


class UioParts(NamedTuple):
    """Arguments of `uio_answers`."""

    constants: np.ndarray  # of `UIO_CONSTANTS`, shape (1,)
    state: np.ndarray  # of `UIO_STATE`, shape (1,)


def no_observer() -> UioParts:
    """Arguments for arms without one; of the same types, so that nothing is compiled anew."""
    constants = new_record(UIO_CONSTANTS, choice=_NO_OBSERVER)
    return UioParts(memory(constants), memory(new_record(UIO_STATE)))


@njit
def uio_step(
    params: np.record,
    state: np.record,
    stamp: int,
    position: FloatArray,
    velocity: FloatArray,
    effort: FloatArray,
) -> None:
    """Use one sample of the joints as measured, later than the one before; estimate and bound are
    in ``state``, of type `UIO_STATE`."""
    observer = state.observer
    if not observe(params.observer, observer, stamp, position, velocity, effort):
        _start_again(state)
        return
    state.valid = True
    if observer.bridged:  # faults may have begun in the gap as before the start
        _doubt_readings(state)
    if state.left > 0.0 and not (observer.held[0] or observer.held[1]):
        state.left *= math.exp(-params.bound.decay * observer.interval)
    update_bound(params.bound, state.bound, observer)


@njit
def _start_again(state: np.record) -> None:
    """Without an estimate; the next one takes the readings for right."""
    reset_bound(state.bound)
    state.valid = False
    _doubt_readings(state)


@njit
def _doubt_readings(state: np.record) -> None:
    """From here on they may be wrong by what the horizon leaves possible."""
    state.alarmed = False
    state.initial[:], state.left = np.inf, 1.0


@njit
def uio_answers(
    parts: UioParts,
    rows: Any,
    first: int,
    part: tuple[int, int],
    stamps: IntArray,
    samples: FloatArray,
) -> None:
    """Advance over samples in a row, and let the tighter estimate of each fault be the answer.

    ``rows`` (`lpv.core.monitoring.compensation.AnswerRows`) are the horizon's answers; estimates,
    bounds and positions are changed where the observer's bound is smaller.  ``first`` is the row of
    the first one of the samples, ``part`` the first sample and the first one after the last.  The
    last ones of ``samples``, shape (N, 3, 2), are joint torques [N m], NaN where missing; stamps
    are in [ns].
    """
    params, state = parts.constants[0], parts.state[0]
    if params.choice == _NO_OBSERVER:
        return
    for k in range(part[0], part[1]):
        row = first + k
        position, velocity = rows.measured[row], rows.measured_velocity[row]
        if math.isfinite(samples[k, 2, 0] + samples[k, 2, 1]):
            uio_step(params, state, stamps[k], position, velocity, samples[k, 2])
        else:  # as if there were no sample
            state.valid = False
        # By the horizon, at first and while no alarm says that others have come or gone since.
        state.alarmed |= rows.alarm[row, 0] or rows.alarm[row, 1]
        for i in range(2):
            if not (state.alarmed and math.isfinite(state.initial[i])):
                most = abs(rows.estimate[row, i]) + rows.bound[row, i]
                state.initial[i] = min(state.initial[i], most)
        if state.valid and params.choice != _HORIZON:
            _tighten(params, state, rows, row)


@njit
def _tighten(params: np.record, state: np.record, rows: Any, k: int) -> None:
    """Replace what is known worse; positions follow q = S^-1 (y - f), y as measured.

    The set of errors leaves out faults that were there at the start; what the estimate may still
    lack of them adds to the bound.
    """
    observer, choice, joints = state.observer, params.choice, params.observer.joints
    for i in range(2):
        bound = state.bound.bound[i]
        if choice == _TIGHTEST:
            bound += state.left * state.initial[i]
        if choice == _UIO or bound < rows.bound[k, i]:
            fault = observer.x[4 + i]
            change = -fault
            for j in range(2):
                change += joints.from_joint[i, j] * (rows.measured[k, j] - rows.position[k, j])
            rows.estimate[k, i], rows.bound[k, i] = fault, bound
            for j in range(2):
                rows.position[k, j] += joints.to_joint[j, i] * change
    if choice == _UIO:
        for i in range(2):
            rows.velocity[k, i] = observer.velocity[i]
            rows.position[k, i] = observer.position[i]
        rows.mode[k] = observer.mode


class UnknownInputObserver:
    """The observer of one arm.

    Parameters
    ----------
    arm : SerialArm
        Planar, with an ``lpv`` region.
    gains : Gains
        Designed for it.
    choice : {'tightest', 'uio', 'horizon'}, optional
        Whose estimate of the faults is published.
    initial_samples : int, optional
        Samples over which the start value is averaged.
    max_gap : float, optional
        Longest interval that is integrated [s].

    Attributes
    ----------
    method : str
        Of the observer: ``paper`` or ``exact``.
    certifies : bool
        Whether the bound holds while a sensor fails: method ``exact``, rates have sensors of their
        own, and the arm file states nothing of the efforts that the bound leaves out.
    parts : UioParts
        Arguments of `uio_answers`.

    Raises
    ------
    ConfigError
        If the arm is not planar, or the gains belong to another arm.
    """

    def __init__(
        self,
        arm: SerialArm,
        gains: Gains,
        choice: str = CHOICES[0],
        initial_samples: int = 1,
        max_gap: float = MAX_GAP,
    ) -> None:
        gains.check_arm(arm)
        planar, observer = planar_model(arm), gains.observer
        self.method = observer.method
        self._planar, self._observer = planar, observer
        constants = new_record(
            UIO_CONSTANTS,
            observer=observer_constants(planar, observer, initial_samples, max_gap),
            bound=error_bound(planar, observer),
        )
        state = new_record(UIO_STATE)
        self.parts = UioParts(memory(constants), memory(state))
        # A fault of a sensor whose rate is derived from it is in the rate, too, and method paper
        # leaves model errors out: no bound is guaranteed then.
        independent = all(joint.sensors.rates == 'independent' for joint in arm.joints)
        # Efforts are taken as they are, for those of the interval before the stamp.
        exact = math.isinf(arm.effort_bandwidth) and not any(
            joint.effort_delay or any(joint.torque_tolerance.torque) for joint in arm.joints
        )
        self.certifies = independent and exact and self.method == 'exact'
        found = plain(state)
        # Faults of the sensors and their bounds, shape (2,) [rad]; whether there are any
        self.level = found['observer']['x'][4:], found['bound']['bound'], memory(state)['valid']
        self._choice = CHOICES.index(choice)
        self.rely(True)
        self.reset()

    def retune(self, sigmas: float) -> None:
        """Change the standard deviations of noise in the bound."""
        self.parts.constants['bound'] = error_bound(self._planar, self._observer, sigmas)

    def rely(self, rates_are_right: bool) -> None:
        """Publish the tighter estimate only while nothing speaks against the rates."""
        choice = self._choice
        if choice != _UIO and not self.certifies:
            choice = _NO_OBSERVER  # nothing would be made of it
        elif choice == _TIGHTEST and not rates_are_right:
            choice = _HORIZON
        self.parts.constants['choice'] = choice

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        reset_observer(self.parts.state[0].observer)
        _start_again(self.parts.state[0])
