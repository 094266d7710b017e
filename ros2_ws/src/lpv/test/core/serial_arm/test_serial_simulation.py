"""The simulated serial arm: physics and faults."""

import numpy as np
import pytest
from serial_arms import shoulder_arm
from serial_chains import random_chain

from lpv.core.serial_arm.chain import workspace
from lpv.core.serial_arm.dynamics.kinematics import joint_frames
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.simulation import EncoderFault, SerialSimulator, plant_step
from lpv.core.support.errors import ConfigError


def potential_energy(chain, q):
    n = len(q)
    rotations, origins = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    joint_frames(chain, q, rotations, origins)
    return -sum(
        chain.gravity @ (body[0] * origin + rotation @ body[1:4])
        for body, rotation, origin in zip(chain.inertial, rotations, origins)
    )


def test_energy_is_kept_without_friction_and_torque():
    chain = random_chain(3, 4)
    model, state = SerialModel(chain), np.array([[0.3, -0.5, 0.8, 0.1], [0.2, 0.1, -0.3, 0.4]])
    scratch, matrix = np.zeros((44, workspace(chain).shape[1])), np.empty((4, 4))

    def energy():
        kinetic = 0.5 * state[1] @ model.mass_matrix(state[0]) @ state[1]
        return kinetic + potential_energy(chain, state[0])

    before = energy()
    for _ in range(1000):
        assert plant_step(chain, state, np.zeros(4), 5e-4, 1, scratch, matrix)
    assert abs(energy() - before) < 1e-6 * abs(before)
    assert np.abs(state[1]).max() > 1.0


def test_closed_loop_follows_the_path():
    run = SerialSimulator(shoulder_arm(), seed=1).run(2.0)
    assert np.abs(run.samples[:, 0] - run.position).max() < 1e-3
    assert np.abs(run.position[-1] - run.position[0]).max() > 0.1


@pytest.mark.parametrize(('rates', 'jump'), [('derived', 100.0), ('independent', 0.0)])
def test_derived_rate_fails_with_its_encoder(rates, jump):
    fault = EncoderFault(1, 'bias', 0.5, 0.2)
    run = SerialSimulator(shoulder_arm(rates), seed=1).run(0.6, [fault])
    change = np.diff(run.samples[:, 1, 1])[249]
    assert change == pytest.approx(jump, abs=1.0)
    assert (run.samples[250, 0] - run.position[250])[1] == pytest.approx(0.2, abs=1e-3)


def test_stuck_reading_rests_while_the_arm_moves():
    run = SerialSimulator(shoulder_arm(), seed=1).run(1.0, [EncoderFault(2, 'stuck', 0.5)])
    assert np.ptp(run.samples[250:, 0, 2]) == 0.0
    assert np.ptp(run.position[250:, 2]) > 0.01


def test_unknown_fault_is_refused():
    with pytest.raises(ConfigError, match=r'faults\[0\].kind'):
        SerialSimulator(shoulder_arm()).run(0.1, [EncoderFault(0, 'haunted', 0.0)])
    with pytest.raises(ConfigError, match=r'faults\[0\].joint'):
        SerialSimulator(shoulder_arm()).run(0.1, [EncoderFault(3, 'bias', 0.0)])
