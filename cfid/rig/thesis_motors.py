"""Drives motors through the thesis' firmware modules of 2015 (C.2.1, C.2.4), which obey without answering."""

import math

from cfid.errors import DeviceError, StopError
from cfid.rig.motors import MAY_BE_RUNNING, STILL, STOPPED, Firmware, Four, Limits
from cfid.rig.recorder import sleep
from cfid.rig.vehicle import Vehicle
from cfid.wire import app
from cfid.wire.app import SineChannel, ThrustChannel

_STOPS = 5  # stops sent, since none is answered
_STOP_EVERY_S = 0.02


class ThesisMotors:
    """The four motors behind the modules thrust and sine; a lost link leaves them running."""

    def __init__(self, vehicle: Vehicle, firmware: Firmware, limits: Limits) -> None:
        """Take a vehicle whose ping module has answered."""
        self._vehicle, self._ports, self._limits = vehicle, firmware.ports, limits
        self._commands = STILL
        self._plays_until_s = -math.inf
        self._stopped = False

    def start(self) -> None:
        """Begin to monitor the link: these modules report nothing."""
        self._vehicle.stalls.begin()

    @property
    def playing(self) -> bool:
        """False: these modules do not report whether they play."""
        return False

    async def set(self, commands: Four) -> float:
        """Send the commands that differ; these modules do not confirm them."""
        self._limits.check_four(commands)
        self._refuse_when_stopped()
        for place in range(4):
            if commands[place] != self._commands[place]:
                self._send(app.ThrustRequest(commands[place], place))
        self._commands = commands
        return float(self._vehicle.loop.seconds())

    async def be_ready(self, request: app.SineRequest) -> None:
        """Check the request only: these modules do not report what they play."""
        self._limits.check_sine(request)

    async def play(self, request: app.SineRequest) -> None:
        """Start a sine."""
        self._limits.check_sine(request)
        self._refuse_when_stopped()
        self._vehicle.send(self._ports.sine, SineChannel.START, app.encode_sine(request))
        self._plays_until_s = self._vehicle.loop.seconds() + request.samples / app.SAMPLES_PER_S

    def check(self) -> None:
        """Raise DeviceError when the link is lost."""
        self._vehicle.check()

    async def stop(self) -> float:
        """Send zero for all motors several times.

        Raises StopError when the link was lost before, or a sine plays: the module cannot end one.
        """
        self._commands, self._stopped = STILL, True
        began_s = self._vehicle.loop.seconds()
        try:
            for _ in range(_STOPS):
                self._send(app.ThrustRequest(0, app.ALL_MOTORS_THRUST))
                await sleep(self._vehicle.loop, _STOP_EVERY_S)
            self._vehicle.check()
        except DeviceError as error:
            raise StopError(
                f"{MAY_BE_RUNNING}: the modules of 2015 keep motors running without a link. ({error})"
            ) from None
        left_s = self._plays_until_s - self._vehicle.loop.seconds()
        if left_s > 0:
            raise StopError(f"{MAY_BE_RUNNING}: the module of 2015 plays its sine to the end, {left_s:.0f} s more.")
        return float(self._vehicle.loop.seconds() - began_s)

    def _refuse_when_stopped(self) -> None:
        if self._stopped:
            raise DeviceError(STOPPED)

    def _send(self, request: app.ThrustRequest) -> None:
        self._vehicle.send(self._ports.thrust, ThrustChannel.SET, app.encode_thrust(request))
