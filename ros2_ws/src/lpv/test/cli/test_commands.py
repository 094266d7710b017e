"""What all commands share: help that does not wait, progress, text that fits the terminal."""

import io
import re
import subprocess
import sys
import time

import pytest
from rich.console import Console

from lpv.cli import progress
from lpv.cli.commands import demo
from lpv.cli.main import main
from lpv.core.uio.certificate.gains import save_gains

HEAVY = ('numpy', 'numba', 'scipy', 'matplotlib', 'cvxpy', 'rosbags', 'pinocchio', 'rclpy', 'rich')


def test_given_any_command_when_asked_for_help_then_nothing_heavy_is_imported():
    code = (
        'import sys\n'
        'from lpv.cli.main import COMMANDS, build_parser\n'
        f'for name in COMMANDS:\n'
        '    build_parser(name).format_help()\n'
        f'print([name for name in {HEAVY} if name in sys.modules])'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=120)
    assert done.stdout == '[]\n', done.stderr


def test_given_no_command_when_run_then_the_help_speaks_of_all_arms(capsys):
    assert main([]) == 0
    said = capsys.readouterr().out
    assert 'of serial robot arms' in said and 'two-link' not in said


@pytest.mark.parametrize('width', [60, 80, 132])
def test_given_long_lines_when_fitted_then_none_is_longer_than_the_terminal(width):
    text = 'short\n' + '  holds  ' + 'an inequality of many words ' * 12 + '\n\nlast'
    fitted = progress.fitted(text, width)
    assert max(map(len, fitted.splitlines())) <= width
    assert fitted.split() == text.split()
    assert fitted.startswith('short\n  holds  an') and fitted.endswith('\n\nlast')


def test_given_work_that_takes_long_when_there_is_no_terminal_then_it_is_said(monkeypatch):
    said = io.StringIO()
    monkeypatch.setattr(progress, 'QUIET', 0.0)
    monkeypatch.setattr(progress, 'PATIENCE', 0.001)
    monkeypatch.setattr(sys, 'stderr', said)
    with progress.announced('lpv identify: identify an arm'):
        end = time.monotonic() + 100.0
        while said.getvalue().count('\n') < 3 and time.monotonic() < end:
            time.sleep(0.005)
    first, second, *_ = said.getvalue().splitlines()
    assert first == 'lpv identify: identify an arm ...'
    assert second.endswith(' s')


def test_given_a_bar_when_there_is_no_terminal_then_lines_say_how_far_it_is(monkeypatch):
    monkeypatch.setattr(progress, 'PATIENCE', 0.0)
    said = io.StringIO()
    with progress.bar(Console(file=said, width=100), 'runs', 200, 50) as show:
        show(51)
        show(60, 'best 0.5')
    assert 'runs: 51 of 200' in said.getvalue()
    assert 'runs: 60 of 200  best 0.5' in said.getvalue()


def test_given_gains_of_an_earlier_demo_when_all_is_as_it_was_then_no_solver_is_asked(
    tmp_path, paper_arm, paper_model, paper_gains, monkeypatch
):
    monkeypatch.setitem(sys.modules, 'lpv_design.design_flow', None)
    file, console = tmp_path / 'gains.yaml', Console(file=io.StringIO())
    save_gains(paper_gains, file, demo._design_key(paper_model, 'paper') + '\nholds: all')
    assert demo._designed(paper_arm, 'paper', tmp_path, console) == file
    assert 'all 1 checks' in console.file.getvalue()
    with pytest.raises(ImportError):
        demo._designed(paper_arm, 'paper_literal', tmp_path, console)
    file.write_text(re.sub('kappa: .*[0-9]', 'kappa: [1.0, 1.0', file.read_text(), count=1))
    with pytest.raises(ImportError):
        demo._designed(paper_arm, 'paper', tmp_path, console)
