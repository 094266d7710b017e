"""Attacks from numbers in [-1, 1]: everything that an arm file allows a healthy arm to do."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from lpv_campaign.falsify.healthy_run import ATTACK, SETUP
from lpv_core.bound.error_bound import error_bound
from lpv_core.certificate.gains import Gains
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.model.arm import ARM_CONSTANTS, ArmParameters
from lpv_core.observer.sampled_observer import observer_constants
from lpv_core.residual.dead_reckoning import RATE_BIAS, dead_reckoning
from lpv_core.support.records import new_record

_SLOWEST, _FASTEST = 0.2, 8.0
"""Circular frequencies of the motion [rad/s]."""
_SLOW_SWITCH, _FAST_SWITCH = 0.3, 60.0
"""Circular frequencies of bang-bang time profiles [rad/s]."""
_REACH = 0.97
"""Share of the certified region that motions use."""
_SPEED = 0.5
"""Share of the velocity limit that motions use."""

NUMBERS = (
    *('centre_1', 'centre_2', 'swing_1', 'swing_2', 'speed_1', 'speed_2', 'phase_1', 'phase_2'),
    *('rest', 'mass_1', 'mass_2', 'inertia_1', 'inertia_2', 'payload', 'friction'),
    *('disturbance', 'switch_speed', 'switch_phase'),
    *('rate_scale_1', 'rate_scale_2', 'rate_bias_1', 'rate_bias_2', 'rate_switch'),
)
"""Names of the numbers of a candidate, each in [-1, 1]."""


def make_setup(arm: ArmParameters, gains: Gains) -> np.record:
    """What all runs of a search share, with the usual tuning and no floor of the threshold."""
    tuning = DiagnosisParameters()
    return new_record(
        SETUP,
        arm=arm.constants(),
        observer=observer_constants(arm, gains),
        reckoning=dead_reckoning(arm),
        bound=error_bound(arm, gains, tuning.sigmas, tuning.friction_uncertainty),
        sample_time=arm.sample_time,
        stiffness=min(20.0, 0.1 / arm.sample_time),
        torque_limit=arm.torque_limit,
        direction=arm.disturbance_direction,
        push_deviation=math.sqrt(arm.disturbance_variance),
        position_noise=arm.position_noise,
        velocity_noise=arm.velocity_noise,
        factor=tuning.threshold_factor,
        smallest=0.0,
        largest=tuning.safe_stop_bound,
    )


def _geometric(share: float, low: float, high: float) -> float:
    return low * (high / low) ** (0.5 * (share + 1.0))


def make_attack(arm: ArmParameters, candidate: np.ndarray, seed: int) -> np.record:
    """Attack of a candidate.

    Parameters
    ----------
    arm : ArmParameters
        What is allowed.
    candidate : ndarray, shape (len(NUMBERS),)
        In [-1, 1]; errors saturate at half of that, so that their corners are reached.
    seed : int
        Of the noise.

    Returns
    -------
    numpy.record
        Of type `ATTACK`.
    """
    numbers = dict(zip(NUMBERS, np.clip(candidate, -1.0, 1.0)))
    corner = {name: float(np.clip(2.0 * value, -1.0, 1.0)) for name, value in numbers.items()}
    reach = _REACH * np.arccos(arm.cos_min)
    middle = 0.0 if arm.sign > 0 else math.pi
    away = np.array([numbers['centre_1'], numbers['centre_2']]) * reach
    swing = 0.5 * (np.array([numbers['swing_1'], numbers['swing_2']]) + 1.0) * (reach - abs(away))
    speed = np.array([_geometric(numbers[f'speed_{i}'], _SLOWEST, _FASTEST) for i in (1, 2)])
    fastest = (swing * speed).sum() / (_SPEED * min(arm.velocity_limit))
    switches = numbers['switch_speed'] > -0.3
    return new_record(
        ATTACK,
        true_arm=true_arm(arm, corner).constants(),
        centre=middle + away,
        swing=swing,
        speed=speed / max(1.0, fastest),
        phase=(math.pi * numbers['phase_1'], math.pi * numbers['phase_2']),
        rest=0.75 * (numbers['rest'] + 1.0),
        disturbance=corner['disturbance'] * abs(arm.disturbance_mean),
        disturbance_speed=(
            _geometric(numbers['switch_speed'], _SLOW_SWITCH, _FAST_SWITCH) if switches else 0.0
        ),
        disturbance_phase=math.pi * numbers['switch_phase'],
        rate_scale=[arm.velocity_error * corner[f'rate_scale_{i}'] for i in (1, 2)],
        rate_bias=[RATE_BIAS * arm.velocity_noise * corner[f'rate_bias_{i}'] for i in (1, 2)],
        rate_switch=float(numbers['rate_switch'] > 0.3),
        seed=seed,
    )


def true_arm(arm: ArmParameters, corner: dict[str, float]) -> ArmParameters:
    """The arm with errors in [-1, 1] of what its file states; the nominal one if not physical."""
    error, rub = arm.model_error, DiagnosisParameters().friction_uncertainty
    other = arm.scaled(
        [1.0 + error * corner[f'mass_{i}'] for i in (1, 2)],
        [1.0 + error * corner[f'inertia_{i}'] for i in (1, 2)],
    )
    factor = 1.0 + rub * corner['friction']
    other = replace(
        other,
        viscous=tuple(factor * v for v in arm.viscous),
        coulomb=tuple(factor * v for v in arm.coulomb),
    ).with_payload(0.5 * (corner['payload'] + 1.0) * arm.payload)
    return other if other.is_physical() else arm


def structured_candidates(rng: np.random.Generator) -> list[np.ndarray]:
    """What an engineer would try: corners of the model at rest, at the edge, in swing."""
    found = []
    for heavy in (-1.0, 1.0):
        for pose in ((0.0, 0.0), (0.8, 0.0), (0.0, 0.9), (0.9, 0.9), (0.8, -0.9)):
            for swing in (-1.0, 0.0, 1.0):
                candidate = rng.uniform(-1.0, 1.0, len(NUMBERS))
                numbers = {
                    **dict(zip(('centre_1', 'centre_2'), pose)),
                    **{name: swing for name in ('swing_1', 'swing_2')},
                    **{name: heavy for name in ('mass_1', 'mass_2', 'inertia_1', 'inertia_2')},
                    'disturbance': rng.choice([-1.0, 1.0]),
                    'switch_speed': rng.choice([-1.0, 0.0, 0.5]),
                    'payload': 1.0,
                }
                for name, value in numbers.items():
                    candidate[NUMBERS.index(name)] = value
                found.append(candidate)
    return found


def attack_as_dict(attack: np.record) -> dict[str, Any]:
    """Plain numbers of an attack, for a file."""
    plain = {}
    for name in ATTACK.names or ():
        value = attack[name]
        plain[name] = (
            {part: np.asarray(value[part]).tolist() for part in ARM_CONSTANTS.names or ()}
            if name == 'true_arm'
            else np.asarray(value).tolist()
        )
    return plain


def attack_from_dict(data: dict[str, Any]) -> np.record:
    """Attack from `attack_as_dict`."""
    fields = {name: data[name] for name in ATTACK.names or () if name != 'true_arm'}
    return new_record(ATTACK, true_arm=new_record(ARM_CONSTANTS, **data['true_arm']), **fields)
