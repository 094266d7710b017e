"""Here gains are designed; tests of other packages take the shipped ones."""

import pytest

from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement


@pytest.fixture(scope='session')
def paper_gains(paper_arm):
    """Gains of the shipped requirement ``paper``."""
    return design(paper_arm, load_requirement('paper')).gains


@pytest.fixture(scope='session')
def real_gains(real_arm):
    """Gains of the shipped requirement ``real_arm``."""
    return design(real_arm, load_requirement('real_arm')).gains


@pytest.fixture(scope='session')
def gains_of(paper_gains, real_gains):
    """Gains by the arm's name."""
    return {'paper': paper_gains, 'real_arm': real_gains}
