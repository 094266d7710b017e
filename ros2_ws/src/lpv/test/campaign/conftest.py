"""A campaign that several files of tests run."""

import pytest
from campaign_files import SMALL

from lpv.campaign.execution.runs import run_one
from lpv.campaign.plan.campaign import resolve


@pytest.fixture(scope='session')
def small():
    return resolve(SMALL, 'small', '.')


@pytest.fixture(scope='session')
def serial(small):
    """Rows of all its runs, one after the other in this process."""
    return [run_one(small, number) for number in small.tasks]
