"""Arms that are simulated in the tests."""

from dataclasses import replace

import fault_injection
import numpy as np
from fault_injection import wrong_chain
from simulated_runs import Run, simulated_run

from lpv.core.serial_arm.description import SerialArm, Uncertainty
from lpv.core.serial_arm.diagnosis.monitor import SerialMonitor

URDF = """<robot name="small"><link name="base"/><link name="tool"/>
<link name="one"><inertial><origin xyz="0.1 0.02 0" rpy="0.3 0 0.2"/><mass value="3"/>
  <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0.002" izz="0.04"/></inertial></link>
<link name="two"><inertial><origin xyz="0 0.2 0"/><mass value="2"/>
  <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.02"/></inertial></link>
<link name="left"><inertial><origin xyz="0 0 0.05"/><mass value="0.4"/>
  <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
<joint name="a" type="revolute"><parent link="base"/><child link="one"/>
  <origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="2" velocity="3" effort="50"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/>
  <origin xyz="0.4 0 0"/><axis xyz="1 2 -1"/>
  <limit lower="-1" upper="2" velocity="3" effort="50"/></joint>
<joint name="mount" type="fixed"><parent link="two"/><child link="tool"/>
  <origin xyz="0 0 0.1" rpy="0 0.5 0"/></joint>
<joint name="finger" type="prismatic"><parent link="tool"/><child link="left"/>
  <origin xyz="0 0.02 0"/><axis xyz="0 1 0"/>
  <limit lower="0" upper="0.05" velocity="1" effort="5"/></joint></robot>"""
"""Two turning joints with a fixed tool, and a finger that slides."""
KNOWN = Uncertainty(payload=0.5, friction=0.3)


def shoulder_arm(rates: str = 'derived', uncertainty: Uncertainty = KNOWN) -> SerialArm:
    """Three joints: the base turns about the vertical, shoulder and elbow lift."""
    arm = with_rates(fault_injection.shoulder_arm(), rates)
    return replace(arm, name='shoulder', uncertainty=uncertainty)


def with_rates(arm: SerialArm, rates: str, **changes) -> SerialArm:
    """An arm whose rates come from elsewhere, and other changes."""
    joints = (replace(j, sensors=replace(j.sensors, rates=rates)) for j in arm.joints)
    return replace(arm, joints=tuple(joints), **changes)


def simulated(arm, *faults, pushes=(), seed=1, duration=8.0, plant=None) -> Run:
    """A run of the arm with a plant that its model does not know exactly."""
    plant = wrong_chain(arm, np.random.default_rng(seed)) if plant is None else plant
    return simulated_run(arm, duration, *faults, plant=plant, pushes=pushes, seed=seed)


def watch(arm, run) -> SerialMonitor:
    """The monitor of an arm after a run."""
    monitor = SerialMonitor(arm)
    monitor.update_many(run.stamps, run.samples)
    return monitor


def without(run, rows) -> Run:
    """A run of which some samples are lost."""
    return Run(*(np.delete(one, rows, axis=0) for one in run))
