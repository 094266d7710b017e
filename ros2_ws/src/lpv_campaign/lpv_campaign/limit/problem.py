"""What is estimated, and from what knowledge."""

from dataclasses import dataclass

import numpy as np

from lpv_campaign.limit.arm_prior import ArmKnowledge
from lpv_campaign.limit.fault_prior import FaultModel
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_core.simulation.closed_loop import Run
from lpv_core.simulation.scenario import Scenario


@dataclass(frozen=True)
class Problem:
    """One run of n samples, and what an estimator knows of arm and faults; N states."""

    arm: ArmParameters  # nominal arm, with sensors and disturbance
    scenario: Scenario  # what happened: plant, noise, disturbance, faults
    run: Run  # what was measured, torques, brakes, lost samples
    knowledge: ArmKnowledge  # of the arm, see `lpv_campaign.limit.arm_prior`
    faults: list[FaultModel]  # what is known of the faults
    substeps: int = 2  # Runge-Kutta steps per sample, as in the run

    @property
    def first_fault(self) -> int:
        """Column of the states at which the fault models' numbers begin."""
        return 4 + len(self.knowledge.deviation)

    def new_states(self) -> np.ndarray:
        """States of all samples, all zero, shape (n, N)."""
        return np.zeros((len(self.run.time), self.first_fault + len(self.faults)))

    def true_states(self) -> np.ndarray:
        """Trajectory of the run's true state, shape (n, N)."""
        joints, states = JointMap(self.arm), self.new_states()
        states[:, :2] = joints.absolute_position(self.run.position)
        states[:, 2:4] = joints.absolute_velocity(self.run.velocity)
        states[:, 4 : self.first_fault] = self.knowledge.truth
        states[:, self.first_fault :] = [model.truth for model in self.faults]
        return states
