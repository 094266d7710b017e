"""Scripts that put the workspace into the environment of a shell."""

import os
import shutil
import subprocess
import sys

import pytest
from places import ROOT

# Script, options without the user's own files, what to ask, and what the answer holds.
SHELLS = {
    'bash': ('env.sh', '--norc', 'complete -p lpv', '_python_argcomplete'),
    'zsh': ('env.zsh', '-f', 'print ${_comps[lpv]}', '_python_argcomplete'),
    'fish': ('env.fish', '-N', 'complete -C "lpv ver"', 'verify'),
}


@pytest.mark.parametrize('shell', SHELLS)
def test_given_a_shell_when_its_script_is_sourced_then_lpv_is_found_and_completed(shell, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f'{shell} is not installed')
    script, bare, question, answer = SHELLS[shell]
    others = {k: v for k, v in os.environ.items() if k not in ('ROS_DISTRO', 'PYTHONPATH')}
    done = subprocess.run(
        [shell, bare, '-i', '-c', f'source {ROOT / "tools" / script}\ntype lpv\n{question}\n'],
        env={**others, 'VENV': sys.prefix, 'PATH': '/usr/bin:/bin', 'HOME': str(tmp_path)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    assert f'{sys.prefix}/bin/lpv' in done.stdout and answer in done.stdout
    assert 'not found' not in done.stdout + done.stderr
