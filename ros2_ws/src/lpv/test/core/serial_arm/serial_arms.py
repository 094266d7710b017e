"""Arms that are simulated in the tests."""

from dataclasses import replace

import fault_injection
import numpy as np
from simulated_runs import Run, simulated_run

from lpv.core.serial_arm.chain import Chain, compile_chain
from lpv.core.serial_arm.description import LinkInertia, SerialArm, Uncertainty
from lpv.core.serial_arm.diagnosis.monitor import SerialMonitor

KNOWN = Uncertainty(payload=0.5, friction=0.3)


def shoulder_arm(rates: str = 'derived', uncertainty: Uncertainty = KNOWN) -> SerialArm:
    """Three joints: the base turns about the vertical, shoulder and elbow lift."""
    arm = with_rates(fault_injection.shoulder_arm(), rates)
    return replace(arm, name='shoulder', uncertainty=uncertainty)


def with_rates(arm: SerialArm, rates: str, **changes) -> SerialArm:
    """An arm whose rates come from elsewhere, and other changes."""
    joints = (replace(j, sensors=replace(j.sensors, rates=rates)) for j in arm.joints)
    return replace(arm, joints=tuple(joints), **changes)


def wrong_plant(arm: SerialArm, seed: int, error: float = 0.05) -> Chain:
    """The same arm with masses, friction and a payload that the model does not know."""
    rng = np.random.default_rng(seed)
    changed = []
    for joint in arm.joints:
        link = LinkInertia.from_vector((1.0 + rng.uniform(-error, error)) * joint.link.to_vector())
        viscous, coulomb = rng.uniform(0.7, 1.3, 2) * (
            joint.friction.viscous,
            joint.friction.coulomb,
        )
        friction = replace(joint.friction, viscous=viscous, coulomb=coulomb)
        changed.append(replace(joint, link=link, friction=friction))
    return compile_chain(replace(arm, joints=tuple(changed)))


def simulated(arm, *faults, pushes=(), seed=1, duration=8.0, plant=None) -> Run:
    """A run of the arm with a plant that its model does not know exactly."""
    plant = wrong_plant(arm, seed) if plant is None else plant
    return simulated_run(arm, duration, *faults, plant=plant, pushes=pushes, seed=seed)


def watch(arm, run) -> SerialMonitor:
    """The monitor of an arm after a run."""
    monitor = SerialMonitor(arm)
    monitor.update_many(run.stamps, run.samples)
    return monitor
