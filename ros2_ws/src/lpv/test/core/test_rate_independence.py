import math

import numpy as np
import pytest
from places import DATA
from scipy.signal import butter, lfilter

from lpv.core.serial_arm.description import RATE_SOURCES
from lpv.core.serial_arm.rate_independence import SAMPLES, contradicts, rate_source

COUNT = 1000
ENCODERS = [(1e-3, 0), (1e-4, 0), (0.0, 12), (0.0, 17)]


def reading(dt, noise, bits):
    """Stamps, reading of an encoder with noise or steps, its differences, and true rate."""
    time = dt * np.arange(COUNT)
    angle = 0.5 * np.sin(2.0 * time) + 0.1 * np.sin(7.0 * time)
    angle += noise * np.random.default_rng(0).standard_normal(COUNT)
    rate = np.cos(2.0 * time) + 0.7 * np.cos(7.0 * time)
    step = 2.0 * math.pi / 2**bits if bits else 0.0
    position = step * np.round(angle / step) if bits else angle
    speed = np.diff(position, prepend=position[0]) / dt
    return (1e9 * time).astype(int), position, speed, rate


@pytest.mark.parametrize('dt', [0.001, 0.002, 0.01])
@pytest.mark.parametrize(('noise', 'bits'), ENCODERS)
def test_given_rates_when_derived_or_with_noise_of_their_own_then_it_is_found(dt, noise, bits):
    stamps, position, speed, rate = reading(dt, noise, bits)
    own = rate + 0.01 * np.random.default_rng(1).standard_normal(COUNT)
    kept = np.random.default_rng(2).random(COUNT) > 0.05  # also where samples are lost
    assert rate_source(stamps, position, own).source == 'independent'
    assert rate_source(stamps[kept], position[kept], own[kept]).source == 'independent'
    for share in (1.0, 0.5, 0.1):
        found = rate_source(stamps, position, lfilter([share], [1.0, share - 1.0], speed))
        assert (found.source, found.explained > 0.5) == ('derived', True)


@pytest.mark.parametrize('dt', [0.001, 0.008, 0.01])
@pytest.mark.parametrize(('noise', 'bits'), ENCODERS)
@pytest.mark.parametrize('cutoff', [5.0, 20.0])
@pytest.mark.parametrize('delay', [0, 3])
def test_given_filters_and_delays_then_rates_are_derived(dt, noise, bits, cutoff, delay):
    stamps, position, speed, _ = reading(dt, noise, bits)
    rate = np.concatenate([np.zeros(delay), lfilter(*butter(2, 2.0 * dt * cutoff), speed)])[:COUNT]
    found = rate_source(stamps, position, rate).source
    seen = cutoff > 10.0 and bits != 17  # noise is left behind the filter
    assert found == 'derived' if seen else found != 'independent'
    rounded = 1e-3 * np.round(rate / 1e-3)  # hides what is filtered
    assert rate_source(stamps, position, rounded).source != 'independent'


def test_given_rates_when_tested_then_nothing_is_decided_of_few_and_the_recorded_are_derived():
    stamps, position, _, rate = reading(0.002, 1e-3, 0)
    for none in (np.zeros(COUNT), np.full(COUNT, np.nan)):
        assert rate_source(stamps, position, none).source == 'none'
    less = SAMPLES - 1
    for few in ((stamps[:less], position[:less], rate[:less]), ([], [], [])):
        assert rate_source(*few).source == 'undecided'
    assert rate_source(stamps, np.ones(COUNT), np.zeros(COUNT)).source == 'undecided'
    dt, rng = 0.033, np.random.default_rng(4)
    time = np.cumsum(dt * (1.0 + 0.1 * rng.standard_normal(COUNT)))
    position = np.sin(time) + 1e-5 * rng.standard_normal(COUNT)
    rate = np.cos(time) + 5e-3 * rng.standard_normal(COUNT)  # is not what the differences show
    stamps = (1e9 * dt * np.arange(COUNT)).astype(int)
    assert rate_source(stamps, position, rate).source == 'undecided'
    rows = np.genfromtxt(DATA / 'real_arm' / 'excerpt.csv', delimiter=',', names=True)
    stamps = np.round(1e9 * rows['time']).astype(int)
    for joint in (1, 2):
        position, rate = rows[f'pos_meas{joint}'], rows[f'vel_meas{joint}']
        assert rate_source(stamps, position, rate).source == 'derived'


@pytest.mark.parametrize('stated', RATE_SOURCES)
def test_given_what_is_stated_when_something_else_is_found_then_it_contradicts(stated):
    against = {found for found in (*RATE_SOURCES, 'undecided') if contradicts(stated, found)}
    assert against == set(RATE_SOURCES) - {stated}
