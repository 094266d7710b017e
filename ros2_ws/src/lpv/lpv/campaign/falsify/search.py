"""Search for the healthy run that comes nearest to its threshold: random, structured, CMA-ES."""

from collections.abc import Callable
from dataclasses import asdict
from itertools import cycle
from pathlib import Path

import numpy as np
from cmaes import CMA

from lpv.bag.rosbag.writing import BagWriter
from lpv.campaign.falsify.attack import Attack, Attacker, Finding
from lpv.campaign.falsify.healthy_run import RATE_SCALE
from lpv.core.serial_arm.chain import FloatArray
from lpv.core.support.config import read_yaml, write_yaml
from lpv.core.support.errors import ConfigError

SCENARIO, BAG = 'worst.yaml', 'worst_bag'
LONGEST = 3600.0
"""Longest run [s]."""
_RANDOM = 0.2
"""Share of evaluations at random, beside the structured ones."""
_PATIENCE = 60
"""Generations of one optimisation before it starts again elsewhere."""


def search(
    attacker: Attacker,
    evaluations: int,
    seed: int = 0,
    progress: Callable[[int, Finding], None] | None = None,
    found: list[Finding] | None = None,
) -> list[Finding]:
    """Attacks, the worst first; ``progress`` gets the number of runs and each worst one so far.

    A list that is given as ``found`` is filled on the way: what ends the search leaves it.
    """
    rng, found = np.random.default_rng(seed), [] if found is None else found

    def ratio(candidate: FloatArray) -> float:
        found.append(attacker.run(attacker.attack(candidate, int(rng.integers(2**31)))))
        last = found[-1]
        if progress is not None and last.ratio > max((f.ratio for f in found[:-1]), default=-1.0):
            progress(len(found), last)
        return last.ratio

    def left() -> bool:
        return len(found) < evaluations

    structured = attacker.structured(rng)[:evaluations]
    rest = max(0, min(round(_RANDOM * evaluations), evaluations) - len(structured))
    first = [*structured, *rng.uniform(-1.0, 1.0, (rest, attacker.numbers))]
    best = sorted(((ratio(candidate), k) for k, candidate in enumerate(first)), reverse=True)
    bounds, means = np.tile([-1.0, 1.0], (attacker.numbers, 1)), cycle(k for _, k in best[:8])
    while left():
        mean, seed = 0.95 * first[next(means)], int(rng.integers(2**31))
        optimiser = CMA(mean=mean, sigma=0.3, bounds=bounds, seed=seed)
        for _ in range(_PATIENCE):
            answers = []
            for _ in range(optimiser.population_size):
                candidate = optimiser.ask()
                answers.append((candidate, -ratio(candidate) if left() else 0.0))
            optimiser.tell(answers)
            if optimiser.should_stop() or not left():
                break
    return sorted(found, key=lambda finding: -finding.ratio)


def write_worst(attacker: Attacker, worst: Finding, folder: str | Path) -> None:
    """Write the worst attack as YAML, and the measurements of its run as a bag that replays."""
    folder, arm = Path(folder), attacker.arm
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        'ratio': worst.ratio,
        'sensor': arm.sensor_names[worst.sensor],
        'time': float(worst.times[worst.sensor]),
        'threshold': float(worst.thresholds[worst.sensor]),
        'duration': len(attacker.samples) * arm.sample_time,
        'attack': asdict(worst.attack),
    }
    write_yaml(folder / SCENARIO, content)
    attacker.run(worst.attack)
    with BagWriter(folder / BAG, 'zstd_small') as writer:
        stamps, samples = attacker.received(worst.attack)
        rows = zip(stamps.tolist(), *samples.swapaxes(0, 1).tolist())
        writer.write_joint_states('/lpv/joint_states', arm.joint_names, rows)


def read_attack(path: str | Path) -> tuple[Attack, float]:
    """Attack and duration [s] of a file that `write_worst` wrote; ConfigError if it is none."""
    data = read_yaml(path)
    try:
        attack, duration = Attack(**data['attack']), float(data['duration'])
        numbers = [*np.ravel(attack.joints), *attack.shares, *attack.offsets, attack.rest]
        numbers.append(attack.disturbance)
        if not (np.isfinite(numbers).all() and 0.0 < duration <= LONGEST and attack.lost >= 0):
            raise ValueError(f'no finite numbers of at most {LONGEST:g} s')
    except (KeyError, TypeError, ValueError) as error:
        reason = f'is not that of lpv falsify ({error})'
        raise ConfigError('attack', reason, str(path)) from None
    return attack, duration


def repeat(attacker: Attacker, attack: Attack, path: str | Path) -> Finding:
    """Run the attack of a file again; ConfigError if it is of another arm."""
    n, count = attacker.samples.shape[2], attacker.range.count
    given = len(attack.shares), len(attack.offsets), len(attack.signs) or n
    alike = len({len(each) for each in attack.signs}) <= 1
    if np.shape(attack.joints) != (RATE_SCALE + 1, n) or given != (count, n, n) or not alike:
        reason = (
            f'is of another arm: joints must have shape {RATE_SCALE + 1, n}, shares {count} '
            f'numbers, offsets {n}, signs none or {n} texts of one length'
        )
        raise ConfigError('attack', reason, str(path))
    return attacker.run(attack)
