"""Numbers of units and of the vehicle that every experiment shares, each once; nothing here computes.

The simulation's plants keep their own on purpose: a plant that shared a constant with a fit
could not catch a wrong one. What the wires fix, such as the largest command, is the wires'.
"""

import math

from cfid.wire.app import LARGEST_COMMAND

RPM = 2 * math.pi / 60  # rad/s of one revolution per minute
MM = 1e-3  # m
USUAL_GRAVITY_MPS2 = 9.81  # as section 3.3.1 of the thesis takes it, where no rig.toml states the local one
COVERAGE_95 = 1.96  # standard deviations either side of a normal distribution's 95 %

FULL_COMMAND = LARGEST_COMMAND
NEAR_FULL = 0.95  # of the full command: where less was measured, what it gives is extrapolated
DEAD_COMMAND = 1000  # up to here a motor stands (thesis, section 3.3.2)

MOTORS = (1, 2, 3, 4)
ROTORS = len(MOTORS)
# Seen from above, counterclockwise from forward: front right, back right, back left, front left.
MOTOR_AZIMUTH_DEG = {1: -45.0, 2: -135.0, 3: 135.0, 4: 45.0}
ROTOR_TURNS = {1: 1, 2: -1, 3: 1, 4: -1}  # 1 is counterclockwise, seen from above
