"""What an estimator knows of the faults: from their onset and shape, to nothing at all.

Each model is one unknown number ``p`` that acts on one sensor: constant, a random walk, or new at
every sample.  The reading of sensor i is ``S_i theta + shape * p`` (additive), or the rate's
reading is (rate), or ``S_i theta * (1 + shape * p)`` (scale).
"""

from dataclasses import dataclass

import numpy as np

from lpv_core.model.arm import ArmParameters
from lpv_core.simulation.closed_loop import Run
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import Scenario

ADDITIVE, SCALE, RATE = range(3)
WIDE = 1.0
"""Standard deviation of an amplitude before any data [rad], [rad/s], or relative."""
ARBITRARY = 10.0
"""Standard deviation of a fault that may be anything at every sample [rad]."""
FAULT_WALK = 0.02
"""Random walk of the faults as Kalman filters assume it [rad/sqrt(s)]."""


@dataclass(frozen=True)
class FaultModel:
    """One unknown number that acts on one sensor."""

    sensor: int  # Index of the physical sensor
    shape: np.ndarray  # (n,) Effect of the number at each sample; zero where it has none
    # True amplitude; zero where it does not matter, because the reading is linear in it
    truth: float = 0.0
    kind: int = ADDITIVE  # ADDITIVE, SCALE or RATE
    # 1 for a constant or a random walk, 0 for a number that is new at every sample
    memory: float = 1.0
    growth: float = 0.0  # Variance that each sample adds
    deviation: float = WIDE  # Standard deviation before any data


def acting(fault: Fault, time: np.ndarray, settle: float = 0.0) -> np.ndarray:
    """When a fault acts.

    Returns ndarray of bool of shape (n,): True while it acts.
    """
    end = fault.onset + fault.duration if fault.duration > 0.0 else np.inf
    return (time >= fault.onset + settle) & (time < end)


def known_shape(arm: ArmParameters, scenario: Scenario, run: Run) -> list[FaultModel]:
    """Know kind, onset, end and time profile of every scheduled fault, but not its size.

    A bias is an unknown constant, a drift an unknown rate, a scale fault an unknown factor; a
    stuck reading says nothing; noise is white with known variance; it is known which samples a
    spike has hit.  Dropouts need no model.

    Parameters
    ----------
    arm : ArmParameters
        Names of the sensors.
    scenario : Scenario
        Its faults.
    run : Run
        For time, and for where spikes are.

    Returns
    -------
    list of FaultModel
        One a fault.
    """
    models = []
    for fault in scenario.faults:
        sensor, on = arm.sensor_names.index(fault.sensor), acting(fault, run.time).astype(float)
        if fault.kind == 'bias':
            models.append(FaultModel(sensor, on))
        elif fault.kind == 'drift':
            grown = np.maximum(run.time - fault.onset, 0.0)
            if fault.size:
                grown = np.minimum(grown, abs(fault.size / fault.rate))
            models.append(FaultModel(sensor, on * grown))
        elif fault.kind == 'scale':
            models.append(FaultModel(sensor, on, fault.size, SCALE))
        elif fault.kind == 'rate_bias':
            models.append(FaultModel(sensor, on, 0.0, RATE))
        elif fault.kind == 'noise':
            models.append(_white(sensor, on, fault.size))
        elif fault.kind == 'stuck':
            models.append(_white(sensor, on, ARBITRARY))
        elif fault.kind == 'spike':
            hit = np.nan_to_num(np.abs(run.fault[:, sensor])) > 0.0
            models.append(_white(sensor, on * hit, ARBITRARY))
    return models


def biases_since(run: Run, onset: float) -> list[FaultModel]:
    """Allow an unknown constant on both sensors from a time on."""
    return [FaultModel(i, (run.time >= onset).astype(float)) for i in range(2)]


def random_walks(arm: ArmParameters, run: Run, walk: float = FAULT_WALK) -> list[FaultModel]:
    """Allow a random walk on both sensors at all times, as Kalman filters do."""
    return [
        FaultModel(i, np.ones(len(run.time)), growth=walk**2 * arm.sample_time, deviation=1e-3)
        for i in range(2)
    ]


def anything(run: Run) -> list[FaultModel]:
    """Assume nothing of the faults of both sensors after the first sample, as our observer
    does.
    """
    later = np.ones(len(run.time))
    later[0] = 0.0
    return [_white(i, later, ARBITRARY) for i in range(2)]


def _white(sensor: int, shape: np.ndarray, deviation: float) -> FaultModel:
    return FaultModel(sensor, shape, memory=0.0, growth=deviation**2, deviation=deviation)
