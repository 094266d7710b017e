"""Here gains are designed; tests of other packages take the shipped ones."""

import pytest

from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement


@pytest.fixture(scope='session')
def paper_gains(paper_model):
    return design(paper_model, load_requirement('paper')).gains


@pytest.fixture(scope='session')
def real_gains(real_model):
    return design(real_model, load_requirement('real_arm')).gains


@pytest.fixture(scope='session')
def gains_of(paper_gains, real_gains):
    return {'paper': paper_gains, 'real_arm': real_gains}


@pytest.fixture(params=['paper_model', 'real_model'])
def arm(request):
    """Both shipped planar arms in turn, as designs take them."""
    return request.getfixturevalue(request.param)
