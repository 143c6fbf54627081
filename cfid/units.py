"""Constants of units and of the vehicle that all experiments share, each defined once; nothing here computes.

The simulated plants have their own constants on purpose: a plant that shared a constant with a fit could not reveal a
wrong one. Constants that a wire format fixes, such as the largest command, belong to `wire`.
"""

import math

from cfid.wire.app import LARGEST_COMMAND

RPM = 2 * math.pi / 60  # rad/s of one revolution per minute
MM = 1e-3  # m
USUAL_GRAVITY_MPS2 = 9.81  # as in section 3.3.1 of the thesis; used where no rig.toml states the local value
COVERAGE_95 = 1.96  # standard deviations on either side that cover 95 % of a normal distribution

FULL_COMMAND = LARGEST_COMMAND
NEAR_FULL = 0.95  # of the full command: if no measured command reached this, values at full command are extrapolated
DEAD_COMMAND = 1000  # up to this command a motor stands still (thesis, section 3.3.2)

MOTORS = (1, 2, 3, 4)
ROTORS = len(MOTORS)
# Seen from above, counterclockwise from forward: front right, back right, back left, front left.
MOTOR_AZIMUTH_DEG = {1: -45.0, 2: -135.0, 3: 135.0, 4: 45.0}
ROTOR_TURNS = {1: 1, 2: -1, 3: 1, 4: -1}  # 1 is counterclockwise, seen from above
