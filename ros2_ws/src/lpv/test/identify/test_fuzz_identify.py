import numpy as np
import pytest
from bags import storage, write_measurements
from fuzzing import fuzz, mutate_bytes, mutate_text

from lpv.identify.estimation.identification import identify
from lpv.identify.recordings.motion import find_bandwidths, split
from lpv.identify.recordings.recording import Recording, clean, read_recording

pytestmark = [pytest.mark.fuzz, pytest.mark.usefixtures('quiet')]


NO_FILTER = ('.2.effort',)
"""Bandwidth of efforts that are not known to be filtered: infinite."""


def use(recording):
    """All that is done with a recording before the regression."""
    segments = split(recording)
    return recording, segments, find_bandwidths(segments)


def short(recording, count=700):
    """Copies of its first samples: times, positions, rates, efforts."""
    part = recording.rows(slice(count))
    return [np.array(one) for one in (part.time, part.position, part.velocity, part.effort)]


@pytest.mark.parametrize('kind', ['csv', 'bag'])
def test_given_mutated_files_when_read_then_samples_are_finite(recording, arm, tmp_path, kind):
    names, path = arm.joint_names, tmp_path / f'recording.{kind}'
    if kind == 'bag':
        file, mutate = storage(write_measurements(path, names, *short(recording))), mutate_bytes
        content = file.read_bytes()
    else:
        fields = ('position', 'velocity', 'effort')
        header = 'time,' + ','.join(f'{name}_{field}' for field in fields for name in names)
        np.savetxt(path, np.column_stack(short(recording)), '%.6g', ',', header=header, comments='')
        file, mutate, content = path, mutate_text, path.read_text()
    assert fuzz(40, lambda seed: file.write_bytes(mutate(content, seed)),
                lambda: use(read_recording(path, names)), unbounded=NO_FILTER).refused  # fmt: skip


def _wrong_value(rng, time, *values):
    field, some = values[rng.integers(3)], rng.integers(len(time), size=5)
    kind = rng.integers(5)
    if kind == 0:
        for each in values:
            each[rng.random(len(time)) < rng.choice((0.01, 0.2, 0.9))] = np.nan
    elif kind == 1:
        field[some] = rng.choice((1e300, -1e300, 1e30, np.inf))
    elif kind == 2:
        field[:] *= rng.choice((0.0, 1e-300, 1e-12, 1e12, 1e300))
    elif kind == 3:
        field[:] = rng.standard_normal(field.shape)
    else:  # only one joint moves
        still = np.arange(field.shape[1]) != rng.integers(field.shape[1])
        for each in values[:2]:
            each[:, still] = 0.0


def _wrong_time(rng, time, *values):
    start, kind = rng.integers(len(time)), rng.integers(5)
    if kind == 0:
        time[start:] -= rng.choice((1e-3, 1.0, 1e6))
    elif kind == 1:
        time[start:] += rng.choice((0.3, 10.0, 1e9))
    elif kind == 2:
        rng.shuffle(time)
    elif kind == 3:
        time[:] = time[start]
    else:
        time[rng.integers(len(time), size=5)] = rng.choice((np.nan, np.inf, -np.inf, 1e300))


def damaged(recording: Recording, seed: int) -> list[np.ndarray]:
    """Time, positions, rates and efforts of a recording to which one or two things happened."""
    rng, parts = np.random.default_rng(seed), short(recording, None)
    if rng.random() < 0.2:
        count = rng.integers(len(parts[0]))
        parts = [part[:count] for part in parts]
    for damage in rng.choice((_wrong_value, _wrong_time), rng.integers(1, 3)):
        if len(parts[0]):
            damage(rng, *parts)
    return parts


@pytest.mark.slow
@pytest.mark.parametrize(('count', 'every'), [(80, 1), (3, 3)], ids=['cleaned', 'identified'])
def test_given_damaged_samples_when_used_then_all_is_finite(recording, rough_arm, count, every):
    samples, whole = [], recording.rows(slice(0, 1200 if every > 1 else None, every))

    def read():
        time, *others = samples.pop()
        found = clean('r', [time], *others)
        if every == 1:
            return use(found)
        result = identify(rough_arm, [found])
        return result.arm.parameter_vector(), result.figures, result.fit.covariance

    tally = fuzz(
        count, lambda seed: samples.append(damaged(whole, seed)), read, every == 1,
        unbounded=NO_FILTER)  # fmt: skip
    assert tally.refused or every > 1
