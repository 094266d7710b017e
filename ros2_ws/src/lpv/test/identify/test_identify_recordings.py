"""What is refused, and what is mended."""

from dataclasses import replace

import numpy as np
import pytest
from bags import write_measurements

from lpv.identify.errors import IdentificationError
from lpv.identify.estimation.identification import identify
from lpv.identify.recordings.motion import split
from lpv.identify.recordings.recording import clean, read_recording

pytestmark = pytest.mark.slow

NAMES = ('one', 'two', 'three')


def write_bag(path, recording, names=NAMES, effort=True):
    motion = recording.time, recording.position, recording.velocity
    return write_measurements(path, names, *motion, recording.effort if effort else None)


def test_given_a_bag_when_read_then_joints_are_found_by_name(tmp_path, recording):
    write_bag(tmp_path / 'bag', recording, ('three', 'one', 'two'))
    read = read_recording(tmp_path / 'bag', NAMES)
    assert np.array_equal(read.position[:, 0], recording.position[:, 1])
    assert np.array_equal(read.effort[:, 2], recording.effort[:, 0])


@pytest.mark.parametrize(
    ('names', 'effort', 'reason'),
    [
        (('one', 'elbow'), True, 'no message has all joints.*one, two, three'),
        (NAMES, False, 'has no efforts'),
    ],
)
def test_given_a_bag_that_lacks_something_when_read_then_it_is_named(
    tmp_path, recording, names, effort, reason
):
    write_bag(tmp_path / 'bag', recording, effort=effort)
    with pytest.raises(IdentificationError, match=reason):
        read_recording(tmp_path / 'bag', names)


def test_given_a_csv_when_read_then_columns_are_guessed(tmp_path, recording):
    columns = np.column_stack([recording.time, recording.position, recording.effort])
    header = 'time,q1,q2,q3,tau1,tau2,tau3'
    np.savetxt(tmp_path / 'a.csv', columns, delimiter=',', header=header, comments='')
    read = read_recording(tmp_path / 'a.csv', NAMES)
    assert read.velocity is None
    assert read.effort == pytest.approx(recording.effort)


def cleaned(recording, **changes):
    one = replace(recording, **changes)
    return clean('test', [one.time], one.position, one.velocity, one.effort)


def test_given_a_short_recording_or_no_motion_when_identified_then_the_reason_is_said(
    arm, recording
):
    still = replace(recording, position=0.0 * recording.position, velocity=0.0 * recording.velocity)
    for bad, reason in ((recording.rows(slice(300)), 'too short'), (still, 'no joint moves')):
        with pytest.raises(IdentificationError, match=reason):
            identify(arm, [bad])


def test_given_a_joint_at_rest_when_identified_then_a_warning_names_it(arm, motion, simulated):
    sine, cosine = motion.sine.copy(), motion.cosine.copy()
    sine[:, 0] = cosine[:, 0] = 0.0
    rest = replace(motion, sine=sine, cosine=cosine)
    found = identify(arm, [simulated(arm, 8, motion=rest)])
    assert any('one does not move' in text for text in found.warnings)
    assert np.isfinite(found.arm.parameter_vector()).all()


def test_given_bad_samples_when_cleaned_then_a_few_are_left_out_and_many_are_refused(recording):
    effort = recording.effort.copy()
    effort[100:110] = np.nan
    mended = cleaned(recording, effort=effort)
    assert len(mended.time) == len(recording.time) - 10
    assert 'not finite' in mended.warnings[0]
    effort[::2] = np.nan
    with pytest.raises(IdentificationError, match='only 50 %'):
        cleaned(recording, effort=effort)


def test_given_stamps_when_cleaned_then_jitter_is_mended_and_a_clock_that_stands_is_refused(
    recording,
):
    jitter = 0.004 * np.random.default_rng(0).uniform(-1, 1, len(recording.time))
    mended = cleaned(recording, time=recording.time + jitter)
    assert 'count of the samples' in mended.warnings[0]
    assert np.ptp(np.diff(mended.time)) < 1e-9
    with pytest.raises(IdentificationError, match='stamps stand still'):
        cleaned(recording, time=np.zeros(len(recording.time)))


def test_given_a_gap_when_split_then_both_sides_are_segments(recording):
    keep = (recording.time < 8.0) | (recording.time > 9.0)
    assert len(split(recording.rows(keep))) == 2
