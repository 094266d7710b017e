"""The simulated arm: physics."""

import numpy as np
import pinocchio
from serial_chains import pinocchio_model, random_chain

from lpv.core.serial_arm.chain import workspace
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.simulation import plant_step


def test_energy_is_kept_without_friction_and_torque():
    chain = random_chain(3, 4)
    model, state = SerialModel(chain), np.array([[0.3, -0.5, 0.8, 0.1], [0.2, 0.1, -0.3, 0.4]])
    scratch, matrix = np.zeros((44, workspace(chain).shape[1])), np.empty((4, 4))
    peer = pinocchio_model(chain)

    def energy():
        kinetic = 0.5 * state[1] @ model.mass_matrix(state[0]) @ state[1]
        return kinetic + pinocchio.computePotentialEnergy(peer, peer.createData(), state[0])

    before = energy()
    for _ in range(1000):
        assert plant_step(chain, state, np.zeros(4), 5e-4, 1, scratch, matrix)
    assert abs(energy() - before) < 1e-6 * abs(before)
    assert np.abs(state[1]).max() > 1.0
