"""The figures of a campaign's run, for a bag that holds the truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from lpv_campaign.execution.run_metrics import figures
from lpv_core.decision.diagnosis import Alarm
from lpv_core.model.arm import ArmParameters
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import Scenario, load_scenario
from lpv_core.support.errors import LpvError
from lpv_core.support.timestamps import NANOSECONDS

STREAMS = ('ground_truth', 'reference', 'torque_command')
MOST_SAMPLES = 1_000_000
"""Longest truth that is held in memory: half an hour at 500 Hz."""
_UNKNOWN = 'unknown'


@dataclass
class _Plan:
    arm: ArmParameters
    scenario: Any


class TruthKeeper:
    """Keeps what the figures against the truth need.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    """

    def __init__(self, arm: ArmParameters) -> None:
        self._arm, self._count = arm, 0
        self._parts: dict[str, list[dict[str, np.ndarray]]] = {}

    def take(self, measured: Any, answers: Any, streams: dict[str, Any]) -> None:
        """Keep a block, as `lpv_bag.replay.replay.Replay.watch` hands it on."""
        if 'ground_truth' not in streams:
            return  # memory must not grow with the length of such a bag
        if streams['ground_truth'] is not None:
            self._count += len(streams['ground_truth'][0])
        if self.is_too_long:
            self._parts.clear()
            return
        for name in STREAMS:
            if streams.get(name) is not None:
                self._keep(name, *streams[name])
        rows = np.flatnonzero(answers.answered & answers.has_fault)
        state, fault = answers.state[rows], answers.fault[rows]
        self._keep(
            'answers',
            measured.stamp[rows],
            {
                'estimate': state.position,
                'estimated_velocity': state.velocity,
                'fault_estimate': fault.estimate,
                'threshold': fault.threshold,
                'inconsistent': answers.inconsistent[rows],
            },
        )

    def _keep(self, name: str, stamps: np.ndarray, values: dict[str, np.ndarray]) -> None:
        parts = self._parts.setdefault(name, [])
        parts.append(
            {'stamp': stamps.copy(), **{field: np.array(array) for field, array in values.items()}}
        )

    @property
    def is_too_long(self) -> bool:
        """Whether the truth is too long to be held."""
        return self._count > MOST_SAMPLES

    def row(self, events: Sequence[Alarm], scenario: Scenario | None = None) -> dict[str, Any]:
        """Figures of the bag."""
        if self.is_too_long or not {'ground_truth', 'answers'} <= set(self._parts):
            return {}
        tables = {name: _sorted(parts) for name, parts in self._parts.items()}
        stamps = tables['ground_truth']['stamp']
        run = _run(tables, stamps)
        run.alarms = [_moved(event, int(stamps[0])) for event in events]
        faults = faults_in_truth(self._arm, run) if scenario is None else scenario.faults
        seed = -1 if scenario is None else scenario.seed
        with np.errstate(invalid='ignore', divide='ignore'):
            found = figures(_Plan(self._arm, SimpleNamespace(faults=faults, seed=seed)), run)
        if 'reference' not in tables:
            found['stable'] = None
        return found


def scenario_of(bag: str | Path, arm: ArmParameters) -> Scenario | None:
    """Scenario stored in a bag's folder, as ``lpv campaign --run`` writes it.

    Returns None where there is none that fits.
    """
    path = Path(bag) / 'scenario.yaml'
    if not path.is_file():
        return None
    try:
        scenario = load_scenario(path)
    except LpvError:
        return None
    known = set(arm.sensor_names)
    return scenario if {f.sensor for f in scenario.faults} <= known else None


def faults_in_truth(arm: ArmParameters, run: Any) -> tuple[Fault, ...]:
    """Faults as the truth shows them: for each sensor, from the first sample with one to the
    last.

    Returns their kind is ``unknown``; a dropout is NaN, which is not zero either.
    """
    found = []
    for i, sensor in enumerate(arm.sensor_names):
        rows = np.flatnonzero(run.fault[:, i] != 0.0)
        if len(rows):
            onset = float(run.time[rows[0]])
            lasts = rows[-1] == len(run.time) - 1
            end = 0.0 if lasts else float(run.time[rows[-1] + 1]) - onset
            found.append(
                Fault(
                    sensor,
                    _UNKNOWN,
                    onset,
                    end,
                    float(np.nan_to_num(np.abs(run.fault[rows, i])).max()),
                )
            )
    return tuple(found)


def _run(tables: dict[str, dict[str, np.ndarray]], stamps: np.ndarray) -> SimpleNamespace:
    """Signals on the stamps of the truth; what is not said again stays as it was."""
    truth, answers = tables['ground_truth'], tables['answers']
    run = SimpleNamespace(
        time=(stamps - stamps[0]) / NANOSECONDS,
        fault=truth['fault'],
        position=truth['position'],
        velocity=truth['velocity'],
        torque=truth['torque'],
    )
    last = np.searchsorted(answers['stamp'], stamps, side='right') - 1
    for name, values in answers.items():
        if name != 'stamp':
            held = values[np.maximum(last, 0)]
            held[last < 0] = 0
            setattr(run, name, held)
    run.reference = np.full((len(stamps), 2), np.nan)
    if 'reference' in tables:
        place = np.searchsorted(tables['reference']['stamp'], stamps, side='right') - 1
        run.reference = tables['reference']['position'][np.maximum(place, 0)]
    run.braked = np.zeros(len(stamps), bool)
    if 'torque_command' in tables:
        commands = tables['torque_command']
        place = np.searchsorted(commands['stamp'], stamps, side='right') - 1
        stop = commands['safe_stop'].reshape(-1).astype(bool)
        run.braked = np.where(place < 0, True, stop[np.maximum(place, 0)])
    return run


def _sorted(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    # Of several messages with one stamp the last one counts.
    stamps, last = np.unique(table['stamp'][::-1], return_index=True)
    rows = len(table['stamp']) - 1 - last
    return {name: stamps if name == 'stamp' else values[rows] for name, values in table.items()}


def _moved(event: Alarm, start: int) -> SimpleNamespace:
    return SimpleNamespace(
        event=event.event,
        sensor=event.sensor,
        kind=event.kind,
        size=event.size,
        onset=event.onset - start,
        detected=event.detected - start,
    )
