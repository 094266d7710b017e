"""What the tests of commands share."""

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
