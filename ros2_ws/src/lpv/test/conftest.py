"""What the tests of the library share."""

import pytest


@pytest.fixture
def call(capsys):
    """Calls a command that has to end with a code, without a traceback; what it printed."""
    from lpv.cli.main import main

    def run(*words, code=0):
        capsys.readouterr()
        assert main([str(word) for word in words]) == code
        said = capsys.readouterr()
        assert 'Traceback' not in said.out + said.err
        return said

    return run


@pytest.fixture
def quiet(caplog):
    """Ten thousands of warnings about bags are not worth keeping."""
    caplog.set_level('CRITICAL', 'lpv.bag')
