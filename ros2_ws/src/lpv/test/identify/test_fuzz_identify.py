"""Hostile recordings for identification: refused clearly, or samples and parameters are finite."""

import numpy as np
import pytest
from bags import write_measurements
from fuzzing import Tally, cases, fuzz, mutate_bytes, mutate_text

from lpv.identify.estimation.identification import identify
from lpv.identify.recordings.motion import find_bandwidths, split
from lpv.identify.recordings.recording import Recording, clean, read_recording

pytestmark = pytest.mark.fuzz
_CASES = 40


@pytest.fixture(autouse=True)
def quiet(caplog):
    caplog.set_level('CRITICAL', 'lpv.bag')


def use(recording):
    """All that is done with a recording before the regression."""
    segments = split(recording)
    return recording, segments, find_bandwidths(segments)


def short(recording, count=700):
    """Copies of its first samples: times, positions, rates, efforts."""
    part = recording.rows(slice(count))
    return [np.array(one) for one in (part.time, part.position, part.velocity, part.effort)]


def test_given_mutated_csv_files_when_read_then_samples_are_finite_or_the_reason_is_said(
    recording, arm, tmp_path
):
    names, path = arm.joint_names, tmp_path / 'r.csv'
    kinds = ('position', 'velocity', 'effort')
    header = 'time,' + ','.join(f'{name}_{kind}' for kind in kinds for name in names)
    np.savetxt(path, np.column_stack(short(recording)), '%.6g', ',', header=header, comments='')
    text = path.read_text()
    assert fuzz(
        _CASES,
        lambda seed: path.write_bytes(mutate_text(text, seed)),
        lambda: use(read_recording(path, names)),
    ).refused


def test_given_mutated_bags_when_read_then_samples_are_finite_or_the_reason_is_said(
    recording, arm, tmp_path
):
    bag = write_measurements(tmp_path / 'bag', arm.joint_names, *short(recording))
    (file,) = bag.glob('*.mcap')
    data = file.read_bytes()
    assert fuzz(
        _CASES,
        lambda seed: file.write_bytes(mutate_bytes(data, seed)),
        lambda: use(read_recording(bag, arm.joint_names)),
    ).refused


# ------------------------------------------------------------------ samples, up to the arm


def _with_nan(rng, time, *values):
    for field in values:
        field[rng.random(len(time)) < rng.choice((0.01, 0.2, 0.9))] = np.nan


def _with_huge(rng, time, *values):
    field = values[rng.integers(3)]
    field[rng.integers(len(time), size=5)] = rng.choice((1e300, -1e300, 1e30, np.inf))


def _with_scale(rng, time, *values):
    values[rng.integers(3)][:] *= rng.choice((0.0, 1e-300, 1e-12, 1e12, 1e300))


def _with_one_joint(rng, time, *values):
    """Only one joint moves."""
    moving = rng.integers(values[0].shape[1])
    for field in values[:2]:
        field[:, np.arange(field.shape[1]) != moving] = 0.0


def _with_noise(rng, time, *values):
    values[rng.integers(3)][:] = rng.standard_normal(values[0].shape)


def _back_in_time(rng, time, *values):
    start = rng.integers(len(time))
    time[start:] -= rng.choice((1e-3, 1.0, 1e6))


def _jumping_time(rng, time, *values):
    time[rng.integers(len(time)) :] += rng.choice((0.3, 10.0, 1e9))


def _shuffled(rng, time, *values):
    rng.shuffle(time)


def _stuck_time(rng, time, *values):
    time[:] = time[rng.integers(len(time))]


def _time_without_value(rng, time, *values):
    time[rng.integers(len(time), size=5)] = rng.choice((np.nan, np.inf, -np.inf, 1e300))


DAMAGE = (
    _with_nan, _with_huge, _with_scale, _with_one_joint, _with_noise, _back_in_time,
    _jumping_time, _shuffled, _stuck_time, _time_without_value,
)  # fmt: skip


def damaged(recording: Recording, seed: int) -> list[np.ndarray]:
    """Time, positions, rates and efforts of a recording to which one or two things happened."""
    rng = np.random.default_rng(seed)
    parts = short(recording, None)
    if rng.random() < 0.2:
        count = rng.integers(len(parts[0]))
        parts = [part[:count] for part in parts]
    for damage in rng.choice(DAMAGE, rng.integers(1, 3), replace=False):
        if len(parts[0]):
            damage(rng, *parts)
    return parts


def test_given_damaged_samples_when_cleaned_then_they_are_finite_or_the_reason_is_said(recording):
    samples = []

    def read():
        time, position, velocity, effort = samples.pop()
        return use(clean('r', [time], position, velocity, effort))

    assert fuzz(80, lambda seed: samples.append(damaged(recording, seed)), read).refused


def test_given_damaged_samples_when_identified_then_the_arm_is_finite_or_the_reason_is_said(
    recording, rough_arm
):
    tally, coarse = Tally(), recording.rows(slice(0, 1200, 3))

    def run(seed):
        time, *samples = damaged(coarse, seed)
        result = identify(rough_arm, [clean('r', [time], *samples)])
        return result.arm.parameter_vector(), result.figures, result.fit.covariance

    for seed in cases(3):
        tally.run(seed, run, seed)
    print(tally)
    assert not tally.failed
