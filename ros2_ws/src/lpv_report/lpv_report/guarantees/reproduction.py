"""Whether some gains give the estimates that a bag holds."""

from dataclasses import dataclass

import numpy as np

from lpv_bag.run.streams import RunRecord
from lpv_core.certificate.gains import Gains
from lpv_core.model.arm import ArmParameters
from lpv_core.monitoring.monitor import SensorMonitor

_SAME = 1e-6
"""Larger differences are no rounding [rad]."""
_MOST = 200_000
"""Measurements that are used."""


@dataclass(frozen=True)
class Reproduction:
    """Comparison of recorded and recomputed fault estimates."""

    samples: int  # compared ones
    largest: float  # largest difference of a fault estimate [rad]

    @property
    def same(self) -> bool:
        """Whether they differ by rounding at most."""
        return self.largest <= _SAME

    @property
    def text(self) -> str:
        """One sentence for the reader."""
        if self.same:
            return (
                f'With these gains the diagnosis, run again over {self.samples} recorded '
                'measurements, gives the recorded fault estimates.'
            )
        return (
            'With these gains the diagnosis, run again over the recorded measurements, gives '
            f'other fault estimates than the recorded ones (up to {self.largest:.3g} rad): '
            'the recording began after the diagnosis, messages are missing, or the run had other '
            'gains, settings or another source of torques.'
        )


def reproduce(record: RunRecord, arm: ArmParameters, gains: Gains) -> Reproduction | None:
    """Run the observer again over the measurements of a run."""
    recorded = record.aligned('fault_estimate', 'estimate')
    if recorded is None:
        return None
    recorded = recorded[:_MOST]
    monitor = SensorMonitor('', arm, gains)
    answers = monitor.take_many(
        record.stamps['joint_states'][:_MOST],
        *(
            record.streams['joint_states'][name][:_MOST]
            for name in ('position', 'velocity', 'effort')
        ),
    )
    both = answers.has_fault & np.isfinite(recorded).all(axis=1)
    if not both.any():
        return None
    gap = np.abs(answers.fault.estimate[both] - recorded[both])
    return Reproduction(int(both.sum()), float(gap.max()))
