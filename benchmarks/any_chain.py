"""What an arm shows that this software was not made on: a twin of a UR10e, line by line.

    python benchmarks/any_chain.py B C --count 10

Each letter is a line of the table in README.md.  How often faults of the twin are found, and what
its data allow, is a matter of `fault_matrix --arm ur10e`.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from fault_injection import BY_NAME, Cell, Subject, draw, run, with_joints, with_sensors
from fault_matrix import Row, summary
from ur10e_twin import PAYLOAD, drive, healthy, recording, twin, ur10e

from lpv.identify.estimation.identification import identify
from lpv.identify.sensors import quantization_step, rate_sources


def measured(kind: str, count: int, subject: Subject) -> Row:
    """A row of the matrix for another arm or file."""
    cell = Cell('ur10e', (subject,), BY_NAME[kind], 'derived')
    return summary(cell, [run(cell, k) for k in range(count)])


def noise(count: int) -> str:
    """B: largest error of the corrected position while it is trustworthy."""
    kind, worst, events = BY_NAME['noise 0.02'], 0.0, 0
    for k in range(count):
        subject, window, _ = draw(Cell('ur10e', (twin(),), kind, 'derived'), k, 1)
        answers = subject.answers(window.stream)
        true = window.stream.samples[:, 0] - window.truth
        off = np.abs(answers.state.compensated_position - true).max(1)
        worst = max(worst, float(off[answers.state.trustworthy].max()))
        events += len(answers.events)
    return f'largest error {worst:.3f} rad, {events / count:.1f} events a run, {count} runs'


def rounded(count: int) -> str:
    """C: healthy joints at rest, and the step that identification finds."""
    texts = []
    for step in (1e-4, 1e-3):
        row = measured('healthy', count, twin(with_sensors(ur10e(), quantization=step), step))
        texts.append(f'{step:g} rad: {row["other"]:g} % of {count} minutes with an alarm')
    found = quantization_step([recording(0).position])
    return '; '.join(texts) + f'; steps found {np.array2string(found, precision=2)}'


def sources(count: int) -> str:
    """D: what is said of filtered rates."""
    found = [rate_sources([recording(k, k % 5)])[0] for k in range(count)]
    return f'"independent": {sum(one.count("independent") for one in found)} of {6 * count} joints'


def currents(count: int) -> str:
    """F: identification of 60 s of currents."""
    blank = with_joints(ur10e(), torque_gain=1.0)
    begin = time.process_time()
    result = identify(blank, [recording(1000)])
    gains = [joint.torque_gain for joint in result.arm.joints]
    return (
        f'{time.process_time() - begin:.1f} s of processor, R2 {result.figures.r2.min():.3f} to '
        f'{result.figures.r2.max():.3f}, gains {np.round(gains, 1)}'
    )


def limits(count: int) -> str:
    """G: torque limits ten times larger: thresholds as before."""
    arm = ur10e()
    joints = (replace(j, limits=replace(j.limits, torque=10.0 * j.limits.torque))
              for j in arm.joints)  # fmt: skip
    other, stream, ends = replace(arm, joints=tuple(joints)), drive(healthy(0, duration=15.0)), []
    for one in (arm, other):
        ends.append(twin(one).answers(stream).fault.threshold[-1])
    ratio = ends[1] / ends[0]
    return f'thresholds over those before: {ratio.min():.4f} to {ratio.max():.4f}'


def load(count: int) -> str:
    """H: a load of 2.6 kg; the file says that there may be 5 kg, or nothing."""
    says = []
    for payload in (PAYLOAD, None):
        stated = replace(ur10e().uncertainty, payload=payload)
        subject = twin(replace(ur10e(), uncertainty=stated), load=2.6)
        row = measured('healthy', count, subject)
        says.append(f'payload stated: {payload}: {row["other"]:g} %')
    return f'{count} minutes with an alarm; ' + ', '.join(says)


def misnamed(count: int) -> str:
    """L: the file calls filtered rates independent."""
    wrong = twin(with_sensors(ur10e(), rates='independent', velocity_noise=5e-3))
    texts = []
    for kind in ('step 0.02', 'scale 20 %'):
        row = measured(kind, count, wrong)
        shares = ', '.join(f'{name} {row[name]}' for name in ('in_time', 'kind_right', 'named'))
        texts.append(f'{kind}, {count} runs: {shares}')
    return '; '.join(texts)


LINES: dict[str, Callable[[int], str]] = {
    'B': noise, 'C': rounded, 'D': sources, 'F': currents, 'G': limits, 'H': load, 'L': misnamed,
}  # fmt: skip


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('lines', nargs='*', default=list(LINES), help=f'of {", ".join(LINES)}')
    parser.add_argument('--count', type=int, default=10, help='runs of a line')
    options = parser.parse_args()
    if unknown := {*options.lines} - {*LINES}:
        parser.error(f'no such line: {", ".join(sorted(unknown))}')
    for line in options.lines:
        print(f'{line}: {LINES[line](options.count)}', flush=True)


if __name__ == '__main__':
    main()
