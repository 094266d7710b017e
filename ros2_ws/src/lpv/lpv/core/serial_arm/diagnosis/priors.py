"""What is expected of arms, faults and pushes before any data; in rad, times `SerialJoint.scale`.

These numbers are no thresholds: they say how likely what is, and data outweigh them.
docs/diagnosis.md has them in one table, benchmarks/README.md what half and twice of them change.
"""

CONTACT = 'contact'
"""Unknown torques on all joints: something pushes or holds the arm, or its load has changed."""

LOAD = 'load'
"""The load at the tip has changed, within what the arm file states."""

STAMPS = 'stamps'
"""Readings of all sensors came late or early, which no single sample shows."""

OCCURRENCE = {
    CONTACT: 1.0,
    LOAD: 1.0,
    STAMPS: 1.0,
    **dict.fromkeys(
        ('drift', 'scale', 'slip', 'stuck', 'rate_bias', 'torque_gain', 'torque_offset'), 0.01
    ),
}
"""How often causes come, per hour of motion: a push every hour, one fault of a kind in 100 h.
Names go by ratios; bounds hold a fault once it is probable beside a healthy arm.  Torque sensors
fail as often as encoders do."""
SIZE = {'drift': 0.3, 'slip': 0.2, 'scale': 0.2, 'rate_bias': 0.3, 'torque_gain': 0.5}
"""Standard deviations of faults' sizes [rad/s], [rad], [-], [rad/s], [-]."""
FAULT_AT_START = 1e-3
"""Probability of an offset at the first sample."""
OFFSET_PRIOR = 0.5
"""Standard deviation of an offset of which nothing is known [rad]."""
WIDEST_LEVEL = 0.1
"""The same of one that cannot be diagnosed, and of that beside a scale error that has just been
named [rad]."""
STEADY = 0.1
"""Change of the rate of a drift in a second, standard deviation [rad/s]."""
SCALE_STEADY = 0.01
"""The same of a scale error [-]."""
WRONG_STAMPS = 0.01
"""Share of stamps that are wrong, before any were seen."""
COARSEST_ROUNDING = 0.0175
"""Largest step that readings are rounded to without their file saying so: a degree [rad]."""
RATE_LAG = 0.05
"""Lag of independent rates behind their readings, standard deviation: a filter of 3 Hz [s]."""

MODEL_ERROR = 0.05
"""Relative standard deviation of masses and inertias that were not identified."""
UNSTATED_LOAD = 0.1
"""Mass that an arm carries, over its own, where the file says nothing of it, standard deviation:
arms are sold for loads of 0.15 to 0.5 of their mass."""
STATIC = 0.6
"""Share of the torque that the model misses which is friction or a constant torque."""
LASTING = 0.3
"""Share of the torque that the model misses which lasts as long as a pose."""
POSE_TIME = 0.5
"""Over which an error that depends on the pose is correlated [s]."""
SLOW_RATE = 0.1
"""Rate below which the friction of a joint may be anything up to that of rest [rad/s]."""
USUAL_RATE = 1.0
"""Of a joint in the motions of an arm [rad/s]."""
USUAL_ACCELERATION = 2.0
"""The same [rad/s2]."""
FAST = 3.0
"""Usual rate of a joint whose limit is higher [rad/s]."""
LEAST_ACCELERATION = 1.0
"""Usual acceleration of a joint that has hardly been seen to move [rad/s2]."""
ACCELERATIONS = (1.0, 4.0, 16.0)
"""Accelerations of a joint whose reading froze that are tried, over the usual one: a loop that is
closed on the reading drives its joint away."""
STEADY_FOR = 0.2
"""Time over which a joint's acceleration is correlated, and rough torques are [s]."""

PUSH = 2.0
"""Largest plausible torque from outside, over that which moves the arm."""
AMPLITUDES = (1.0, 0.3, 0.1, 0.03)
"""Amplitudes of torques from outside that are tried, in the largest plausible one."""
SMOOTH_TIMES = (1e3, 1.0, 0.5)
"""Correlation times of the smooth courses [s]; the first one is constant."""
HORIZON_TIME = 2.0
"""The same for a torque over the whole horizon [s]."""
