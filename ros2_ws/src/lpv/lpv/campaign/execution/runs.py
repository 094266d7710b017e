"""One run of a campaign: from its number to its signals and figures."""

import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lpv.campaign.execution.run_metrics import figures
from lpv.campaign.plan.campaign import Campaign
from lpv.campaign.plan.random_paths import random_path
from lpv.campaign.plan.spec import BOTH, NO_FAULT, TUNING
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.serial_arm.arm_file import to_mapping
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.closed_loop import Run, run_closed_loop
from lpv.core.simulation.scenario import Scenario, parse_scenario
from lpv.core.simulation.transport import Transport
from lpv.core.support.errors import LpvError
from lpv.core.uio.certificate.gains import Gains

_PLANT = {'plant': 'model', 'payload': 'payload', 'parameter_error': 'parameter_error'}
_PLANT |= {name: f'{name}_factor' for name in ('friction', 'noise', 'disturbance')}
"""Factors that replace a field of the scenario's plant."""


@dataclass(frozen=True)
class RunPlan:
    """What is simulated in one run."""

    number: int  # Number of the run
    values: dict  # Of the factors
    arm: SerialArm  # Nominal arm, with the run's sample time
    gains: Gains | None  # Its gains, if it needs any
    files: dict  # Content of the run's ``arm`` and ``scenario`` files
    scenario: Scenario  # The latter, parsed
    parameters: DiagnosisParameters  # Tuning of the diagnosis
    substeps: int  # Least number of plant steps per sample

    @property
    def transport(self) -> Transport:
        """How late commands are, and how many measurements are lost."""
        return Transport(int(self.values['command_delay']), self.values['sample_loss'])

    def simulate(self, faults: bool = True) -> Run:
        """Run the closed loop; ``faults=False``: its healthy twin."""
        scenario = self.scenario if faults else replace(self.scenario, faults=())
        loop = self.arm, scenario, self.gains, self.values['compensation']
        others: dict[str, Any] = {'substeps': self.substeps, 'transport': self.transport}
        return run_closed_loop(*loop, parameters=self.parameters, **others)


def plan_run(campaign: Campaign, number: int) -> RunPlan:
    """What is simulated in a run; campaign and number determine everything."""
    values, spec = campaign.values(number), campaign.spec
    # Not the generator of the plan's points, which must not depend on what else is random in a run.
    rng = np.random.default_rng([spec.seed, 2, number])
    seed = int(rng.integers(2**31))
    time = values['sample_time'] or campaign.arm.sample_time
    arm = replace(campaign.arm, sample_time=time)
    content = copy.deepcopy(campaign.content['scenarios'][spec.scenario])
    content.update(name=f'{spec.name} {number}', seed=seed)
    content['duration'] = duration = spec.duration or content['duration']
    path = values['path']
    if path == 'random':
        content['path'] = random_path(arm, rng, duration)
    elif path != 'scenario':
        content['path'] = campaign.content['scenarios'][path]['path']
    plant = content.setdefault('plant', {})
    if isinstance(plant, str):
        plant = content['plant'] = {'model': plant}
    plant.update({_PLANT[name]: values[name] for name in _PLANT if values[name] is not None})
    for name in ('mass', 'inertia'):
        given = {i: values[f'{name}_{i + 1}'] for i in (0, 1) if values[f'{name}_{i + 1}']}
        if given:
            links = list(plant.get(f'{name}_factors', [1.0] * len(arm.joints)))
            plant[f'{name}_factors'] = [given.get(i, before) for i, before in enumerate(links)]
    if 'fault.kind' in spec.factors:
        content['faults'] = _faults(arm.sensor_names, values, rng)
    tuning = {name.partition('.')[2]: values[name] for name in TUNING if name in values}
    gains, files = campaign.gains(values['design'], time), {'arm': to_mapping(arm)}
    scenario = parse_scenario(content, f'run {number}')
    files['scenario'], parameters = content, DiagnosisParameters(**tuning)
    return RunPlan(number, values, arm, gains, files, scenario, parameters, spec.substeps)


def _faults(names: tuple[str, ...], values: dict[str, Any], rng: np.random.Generator) -> list[Any]:
    kind, signs = values['fault.kind'], rng.choice([-1.0, 1.0], 2).tolist()
    if kind == NO_FAULT:
        return []
    if values['fault.sign'] is not None:
        signs = [1.0 if values['fault.sign'] >= 0.0 else -1.0] * 2
    if kind in ('noise', 'spike'):
        signs = [1.0, 1.0]  # these have no direction
    sensors = [values['fault.sensor'] or names[0]]
    if sensors == [BOTH]:
        # The two of a two-link arm; of more, two by chance.
        count = len(names)
        chosen = range(2) if count == 2 else sorted(rng.choice(count, min(2, count), replace=False))
        sensors = [names[i] for i in chosen]
    return [
        {
            'sensor': sensor,
            'kind': kind,
            'onset': values['fault.onset'],
            'duration': values['fault.duration'],
            'size': sign * values['fault.size'],
            'rate': values['fault.rate'] * (sign if kind == 'drift' else 1.0),
        }
        for sensor, sign in zip(sensors, signs)
    ]


def run_one(campaign: Campaign, number: int) -> dict[str, Any]:
    """Simulate a run and measure it; a row of the results."""
    try:
        _, _, row = repeat(campaign, number)
    except LpvError as error:
        raise LpvError(f'run {number}: {error}') from error
    return row


def repeat(campaign: Campaign, number: int) -> tuple[RunPlan, Run, dict[str, Any]]:
    """Plan of a run, what happens in it, and its row of the results."""
    plan = plan_run(campaign, number)
    run = plan.simulate()
    twin = plan.simulate(faults=False) if campaign.spec.twin and plan.scenario.faults else None
    found = figures(plan.arm, plan.scenario, run, twin)
    reasons = '; '.join(dict.fromkeys(run.stops))
    return plan, run, {'number': number, **plan.values, **found, 'stop_reasons': reasons}
