"""A free swing to its natural frequency, damping and axis inertia."""
