"""The paper's arm: runs of it and its joints, which several tests take."""

from dataclasses import replace

import pytest

from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.uio.model.joints import JointMap


@pytest.fixture(scope='session')
def run_paper(paper_arm, paper_gains, two_faults):
    def run(arm=paper_arm, gains=paper_gains, options=None, **changes):
        return run_closed_loop(arm, replace(two_faults, **changes), gains, **(options or {}))

    return run


@pytest.fixture(scope='session')
def joints(paper_model):
    return JointMap(paper_model)


@pytest.fixture(scope='session')
def arms(paper_model, real_model):
    """Both shipped planar arms at once, as designs take them."""
    return paper_model, real_model


@pytest.fixture
def gains(arm, gains_of):
    return gains_of[arm.name]
