"""Steady points of motors to maps: thrust, speed and torque."""
