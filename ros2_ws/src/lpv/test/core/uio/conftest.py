"""The paper's model and observer are tested in its own symbols."""

import pytest


@pytest.fixture(params=['paper_model', 'real_model'])
def arm(request):
    """Both shipped planar arms in turn, as designs take them."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope='session')
def arms(paper_model, real_model):
    """Both at once."""
    return paper_model, real_model


@pytest.fixture
def gains(arm, gains_of):
    """Of the arm."""
    return gains_of[arm.name]


@pytest.fixture
def serial(request, arm):
    """The arm as its file states it."""
    return request.getfixturevalue('paper_arm' if arm.name == 'paper' else 'real_arm')
