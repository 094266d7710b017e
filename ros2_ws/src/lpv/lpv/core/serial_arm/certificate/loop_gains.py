"""Computed torque of a serial arm: bandwidth, and the certificate of the loop."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpv.core.serial_arm.certificate.certified import CertifiedGains, Inequalities, judged
from lpv.core.serial_arm.certificate.disturbance import missed_torque
from lpv.core.serial_arm.certificate.loop_inequality import (
    LoopNumbers,
    motion_matrix,
    sampled_matrix,
)
from lpv.core.serial_arm.certificate.model_bounds import (
    ModelBounds,
    bound_inequalities,
    chain_numbers,
    invariant_forms,
)
from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.config import Section
from lpv.core.support.entries import array, entry, part, positive
from lpv.core.support.errors import ConfigError
from lpv.core.support.inequalities import SAME, Check, NumberType, array_of

NO_CERTIFICATE = 'none (lpv design writes one)'
"""Of a loop whose parameter file has a bandwidth only, for the reader."""
_MODEL_TEXT = {
    'payload': 'payload M_p(q) <= {:.4g} M(q) at every q',
    'damping': 'viscous friction F_v <= {:.4g}/s M(q) at every q',
    'growth': "abs(M') <= {:.4g}/s M(q) at the velocity limits, every q",
    'inertia': 'M(q) >= diag(c) at every q, smallest c {:.4g} kg m2',
}


@dataclass(frozen=True)
class LoopProof:
    """A Lyapunov function, and what it proves."""

    decay: float = positive()  # alpha: sqrt(V) falls with exp(-alpha t) [1/s]
    lyapunov: FloatArray = array(3, 3)  # P
    multipliers: FloatArray = array(2)  # of the sectors of Gamma and Phi

    def numbers(self, bandwidth: float, number: NumberType) -> tuple[Any, ...]:
        """P, multipliers and decay over the bandwidth, as floats or fractions."""
        p = array_of(number)(self.lyapunov)
        decay = number(self.decay) / number(bandwidth)
        return (p + p.T) / 2, array_of(number)(self.multipliers), decay


@dataclass(frozen=True)
class SampledProof(LoopProof):
    """`LoopProof` of the sampled loop."""

    lyapunov: FloatArray = array(4, 4)  # P, of the command, too


@dataclass(frozen=True)
class ErrorProof(LoopProof):
    """`LoopProof` of a region of motion on which the tracking error is bounded."""

    # of the velocity limits, of all joints at once [-]
    rate_share: float = positive(high=1.0)
    acceleration: float = entry('number', low=0.0, high=1e3)  # largest of the reference [rad/s2]
    level: float = positive()  # mu: V ends below mu abs(omega)^2 [-]
    bound: FloatArray = array(-1)  # of the tracking error of each joint, shape (n,) [rad]


@dataclass(frozen=True)
class LoopGains(CertifiedGains):
    """Tracking of a serial arm, with its certificate."""

    bandwidth: float = entry('number', low=0.1, high=100.0)  # w [rad/s]
    # d: of each link's pseudo-inertia, in the matrix order, and of rotors [-]
    model_error: float = entry('number', low=0.0, high=0.5)
    # region: share of the velocity limits, of all joints at once [-]
    rate_share: float = positive(high=1.0)
    motion: LoopProof = part(LoopProof)  # at rate_share
    sampled: LoopProof = part(SampledProof)  # at rate_share
    error: ErrorProof = part(ErrorProof)  # at its own, smaller one
    model: ModelBounds = part(ModelBounds)
    format = 1
    section = 'loop'
    unused = ()
    what = 'tracking loop'

    def parameters(self) -> dict[str, Any]:
        """As of `CertifiedGains`; ``bandwidth`` is a parameter of its own."""
        loop = self.mapping()
        return {'bandwidth': loop.pop('bandwidth'), self.section: loop}

    def check(self, section: Section) -> None:
        """ConfigError for numbers of different arms."""
        n, forms = len(self.model.inertia), vars(self.model.forms).values()
        if len(self.error.bound) != n or any(len(rows) != n - 1 for rows in forms):
            raise section.error('model', f'must have forms and bounds of {n} joints')

    def numbers(self, arm: SerialArm, share: float, number: NumberType = float) -> LoopNumbers:
        """Intervals of the loop's eigenvalues where joints move at a share of their limits.

        ``number`` makes floats or fractions.
        """
        model, w, d = self.model, number(self.bandwidth), number(self.model_error)
        friction = 1 + number(arm.uncertainty.friction)
        return LoopNumbers(
            growth=number(model.growth) * number(share) / w,
            damping=number(model.damping) * friction / w,
            low=1 / (1 + d + number(model.payload)),
            high=1 / (1 - d),
            step=number(arm.sample_time) * w,
        )

    def error_bound(self, arm: SerialArm) -> dict[str, FloatArray]:
        """Bounds of the tracking error of each joint by cause, in time; they add up [rad].

        V ends below mu abs(omega)^2, P >= e_2 e_2^T, and omega = M^^(-1/2) delta / w.
        """
        proof, w = self.error, self.bandwidth
        rates = proof.rate_share * np.array(arm.velocity_limit)
        causes = missed_torque(arm, self.model, self.model_error, rates, proof.acceleration)
        each = math.sqrt(proof.level) / (w * w * np.sqrt(self.model.inertia))
        return {name: size * each for name, size in causes.items()}

    def certified_region(self) -> str:
        """One line on what a certificate that holds is about."""
        return (
            f'holds for joint rates to {self.rate_share:.3g} of their limits, model error '
            f'{self.model_error:g}'
        )

    def facts(self, arm: SerialArm) -> list[str]:
        """As of `CertifiedGains`, with bounds of the tracking error."""
        rates, error = np.array(arm.velocity_limit), self.error
        rows = [
            ('total', error.bound),
            *sorted(self.error_bound(arm).items(), key=lambda item: -float(item[1].max())),
        ]
        return [
            f'region: every position, joint rates to {_listed(self.rate_share * rates)} rad/s, all '
            'at once',
            f'model error {self.model_error:g} of every link and rotor, payload to '
            f'{arm.uncertainty.largest_payload:g} kg, friction {arm.uncertainty.friction:g} off; '
            f'bandwidth {self.bandwidth:g} rad/s',
            'bound of the tracking error of each joint [rad], rates to '
            f'{_listed(error.rate_share * rates)} rad/s, accelerations of the path to '
            f'{error.acceleration:g} rad/s2:',
            *(f'  {name}: {_listed(values)}' for name, values in rows),
        ]

    def inequalities(self, arm: SerialArm, number: NumberType = float) -> Inequalities:
        """As of `CertifiedGains`: bounds of the mass matrix, then the loop's."""
        yield from self._model_inequalities(arm, number)
        yield from self._loop_inequalities(arm, number)

    def _model_inequalities(self, arm: SerialArm, number: NumberType) -> Inequalities:
        numbers, array = chain_numbers(arm, number), array_of(number)
        for bound, text in _MODEL_TEXT.items():
            stored = getattr(self.model, bound)
            value = array(stored) if np.ndim(stored) else number(stored)
            invariant = invariant_forms(array(getattr(self.model.forms, bound)), bound)
            matrices = bound_inequalities(numbers, bound, value, invariant)
            yield f'model: {text.format(np.min(stored))}', [-matrix for matrix in matrices]

    def _loop_inequalities(self, arm: SerialArm, number: NumberType) -> Inequalities:
        """What each Lyapunov matrix must satisfy."""
        motion, sampled, error = self.motion, self.sampled, self.error
        numbers = self.numbers(arm, self.rate_share, number)
        share = f'rates to {self.rate_share:.3g} of the limits'
        p, multipliers, decay = motion.numbers(self.bandwidth, number)
        yield 'motion: P > 0', [-p]
        name = f'motion: V decays, alpha {motion.decay:.3g}/s, {share}'
        yield name, [motion_matrix(p, multipliers, numbers, decay)]
        p, multipliers, decay = sampled.numbers(self.bandwidth, number)
        yield 'sampled: P > 0', [-p]
        name = f'sampled with one sample of delay: V decays, alpha {sampled.decay:.3g}/s, {share}'
        yield name, [sampled_matrix(p, multipliers, numbers, decay)]
        numbers = self.numbers(arm, error.rate_share, number)
        p, multipliers, decay = error.numbers(self.bandwidth, number)
        yield 'error: P > 0 and bounds the position', [np.diag([0, 1, 0]) - p]
        name = f'error: V ends below its level, rates to {error.rate_share:.3g} of the limits'
        yield name, [motion_matrix(p, multipliers, numbers, decay, number(error.level))]

    def checks(self, arm: SerialArm) -> Iterator[Check]:
        """As of `CertifiedGains`."""
        if len(self.model.inertia) != len(arm.joints):
            raise ConfigError('loop.model.inertia', f'must have {len(arm.joints)} numbers')
        yield from judged(self._model_inequalities(arm, float))
        sectors = (self.motion, self.sampled, self.error)
        lowest = min(float(part.multipliers.min()) for part in sectors)
        yield Check('multipliers are positive', -lowest)
        yield Check('inertia: c > 0', -float(self.model.inertia.min()))
        change = 2.0 * arm.sample_time * self.model.growth * self.rate_share
        followed = Check('sampling: M^ changes little within a sample and its delay', change - 1.0)
        yield followed
        if not followed.holds:
            return  # the sampled inequality would divide by zero
        yield from judged(self._loop_inequalities(arm, float))
        total = sum(self.error_bound(arm).values())
        away = np.abs(self.error.bound / total - 1.0).max()
        yield Check('error: bound of each joint as recomputed', float(away) - SAME)


def _listed(values: FloatArray) -> str:
    return ', '.join(f'{value:.3g}' for value in values)
