"""Readings that may be frozen, by what they did before they came to rest."""

import math
from collections.abc import Collection, Sequence

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.decision import STILL_TIME
from lpv.core.serial_arm.diagnosis.readings import Readings
from lpv.core.serial_arm.diagnosis.sampler import BEFORE_STOP, LIVELY
from lpv.core.serial_arm.diagnosis.sensor_state import SensorRecord
from lpv.core.serial_arm.diagnosis.stuck import Frozen


def frozen_readings(
    readings: Readings, sensors: Sequence[SensorRecord], smallest: FloatArray, is_wrong: bool
) -> dict[int, Frozen]:
    """Readings that stopped dead while they moved, or have lost their noise, or froze before.

    Rounding and usual braking explain a part of the rate before.  Readings that have not
    changed since the first sample may be frozen as well, if something ``is_wrong``.  ``smallest``,
    shape (n,), are the smallest steps that are faults [rad].
    """
    sampler, period, found = readings.sampler, readings.sample_time, dict[int, Frozen]()
    if max(sampler.still.tolist()) * period <= STILL_TIME:
        return found
    measured, lively = BEFORE_STOP * period, sampler.lively > LIVELY
    # Brakes stop all joints at once, and silence their readings; sensors do not fail together.
    apart = np.abs(sampler.still - sampler.still[:, None]) * period
    np.fill_diagonal(apart, math.inf)
    lively &= apart.min(axis=1) > STILL_TIME
    # A noisy reading leaves as much in the balances as a joint that moves unseen.
    is_wrong &= not any(one.active and one.kind == 'noise' for one in sensors)
    for i in np.flatnonzero(sampler.still * period > STILL_TIME).tolist():
        rounding, rate = float(sampler.grain[i]) / measured, float(sampler.stop[i])
        least = max(float(smallest[i]), sampler.grain[i])
        alive, speed = bool(lively[i]), abs(rate) - rounding
        time = readings.rests_since(i)
        usual = priors.USUAL_RATE * float(readings.estimator.balance.scale[i])
        if sensors[i].kind == 'stuck':  # while its alarm is up, any rest may be a freeze
            found[i] = Frozen(time, 0.0, usual, alive)
        if is_wrong and math.isinf(sampler.grain[i]):
            found[i] = Frozen(time, 0.0, usual, alive=False, seen=False)
        if not alive and speed * STILL_TIME <= least:
            continue  # joints that rest are many, and usual accelerations take time
        acceleration = readings.acceleration(i)
        braking = 0.5 * measured * acceleration
        if alive or (speed - braking) * STILL_TIME > least:
            found[i] = Frozen(time, rate, readings.stop_sigma(i, acceleration), alive)
    return found


def frozen_with(
    readings: Readings, frozen: dict[int, Frozen], i: int, known: Collection[int]
) -> list[int]:
    """Sensors that froze in the same sample as sensor i: they share a bus, cable or driver.

    Two readings that stop dead out of motion at once are no chance, as rests that begin so are.
    Those whose fault is ``known`` are left out.
    """
    still = readings.sampler.still
    together = np.flatnonzero(still == still[i]).tolist()
    stopped = {j for j, one in frozen.items() if one.seen and one.rate != 0.0}
    if i not in stopped or len(stopped.intersection(together)) < 2:
        return []
    return [j for j in together if j != i and j not in known]
