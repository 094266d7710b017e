"""The paper's model and observer are tested in its own symbols."""

import pytest


@pytest.fixture(scope='session')
def arms(paper_model, real_model):
    """Both shipped planar arms at once, as designs take them."""
    return paper_model, real_model


@pytest.fixture
def gains(arm, gains_of):
    """Of the arm."""
    return gains_of[arm.name]
