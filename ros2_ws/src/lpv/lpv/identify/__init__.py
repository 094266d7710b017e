"""From a recording to an arm: inertial parameters, friction, sensors, delays."""
