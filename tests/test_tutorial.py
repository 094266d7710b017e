"""The documentation: the tutorial runs as printed."""

import re
import shlex

import numpy as np
import pytest
from places import ROOT

from lpv.cli.main import main
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent

pytestmark = pytest.mark.slow

TUTORIAL = ROOT / 'docs' / 'tracking.md'
BLOCKS = re.findall(
    r'^```(\w+)\n(.*?)^```$', TUTORIAL.read_text(encoding='utf-8'), re.MULTILINE | re.DOTALL
)
"""Kind and text of every fenced block, in order."""


@pytest.fixture(scope='module')
def tutorial(tmp_path_factory):
    """What the tutorial's session holds at its end, and its folder; its commands succeed."""
    folder, namespace = tmp_path_factory.mktemp('tutorial'), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for kind, text in BLOCKS:
            if kind == 'yaml':
                name = text.splitlines()[0].removeprefix('# ')
                (folder / name).write_text(text, encoding='utf-8')
            elif kind == 'python':
                exec(compile(text, str(TUTORIAL), 'exec'), namespace)
            elif kind == 'sh':
                lines = [line for line in text.splitlines() if line.startswith('lpv ')]
                assert [main(shlex.split(line)[1:]) for line in lines] == [0] * len(lines)
    return namespace, folder


def test_given_the_tutorial_when_designed_then_the_certificate_is_printed_as_shown(tutorial):
    texts = '\n'.join(text for kind, text in BLOCKS if kind == 'text')
    shown = re.findall(r'^holds \(.*?\): (.*)$', texts, re.MULTILINE)
    header = (tutorial[1] / 'gains.yaml').read_text(encoding='utf-8')
    printed = re.findall(r'^# holds \(.*?\): (.*)$', header, re.MULTILINE)
    assert len(shown) == 4 and shown == printed[:4]


def test_given_the_tutorials_figures_when_recomputed_then_they_are_as_printed(tutorial):
    namespace, _ = tutorial
    share = namespace['friction'] / namespace['gravity']
    np.testing.assert_allclose(namespace['gravity'], [18.9, 4.2], atol=0.05)
    np.testing.assert_allclose(share, [0.021, 0.024], atol=5e-4)
    np.testing.assert_allclose(namespace['upright'], [0.036, 0.077], atol=2e-3)
    np.testing.assert_allclose(namespace['leaning'], [0.134, 0.376], atol=5e-3)


def test_given_the_tutorials_fault_when_simulated_then_one_alarm_names_the_sensor(tutorial):
    namespace, _ = tutorial
    assert namespace['quiet']
    (alarm,) = namespace['run'].alarms
    assert (alarm.event, alarm.sensor, alarm.kind) == (AlarmEvent.RAISED, 'elbow_encoder', 'bias')
    assert alarm.detected == 4_002_000_000
    assert alarm.size == pytest.approx(0.25, abs=0.005)
    assert alarm.bound == pytest.approx(0.003, abs=0.001)
    # Compensated, the arm is off by the estimate's error.
    assert namespace['largest']['confirmed'] == pytest.approx(0.001, abs=0.001)
    assert namespace['largest']['off'] == pytest.approx(0.25, abs=0.01)
