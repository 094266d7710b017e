"""The result of an identification as text."""

import numpy as np

from lpv_identify.estimation.identification import Identification
from lpv_identify.estimation.torque_error import Calibration


def table(result: Identification) -> str:
    """Figures of each joint and what the data do not determine, for a terminal.

    Parameters
    ----------
    result : Identification
        The result.

    Returns
    -------
    str
        Several lines.
    """
    names = result.arm.joint_names
    width = max(8, *(len(name) for name in names))
    figures, sensing = result.figures, result.sensing
    lines = [
        f'{"joint":{width}}  RMS N m  in band  share    R2     corr.  before   rates      delay ms'
    ]
    for j, name in enumerate(names):
        lines.append(
            f'{name:{width}} {figures.rms[j]:8.3f} {figures.rms_band[j]:8.3f} '
            f'{100 * figures.share[j]:5.1f} % {figures.r2[j]:7.4f} {figures.correlation[j]:6.2f} '
            f'{result.prior_figures.rms[j]:8.2f}   {sensing.rates[j]:11}'
            f'{1e3 * sensing.effort_delay[j]:6.1f}'
        )
    lines += ['', *remarks(result)]
    return '\n'.join(lines)


def calibration_table(result: Calibration) -> str:
    """What a calibration found of each joint, for a terminal."""
    names, sensing, error = result.arm.joint_names, result.sensing, result.error
    width = max(8, *(len(name) for name in names))
    lines = [
        f'{"joint":{width}}  RMS N m  at rest  N m s/rad  noise rad  step rad  rate noise  rates'
    ]
    for j, name in enumerate(names):
        lines.append(
            f'{name:{width}} {result.rms[j]:8.3f} {error.rest[j]:8.3f} {error.growth[j]:10.3f} '
            f'{sensing.position_noise[j]:10.2g} {sensing.quantization[j]:9.2g} '
            f'{sensing.velocity_noise[j]:11.2g}  {sensing.rates[j]}'
        )
    lines += [
        '',
        f'"RMS": efforts minus the torques of the model; "at rest" and per rad/s: what of that the '
        f'model misses, for {error.time:.2g} s at a time; stamps jitter by '
        f'{1e3 * sensing.jitter:.2g} ms.',
    ]
    return '\n'.join(lines)


def remarks(result: Identification) -> list[str]:
    """Sentences on the fit."""
    determination = result.determination
    band = result.filters.effort
    lines = [
        f'On data held back; "in band": after a causal low-pass at '
        f'{result.filters.test:.1f} Hz; "before": with the parameters given.',
        f'{int(determination.determined.sum())} of {len(determination.names)} parameters are '
        'determined by the data.',
    ]
    if np.isfinite(band):
        lines.append(
            f'Efforts carry nothing above {band:g} Hz: the driver filters them, and the '
            'model does the same.'
        )
    lines.append(_weight(result))
    if not result.used_rates and result.sensing.rates[0] != 'none':
        lines.append('Rates are computed from positions: measured ones predict no better.')
    lines += determination.advice(result.arm.joint_names)
    return lines


def _weight(result: Identification) -> str:
    """What the data say on gravity in the efforts."""
    evidence, taken = result.weight, result.arm.effort_includes_gravity
    text = f"Efforts are taken {'with' if taken else 'without'} the arm's weight"
    if evidence.contains_weight is None:
        return f'{text}; the data do not tell.'
    factor = max(evidence.ratio, 1.0 / evidence.ratio)
    verb = 'otherwise' if evidence.contains_weight == taken else 'so'
    return f'{text}; {verb}, a joint misses {factor:.1f} times as much.'
