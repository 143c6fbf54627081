"""cfid measures the physical parameters of a Crazyflie quadrocopter and says how sure they are."""

__version__ = "0.2.0"
