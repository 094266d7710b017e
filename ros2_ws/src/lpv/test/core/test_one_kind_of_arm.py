"""There is one kind of arm and one of scenario: no code asks which it has."""

import re

import pytest
from places import ROOT

OLD_FILES = ('uio/old_arm_file.py', 'serial_arm/arm_file.py', 'simulation/scenario.py')
"""Where files of older versions are read."""
SOURCES = [
    path
    for folder in (*(ROOT / 'ros2_ws' / 'src').glob('lpv*/lpv*'), ROOT / 'design' / 'lpv_design')
    for path in sorted(folder.rglob('*.py'))
]
QUESTIONS = {
    'type': r'isinstance\([^()]*(\([^()]*\))?[^()]*\b(SerialArm|ArmParameters|Scenario)\b',
    'links': r"hasattr\(\s*\w*arm\w*\s*,\s*'links'",
    'kind of an arm file': r"(arm|data|content|top)\w*(\[|\.get\(|\.text\()\s*'kind'",
}


@pytest.mark.parametrize('question', QUESTIONS)
def test_given_the_product_when_searched_then_it_never_asks_for_the_kind_of_an_arm(question):
    assert len(SOURCES) > 100
    found = [
        f'{path.relative_to(ROOT)}: {match.group()}'
        for path in SOURCES
        if not path.as_posix().endswith(OLD_FILES)
        for match in re.finditer(QUESTIONS[question], path.read_text())
    ]
    assert found == []
