"""Terms of a report in the words of its reader."""

TERMS = (
    (
        'bound, threshold',
        'The bound is how far a fault estimate can be from the true fault while everything is '
        'within the stated model errors. A healthy sensor stays below the threshold; an estimate '
        'above it that lasts is confirmed as an alarm.',
    ),
    (
        'level and change',
        'The level is the size of the fault estimate itself, which gravity tells: it finds slow '
        'faults, where the configuration allows it. A change is a jump or a trend of the residual '
        'within some tenths of a second: it finds sudden faults everywhere, and smaller ones.',
    ),
    (
        'onset, confirmed, cleared',
        'The first sample that deviated, the sample at which the fault was certain enough to be '
        'reported, and the end of the alarm.',
    ),
    (
        'inconsistent',
        'Rates, torques and model contradict each other, and the cause is not known: a rate '
        'sensor, a torque, a payload or a contact. It is an alarm, but does not blame an encoder.',
    ),
    (
        'not diagnosable',
        'A link is outside the certified region, so that gravity does not tell its angle: the '
        'level says nothing there, sudden changes are still seen.',
    ),
    (
        'no bound at rest',
        'At rest, an unknown torque (friction, a payload) and an offset of the encoder look the '
        'same unless gravity changes with the angle. A share of 28% means: in these configurations '
        'of the path a lasting offset is found in motion or by its onset alone.',
    ),
    (
        'margin',
        'Each inequality of the certificate asks that a matrix is negative definite. The margin '
        'is its largest eigenvalue: −0.0127 holds with 0.0127 to spare, +0.001 would not hold.',
    ),
    (
        'MISE',
        'Mean integral of squared error, eq. (70) of the paper: the mean over the run of the '
        'squared error, e.g. 0.0004 rad² is a typical error of 0.02 rad.',
    ),
    (
        'x, f, y, e_t',
        'x1 to x4: estimates of angles and rates of both links; f1, f2: estimates of the faults; '
        'y1, y2: tracking error of the measured angles; e_t1, e_t2: tracking error of the true '
        'angles.',
    ),
    (
        'safe stop, no command',
        'The tracker told the drives to brake; or it was silent, so that a watchdog of the '
        'drives brakes.',
    ),
    (
        'lockstep, samples left out',
        'In lockstep each sample waits for its answer, so that a run does not depend on the speed '
        'of the computer. In real time a simulator that is braked and too slow leaves samples out '
        'to catch up; the diagnosis bridges intervals in which measurements are missing, and '
        'counts them. 0 is perfect.',
    ),
)
"""Name and meaning, in the order of the page."""
