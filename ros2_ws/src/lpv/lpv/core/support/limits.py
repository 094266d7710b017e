"""Limits that all parts share: of waiting, and of what comes from elsewhere."""

AT_ONCE, QUIET = 0.1, 1.0
"""Up to which a reaction seems immediate, and nobody asks what happens (Nielsen, 1993) [s]."""
PATIENCE = 5.0
"""Time that a process has for an answer, as for its end in launch files of ROS [s]."""
MAX_GAP = 0.1
"""Default of parameter max_gap: what lasts longer without a sample starts anew [s]."""
STALE_AFTER = 0.5
"""Default of parameter stale_after: time without a usable measurement, then stale [s]."""
MAX_DELAY = 64
"""Samples after which a command is not waited for any more: each is a state of the sampled loop."""
SMALL = 0.05
"""Default of diagnosis.minimum_threshold: below are no faults, and no motions [rad]."""
FAR = 1e3
"""Range of coordinates, angles and gears in files [m], [rad], [1]."""
TURN = 6.3
"""A full turn, rounded up: larger angles of orientations are in degrees [rad]."""
LARGEST = 1e9
"""Largest magnitude of a number from elsewhere [SI units]: larger floats are further apart than
steps of an encoder of 24 bits."""
MOST_BYTES = 1 << 27
"""Largest part of a file from elsewhere that is held in memory at once."""
MOST_SAMPLES = 2_000_000
"""Samples that are held in memory: an hour at 500 Hz."""
MOST_ENTRIES = 10_000
"""Entries of a list in a file from elsewhere."""
MAX_DEPTH = 50
"""Deepest nesting of a file from elsewhere."""
MOST_TEXT = 300
"""Most characters of a text from elsewhere that are kept."""
