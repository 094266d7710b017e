"""Campaigns that the tests share, the command that runs them, and their results."""

import pyarrow.parquet as pq
import yaml

from lpv.campaign.plan.campaign import resolve
from lpv.core.support.resources import shipped_files

GAINS = str(shipped_files('gains')['paper'])


def spec(factors='', runs=1, **changes):
    """Content of a campaign file: random runs of the paper's arm, with factors in YAML."""
    fields = {'name': 'small', 'designs': [GAINS], 'seed': 3, 'duration': 3.0}
    fields['plan'] = {'method': 'random', 'runs': runs}
    varied = {'factors': yaml.safe_load(factors)} if factors else {}
    return {**fields, **varied, **changes}


FACTORS = """{
path: random, fault.kind: [none, bias, drift, stuck, scale, noise, spike, dropout],
fault.sensor: [link1_angle, link2_angle, both],
fault.size: {bias: {low: 0.1, high: 0.5, spacing: log}, scale: 0.3, noise: 0.03, spike: 0.3},
fault.rate: {drift: 0.3, spike: 20.0}, fault.onset: {low: 1.2, high: 1.5},
mass_1: {low: 0.95, high: 1.05}}"""
SMALL = spec(FACTORS, 24, seed=1)
UR10 = yaml.safe_load("""
{name: steps, seed: 2, arm: ur10, scenario: ur10, duration: 2.5, plan: {method: factorial},
factors: {path: random, fault.kind: [none, bias], fault.sensor: [elbow_encoder, both],
          fault.size: {bias: 0.01}, fault.onset: 1.5, parameter_error: 0.05, payload: 1.5}}
""")


def resolved(*given, **changes):
    return resolve(spec(*given, **changes), 'spec', '.')


def written(path, data):
    path.write_text(yaml.safe_dump(data))
    return path


def command(file, out):
    return ['campaign', str(file), '--out', str(out), '--workers', '0', '--no-report']


def rows_of(folder, name='runs'):
    return pq.read_table(folder / f'{name}.parquet').to_pylist()


def assert_same(found, rows):
    """Rows are those of runs; a file has other columns too, and None where a run has nothing."""
    assert len(found) == len(rows)
    for one, row in zip(found, rows):
        known = {name: value for name, value in row.items() if value is not None}
        same = {name: one[name] for name in row if one[name] is not None}
        assert repr(same) == repr(known)  # NaN is the same as NaN
