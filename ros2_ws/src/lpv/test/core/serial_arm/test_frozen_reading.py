"""A reading that freezes in motion: its joint is carried on by momentum, torques and gravity."""

from functools import cache

import numpy as np
import pytest
from fault_injection import BY_NAME, cells, draw

pytestmark = pytest.mark.slow

KIND = BY_NAME['stuck']
RUNS = 6
NAMED = 0.3
"""Limit for the name [s]."""


@cache
def courses(arm):
    """By run, from the time at which it is named in any case to 2 s: errors, bounds, trust."""
    (cell,) = cells([arm], [False], ['derived'], [KIND])
    found = []
    for k in range(RUNS):
        subject, window, _ = draw(cell, k, 11)
        fault, stream = window.faults[0], window.stream
        rows = np.moveaxis(stream.samples, 1, 0)
        answers = subject.monitor().take_many(stream.stamps, *rows)
        acts = slice(stream.index(fault.onset + NAMED), stream.index(fault.onset + 2.0))
        i = fault.sensor
        error = np.abs(answers.fault.estimate[acts, i] - window.truth[acts, i])
        found.append((error, answers.fault.bound[acts, i], answers.state.trustworthy[acts]))
    return found


@pytest.mark.parametrize('arm', ['chain3', 'ur10', 'panda'])
def test_given_a_frozen_reading_when_its_joint_goes_on_then_its_position_is_followed(arm):
    last = np.array([error[-1] for error, *_ in courses(arm)])
    assert np.median(last) < 0.1
    assert (last < 0.1).sum() >= 4  # of 6


@pytest.mark.parametrize('arm', ['chain3', 'ur10', 'panda'])
def test_given_a_frozen_reading_when_its_estimate_is_trusted_then_the_bound_holds_the_error(arm):
    error, bound, trusted = (np.concatenate(one) for one in zip(*courses(arm)))
    assert trusted.mean() > 0.9
    assert (trusted & (error > bound)).mean() < 0.02
