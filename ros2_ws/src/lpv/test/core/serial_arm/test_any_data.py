from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as some
from places import BRINGUP
from serial_arms import mixed_arm, with_rates

from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm import arm_file, chain
from lpv.core.serial_arm.description import JointLimits
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.serial_arm.dynamics.model import SerialModel

RATES = ('derived', 'independent', 'none')
SPOILS = (
    'rests', 'constant', 'rounded 0.1 mrad', 'rounded 1 mrad', 'repeated', 'missing', 'no rates',
    'no efforts', 'duplicates', 'steps of the clock', 'odd stamps', 'gap', 'huge', 'jump', 'frozen',
    'wraps', 'differences', 'unread', 'jumps at every sample', 'zero rates', 'zero efforts',
    'idle drives',
)  # fmt: skip
SPOILT = some.lists(some.sampled_from(SPOILS), max_size=5, unique=True)
FREQUENCIES = some.sampled_from([30.0, 100.0, 250.0, 500.0, 1000.0])


def arm_of(rng, joints, sample_time):
    """A shipped arm, or one of any shape with joints of both types."""
    arm = mixed_arm(int(rng.integers(2**31)), joints)
    if joints == 6 or (joints == 7 and rng.random() < 0.5):
        arm = arm_file.load_arm(BRINGUP / 'arms' / ('ur10.yaml' if joints == 6 else 'panda.yaml'))
    first, *others = with_rates(arm, rng.choice(RATES), sample_time=sample_time).joints
    if first.type == 'revolute' and rng.random() < 0.5:  # without limits, its reading may wrap
        first = replace(first, limits=JointLimits(velocity=first.limits.velocity))
    return replace(arm, joints=(first, *others), sample_time=sample_time)


def recording(rng, arm, count):
    n, period = len(arm.joints), arm.sample_time
    t, pace = period * np.arange(count)[:, None], rng.uniform(0.5, 4.0, n)
    phase, size = pace * t + rng.uniform(-3.0, 3.0, n), rng.uniform(0.0, 1.0, n)
    q, v, a = size * np.sin(phase), size * pace * np.cos(phase), -size * pace**2 * np.sin(phase)
    model = SerialModel(chain.compile_chain(arm))
    samples = np.stack([q, v, model.torque(q, v, a)], 1)
    samples[:, 0] += rng.choice([0.0, 1e-4]) * rng.normal(size=q.shape)
    return np.round(1e9 * period * np.arange(count)).astype(np.int64) + 10**15, samples


