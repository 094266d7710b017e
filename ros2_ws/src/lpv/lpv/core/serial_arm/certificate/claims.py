"""What is claimed of computed torque, on which region, and by which check: of ``lpv verify``."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Claim:
    """One line of the table."""

    text: str
    region: str
    evidence: str  # exact arithmetic, eigenvalue, bound, experiment


SERIAL_CLAIMS = (
    Claim(
        'The tracking error of a serial arm decays with the stated rate in the energy norm '
        '(P and M(q) as weights), for any model error, payload and viscous friction of the stated '
        'sizes, but for the torques that the model misses, which drive it.',
        'every configuration, any motion with joint rates in the region; true estimates, torques '
        'below their limits',
        'exact arithmetic (--proof), eigenvalue',
    ),
    Claim(
        'The same of the sampled loop with one sample of delay, while the arm moves.',
        'the same; over a sample M(q) is taken as at its start, and so are friction, Coriolis and '
        'gravity torques over sample and delay',
        'exact arithmetic (--proof), eigenvalue',
    ),
    Claim(
        'The tracking error ends below the stated bound, for missed torques (model error, payload, '
        'friction) of any time profile.',
        'the smaller region of rates and accelerations, as long as the arm stays in it; '
        'continuous loop',
        'exact arithmetic (--proof) and bound (energy norms), attacked by simulation',
    ),
    Claim(
        'M(q) of the model: ratio of the payload, growth in motion, damping and smallest inertia.',
        'every configuration, joint rates up to the velocity limits',
        'exact arithmetic (--proof), eigenvalue (link by link, no grid)',
    ),
    Claim(
        'No number was changed after the design.',
        'the gains file of the tracker',
        'checksum, and recomputed where it follows from others',
    ),
)
