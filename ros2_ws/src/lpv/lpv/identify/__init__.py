"""From a recording to an arm: inertial parameters, friction, sensors, delays.

The fit is tau = Y(q, v, a) phi + friction, low-pass filtered: base parameters by QR, Huber's
estimate, physically consistent inertias.  Bandwidth, delays and weight of the URDF are found by
cross-validation.  Prior: masses of the file within 30 %, friction within its own size.  The
covariance allows for correlated residuals.
"""
