"""What is removed of a fault that is followed is beyond doubt."""

import numpy as np
import pytest

from lpv.core.serial_arm.diagnosis.fault_filter import begin_filter


def drift(size, sigma, spread=0.0, kind='drift'):
    return begin_filter(0, kind, (0.0, 0.2), size, sigma, 0.0, spread)


@pytest.mark.parametrize('size', [0.33, -0.33])
def test_given_a_drift_within_its_bound_when_corrected_then_nothing_is_removed(size):
    wide = drift(size, abs(size) / 2.0)  # 0.066 rad after 0.2 s, bound 0.132 rad
    assert wide.fault(0.0, 0.2)[0] == pytest.approx(0.2 * size)
    assert wide.share(0.0, 0.2, 4.0) == 0.0


def test_given_a_bound_when_it_shrinks_then_more_is_removed_and_all_of_what_is_certain():
    shares = [drift(0.3, sigma).share(0.0, 0.2, 4.0) for sigma in (0.075, 0.07, 0.03, 1e-3, 0.0)]
    assert shares[0] == pytest.approx(0.0, abs=1e-9) and shares[-1] == 1.0
    assert np.all(np.diff(shares) > 0.0) and shares[-2] > 0.999


def test_given_an_uncertain_onset_when_named_then_the_bound_of_the_fault_holds_it():
    assert drift(0.3, 0.0, 0.1).fault(0.0, 0.2)[2] == pytest.approx(0.03)
    assert drift(0.3, 0.0, 0.1).share(0.0, 0.2, 4.0) == 0.0


def test_given_a_reading_that_rests_when_corrected_then_all_is_removed_whatever_the_bound():
    assert drift(0.3, 0.5, kind='stuck').share(0.0, 0.2, 4.0) == 1.0
