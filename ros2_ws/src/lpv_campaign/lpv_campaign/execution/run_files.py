"""The files of one run: arm, scenario, gains and parameters, as the nodes read them."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from lpv_campaign.execution.runs import RunPlan
from lpv_core.certificate.gains import save_gains
from lpv_core.model.arm import ArmParameters, load_arm
from lpv_core.simulation.scenario import Scenario, load_scenario
from lpv_core.support.errors import LpvError

NAMES = ('arm.yaml', 'scenario.yaml', 'gains.yaml', 'parameters.yaml')
"""Of the files; ``parameters.yaml`` is one parameter file for all nodes."""


def arm_to_dict(arm: ArmParameters) -> dict[str, Any]:
    """Content of an arm file."""
    return {
        'name': arm.name,
        'inertia_reference': arm.inertia_reference,
        'gravity': arm.gravity,
        'links': [asdict(link) for link in arm.links],
        'rotor': {'inertia': arm.rotor_inertia, 'gear_ratio': arm.gear_ratio},
        'friction': {
            'viscous': list(arm.viscous),
            'coulomb': list(arm.coulomb),
            'coulomb_slope': arm.coulomb_slope,
        },
        'joints': {
            'names': list(arm.joint_names),
            'zero_angle': arm.zero_angle,
            'velocity_limit': list(arm.velocity_limit),
        },
        'sensors': {
            'names': list(arm.sensor_names),
            'arrangement': arm.arrangement,
            'position_noise': arm.position_noise,
            'velocity_noise': arm.velocity_noise,
            'velocity_error': arm.velocity_error,
            'rates': arm.rates,
        },
        'disturbance': {
            'direction': list(arm.disturbance_direction),
            'mean': arm.disturbance_mean,
            'variance': arm.disturbance_variance,
        },
        'torque_limit': list(arm.torque_limit),
        'torque_tolerance': list(arm.torque_tolerance),
        'region': {'orientation': arm.orientation, 'cos_min': list(arm.cos_min)},
        'model_error': arm.model_error,
        'payload': arm.payload,
        'sample_time': arm.sample_time,
    }


def scenario_to_dict(scenario: Scenario) -> dict[str, Any]:
    """Content of a scenario file."""
    path: dict[str, Any] = {
        'elbow': scenario.elbow,
        'waypoints': [
            {'t': t, 'x': x, 'y': y} for t, (x, y) in zip(scenario.times, scenario.points)
        ],
    }
    if scenario.obstacle is not None:
        path['obstacle'] = {
            'center': list(scenario.obstacle.center),
            'radius': scenario.obstacle.radius,
        }
    plant: dict[str, Any] = {
        'model': scenario.plant,
        'sinc_min': scenario.sinc_min,
        'mass_factors': list(scenario.mass_factors),
        'inertia_factors': list(scenario.inertia_factors),
        'payload': scenario.payload,
        'friction_factor': scenario.friction_factor,
        'noise_factor': scenario.noise_factor,
        'disturbance_factor': scenario.disturbance_factor,
    }
    if scenario.plant == 'mujoco':
        plant['coulomb'] = scenario.coulomb
    return {
        'name': scenario.name,
        'duration': scenario.duration,
        'seed': scenario.seed,
        'noise': scenario.noise,
        'disturbance': scenario.disturbance,
        'plant': plant,
        'path': path,
        'faults': [asdict(fault) for fault in scenario.faults],
    }


def node_parameters(plan: RunPlan) -> dict[str, Any]:
    """Content of a parameter file with what a run's nodes have other than their defaults."""
    return {
        '/**': {
            'ros__parameters': {
                'lockstep': True,
                'diagnosis': asdict(plan.parameters),
                'compensation': plan.compensation,
                'substeps': plan.substeps,
            }
        }
    }


def write_run_files(plan: RunPlan, folder: str | Path) -> None:
    """Write the files with which the graph repeats a run."""
    folder = Path(folder)
    arm, scenario, gains, parameters = (folder / name for name in NAMES)
    for path, content in (
        (arm, arm_to_dict(plan.arm)),
        (scenario, scenario_to_dict(plan.scenario)),
        (parameters, node_parameters(plan)),
    ):
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding='utf-8')
    save_gains(plan.gains, gains, f'Gains of run {plan.number} ({plan.scenario.name}).')
    for path, found, expected in (
        (arm, load_arm(arm), plan.arm),
        (scenario, load_scenario(scenario), plan.scenario),
    ):
        if found != expected:
            raise LpvError(f'{path}: does not describe what was simulated')
