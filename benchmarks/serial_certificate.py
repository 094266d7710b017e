"""Attacks on the certificates of the shipped serial arms' loops.

    python benchmarks/serial_certificate.py --runs 40

True arms stand at corners of what is stated: each link's inertia, payload, friction.  At rates at
the limit of the region the slowest decay of the energy is searched over configurations; in closed
loop, sampled and with one sample of delay, the largest tracking error is compared with its bound.
"""

import argparse

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import minimize

from lpv import load_arm
from lpv.core.control.tracking import TrackingController
from lpv.core.serial_arm.certificate.loop_gains import LoopGains
from lpv.core.serial_arm.chain import Chain, FloatArray, compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.payload import with_payload
from lpv.core.serial_arm.simulation import integration_step, plant_scratch, plant_step
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.gains import load_certified


def corner_arm(arm: SerialArm, gains: LoopGains, rng: np.random.Generator) -> Chain:
    """A true arm at a corner of the stated errors."""
    chain, n = compile_chain(arm), len(arm.joints)
    friction = chain.friction.copy()
    friction[:, :3] *= 1.0 + arm.uncertainty.friction * rng.choice([-1.0, 1.0])
    factors = 1.0 + gains.model_error * rng.choice([-1.0, 1.0], n)
    chain = chain._replace(inertial=chain.inertial * factors[:, None], friction=friction)
    load = arm.uncertainty.largest_payload * rng.choice([0.0, 1.0])
    return with_payload(chain, load) if load else chain


def decay(
    model: SerialModel, gains: LoopGains, chain: Chain, q: FloatArray, v: FloatArray
) -> float:
    """Decay of sqrt(V) in the worst direction of (eps, e, e') [1/s]."""
    w, n, h, p = gains.bandwidth, len(q), 1e-6, gains.motion.lyapunov
    mass, true = model.mass_matrix(q), SerialModel(chain).mass_matrix(q)
    growth = (model.mass_matrix(q + h * v) - model.mass_matrix(q - h * v)) / (2.0 * h)
    gain, drag = np.linalg.solve(true, mass), np.linalg.solve(true, np.diag(chain.friction[:, 0]))
    eye, zero = np.eye(n), np.zeros((n, n))
    last = [-w * gain, -3 * w * gain, -3 * w * gain - drag]
    loop = np.block([[zero, w * eye, zero], [zero, zero, w * eye], last])
    weight = np.kron(p, mass)
    change = weight @ loop + loop.T @ weight + np.kron(p, growth)
    return -0.5 * float(eigh(change, weight, eigvals_only=True)[-1])


def slowest_decay(arm: SerialArm, gains: LoopGains, tries: int, rng: np.random.Generator) -> float:
    """Slowest decay found by random places and a search from the five worst ones [1/s]."""
    model, limits = SerialModel(compile_chain(arm)), np.array(arm.velocity_limit)
    found = []
    for _ in range(tries):
        q = rng.uniform(-np.pi, np.pi, len(limits))
        v = gains.rate_share * limits * rng.choice([-1.0, 1.0], len(limits))
        chain = corner_arm(arm, gains, rng)
        found.append((decay(model, gains, chain, q, v), q, v, chain))
    found.sort(key=lambda item: item[0])
    worst = [
        minimize(
            lambda q, v=v, chain=chain: decay(model, gains, chain, q, v),
            q,
            method='Nelder-Mead',
            options={'maxfev': 600},
        ).fun
        for _, q, v, chain in found[:5]
    ]
    return min(worst)


def tracking_error(
    arm: SerialArm, gains: LoopGains, duration: float, rng: np.random.Generator
) -> FloatArray:
    """Largest error of each joint on a random path in the region of the bound [rad]."""
    n, period = len(arm.joints), arm.sample_time
    chain = corner_arm(arm, gains, rng)
    controller = TrackingController(arm, bandwidth=gains.bandwidth)
    # A tenth of the rates is left to the error.
    rates, most = (
        0.9 * gains.error.rate_share * np.array(arm.velocity_limit),
        gains.error.acceleration,
    )
    frequency = rng.uniform(0.3, 4.0, n)
    size = np.minimum(rates / frequency, most / frequency**2)
    centre = rng.uniform(-2.0, 2.0, n)
    state = np.ascontiguousarray([centre, size * frequency])
    step, count = integration_step(chain, period)
    scratch, matrix = plant_scratch(chain), np.empty((n, n))
    worst, torque = np.zeros(n), np.zeros(n)
    for k in range(int(duration / period)):
        phase = frequency * k * period
        reference = np.array(
            [
                centre + size * np.sin(phase),
                size * frequency * np.cos(phase),
                -size * frequency**2 * np.sin(phase),
            ]
        )
        controller.answer(reference, state[0], state[1], state[0], period)
        following = controller.torque.copy()
        if k == 0:
            torque = following
        if not plant_step(chain, state, torque, step, count, scratch, matrix):
            raise SystemExit('the true arm is not physical')
        torque = following  # one sample of delay
        worst = np.maximum(worst, np.abs(reference[0] - state[0]))
    return worst


def main() -> None:
    """Print a line for each arm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--runs', type=int, default=40)
    parser.add_argument('--tries', type=int, default=5000)
    parser.add_argument('--duration', type=float, default=10.0)
    arguments = parser.parse_args()
    for name in ('ur10', 'panda'):
        arm, rng = load_arm(name), np.random.default_rng(0)
        gains = load_certified(bringup_file('gains', name))
        slowest = slowest_decay(arm, gains, arguments.tries, rng)
        errors = [
            tracking_error(arm, gains, arguments.duration, rng) for _ in range(arguments.runs)
        ]
        largest = np.max(errors, axis=0)
        total = np.sum(list(gains.error_bound(arm).values()), axis=0)
        print(f'{name}: slowest decay found {slowest:.3f}/s, certified {gains.motion.decay:.3f}/s')
        share = np.round(largest / total, 3)
        print(f'  largest errors {np.round(largest, 4)} rad, over bound {share}')


if __name__ == '__main__':
    main()
