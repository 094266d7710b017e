"""Rates that an arm's file calls independent, and that may be derived from their readings."""

import numpy as np

from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.sampler import Sampler
from lpv.core.serial_arm.rate_independence import PROVED, SAMPLES, rate_source
from lpv.core.support.timestamps import NANOSECONDS


class RateSources:
    """What the samples say of each rate that is called independent, until that is proved.

    Attributes
    ----------
    probe : int
        Samples in a row that are needed.
    """

    def __init__(self, arm: SerialArm) -> None:
        self._unproved = np.flatnonzero(arm.sensors().independent).tolist()
        self.probe = SAMPLES if self._unproved else 0
        self._probed = 0  # samples

    def judge(self, sampler: Sampler, usual: bool) -> list[int]:
        """Joints whose rates are derived, by the samples that were collected.

        Where they are not ``usual``, nothing is found to be derived yet.
        """
        probe, n = sampler.probe, len(sampler.derived)
        stamps, derived, unproved = np.round(NANOSECONDS * probe[:, 0]), list[int](), list[int]()
        for i in self._unproved:
            found = rate_source(stamps, probe[:, 1 + i], probe[:, 1 + n + i])
            if found.explained > PROVED:
                derived.append(i)
            elif found.source != 'independent':
                unproved.append(i)
        if derived and usual:
            return derived
        self._unproved = sorted(derived + unproved)
        self._probed += len(probe)
        # As many samples later: what did not show so far may never do.
        sampler.state['probed'][0] = -self._probed if self._unproved else len(probe) + 1
        return []