def spoil(rng, kind, stamps, samples):
    """Change a recording in place as bad drivers, sensors and clocks do."""
    count, n = len(stamps), samples.shape[2]
    begin, end = np.sort(rng.integers(0, count, 2))
    part, of = slice(begin, end + 1), rng.random(n) < 0.5
    of[rng.integers(n)] = True
    if kind == 'rests':
        samples[:end, 0], samples[:end, 1], samples[:end, 2] = samples[end, 0], 0.0, samples[end, 2]
    elif kind == 'constant':
        samples[:, :, of] = samples[0][:, of]
    elif kind.startswith('rounded'):
        step = 1e-4 if '0.1' in kind else 1e-3
        samples[:, 0] = np.round(samples[:, 0] / step) * step
    elif kind == 'repeated':
        samples[1::2] = samples[: 2 * (count // 2) : 2]
    elif kind in ('missing', 'no rates'):
        samples[np.ix_(np.arange(begin, end + 1), [int(kind == 'no rates')], of)] = np.nan
    elif kind == 'no efforts':
        samples[part, 2] = np.nan
    elif kind in ('zero rates', 'zero efforts'):
        samples[:, 1 + (kind == 'zero efforts')] = 0.0
    elif kind == 'idle drives':
        samples[:, 2, of] = 0.0
    elif kind == 'duplicates':
        again = rng.integers(1, count, 5)
        stamps[again] = stamps[again - 1]
    elif kind == 'steps of the clock':
        stamps[begin:] += rng.integers(-5, 6) * 10**9
        stamps[end:] += rng.choice([-(10**12), 10**12])
    elif kind == 'odd stamps':
        odd = rng.integers(0, count, 4)
        stamps[odd] = rng.choice([0, -1, 2**31 * 10**9, 10**15 - 3 * 10**8], 4)
    elif kind == 'gap':
        stamps[begin:] += rng.integers(10**6, 2 * 10**9)
    elif kind == 'huge':
        samples[begin, rng.integers(0, 3), of] = rng.choice([np.inf, -1e300, 1e5, 1e12])
    elif kind == 'jump':
        samples[begin:, 0, of] += rng.uniform(-1.0, 1.0)
    elif kind == 'jumps at every sample':
        rows = np.arange(begin, end + 1)
        samples[np.ix_(rows, [0], of)] += (rows - begin)[:, None, None]
    elif kind == 'unread':
        samples[part] = 0.0
    elif kind == 'wraps':
        samples[:, 0, 0] += np.pi - samples[begin, 0, 0]
        samples[:, 0, 0] = (samples[:, 0, 0] + np.pi) % (2.0 * np.pi) - np.pi
    elif kind == 'differences':  # whatever the file calls its rates
        samples[1:, 1] = 1e9 * np.diff(samples[:, 0], axis=0) / np.diff(stamps).clip(1)[:, None]
    elif kind == 'frozen':
        samples[np.ix_(np.arange(begin, count), [0, 1], of)] = samples[begin, :2][:, of]


def values(answers):
    found = {'answered': answers.answered, 'restarted': answers.restarted}
    for part in ('state', 'fault'):
        rows = np.asarray(getattr(answers, part))
        found |= {f'{part}.{name}': np.ascontiguousarray(rows[name]) for name in rows.dtype.names}
    return found


@settings(max_examples=80, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@pytest.mark.slow
@given(some.integers(1, 7), FREQUENCIES, SPOILT, some.integers(0, 2**32 - 1))
@example(1, 30.0, ['no efforts'], 0)  # counted up to each report
@example(3, 30.0, ['no efforts', 'rests', 'constant'], 419101881)  # motion begins in a part
@example(4, 500.0, ['frozen', 'wraps', 'zero efforts'], 2117931157)  # begins anew between turns
def test_given_any_data_then_answers_are_numbers_in_any_parts(joints, frequency, spoils, seed):
    rng = np.random.default_rng(seed)
    arm = arm_of(rng, joints, 1.0 / frequency)
    stamps, samples = recording(rng, arm, int(min(max(2.0 * frequency, 200), 1200)))
    for kind in spoils:
        spoil(rng, kind, stamps, samples)
    whole = SerialSensorMonitor('/uio', arm).take_many(stamps, *samples.transpose(1, 0, 2))
    expected = values(whole)
    for name, rows in expected.items():
        assert len(rows) == len(stamps) and rows.shape[1:] in {(), (joints,)}, name
        assert np.isfinite(rows.astype(float)).all(), name
    assert set(whole.state.mode) <= set(map(int, Mode))
    parts = SerialSensorMonitor('/uio', arm)
    edges = np.unique([0, *rng.integers(0, len(stamps), 6), len(stamps) - 40, len(stamps)])
    slices, last = [slice(a, b) for a, b in zip(edges, edges[1:-1])], edges[-2]
    found = [parts.take_many(stamps[s], *samples[s].transpose(1, 0, 2)) for s in slices]
    for name, rows in expected.items():
        joined = np.concatenate([values(one)[name] for one in found])
        assert joined.tobytes() == rows[:last].tobytes(), name
    for name in ('events', 'reports', 'warnings'):
        joined = [what for one in found for _, what in getattr(one, name)]
        assert joined == [what for row, what in getattr(whole, name) if row < last], name
    for k in range(last, len(stamps)):
        vectors = dict(zip(('position', 'velocity', 'effort'), samples[k]))
        answer = parts.take(int(stamps[k]), SimpleNamespace(name=arm.joint_names, **vectors))
        assert (answer is not None) == expected['answered'][k]
        if answer is not None:
            for name in ('position', 'compensated_position', 'trustworthy', 'mode'):
                assert np.array_equal(answer.record['state'][name], expected[f'state.{name}'][k])
