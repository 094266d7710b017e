"""The paper's model and observer are tested in its own symbols."""

import pytest


@pytest.fixture(params=['paper_model', 'real_model'])
def arm(request):
    """Both shipped planar arms in turn, as designs take them."""
    return request.getfixturevalue(request.param)
