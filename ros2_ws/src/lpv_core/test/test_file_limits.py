"""Limits that hold for every YAML file, whatever it describes."""

import pytest

from lpv_core.support.config import MAX_DEPTH, MAX_VALUES, read_yaml
from lpv_core.support.errors import ConfigError

REFUSED = {
    'an integer beyond any float': ('a: ' + '9' * 400, 'a: must be at most'),
    'an integer of 5000 digits': ('a: ' + '9' * 5000, 'is not valid YAML'),
    'an integer of 5000 hexadecimal digits': ('a: 0x' + 'f' * 5000, 'a: must be at most'),
    'an integer in a list in a mapping': (f'a: {{b: [1, {2**63}]}}', r'a.b\[1\]: must be at most'),
    'a flag that is none': ('a: !!bool 1', "is not valid YAML .*'1'"),
    'a key with a tag that does not fit': ('!!bool x: 1', 'is not valid YAML'),
    'an empty integer': ('a: !!int ""', 'is not valid YAML'),
    'a date that is none': ('a: !!timestamp x', 'is not valid YAML'),
    'a date': ('a: {b: 2001-01-01}', 'a.b: must be a number or text, got a date'),
    'bytes': ('a: !!binary YQ==', 'a: must be a number or text, got a bytes'),
    'a set': ('a: !!set {b}', 'a: must be a number or text, got a set'),
    'not a number': ('a: [1.0, .nan]', r'a\[1\]: must be a number, got NaN'),
    'a key that is a number': ('a: {1: 2}', 'a: has a key that is not text: 1; put it in quotes'),
    'a key that is a flag': ('on: 2', 'file: has a key that is not text: True'),
    'a key that is a huge integer': ('? 0x' + 'f' * 5000, 'a key that is not text: a huge int'),
    'nesting without end': ('a: ' + '[' * 60 + ']' * 60, f'has more than {MAX_DEPTH} levels'),
    'a list that holds itself': ('a: &x [*x]', f'has more than {MAX_DEPTH} levels'),
}


@pytest.fixture
def read(tmp_path):
    def run(text):
        path = tmp_path / 'file.yaml'
        path.write_text(text)
        return read_yaml(path)

    return run


@pytest.mark.parametrize('case', REFUSED)
def test_given_what_no_file_needs_when_read_then_it_is_refused_in_one_line(case, read):
    text, message = REFUSED[case]
    with pytest.raises(ConfigError, match=message) as error:
        read(text)
    assert '\n' not in str(error.value) and len(str(error.value)) < 700


def test_given_aliases_that_stand_for_millions_of_values_when_read_then_they_are_refused(read):
    names = 'abcdefghij'
    lines = ['a: &a [' + '1, ' * 10 + ']']
    lines += [f'{b}: &{b} [' + f'*{a}, ' * 10 + ']' for a, b in zip(names, names[1:])]
    with pytest.raises(ConfigError, match=f'has more than {MAX_VALUES} values'):
        read('\n'.join(lines))


def test_given_the_largest_values_when_read_then_they_are_kept(read):
    text = f'a: [{2**63 - 1}, {-(2**63) + 1}, 1.0e+308, -.inf, null, true, ""]'
    found = read(text)['a']
    assert found == [2**63 - 1, -(2**63) + 1, 1e308, float('-inf'), None, True, '']
