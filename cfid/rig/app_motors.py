"""Drives motors through cfid's app on the vehicle, which stops them itself when keep-alives stop arriving."""

import secrets
from collections.abc import Awaitable, Callable, Mapping

from twisted.internet.base import DelayedCall

from cfid.errors import DeviceError, StopError
from cfid.rig.motor_log import PowerSet, confirm_still, foreign_motion, is_overridden
from cfid.rig.motors import STILL, STOPPED, Firmware, Four, Limits
from cfid.rig.stop import MAY_BE_RUNNING
from cfid.rig.supervisor import Supervisor
from cfid.rig.vehicle import Vehicle
from cfid.units import MOTORS
from cfid.wire import app
from cfid.wire.app import AppState, AppVerdict, Flags, PingChannel, SineChannel, ThrustChannel
from cfid.wire.crtp import Packet

_STOP_S = 0.1
_STOPS = 10
_AGAIN_S = 0.05
_VERDICTS: Mapping[int, str] = {
    AppVerdict.ACCEPTED: "accepted",
    AppVerdict.WRONG_LENGTH: "the request has the wrong length",
    AppVerdict.NO_SUCH_MOTOR: "there is no such motor",
    AppVerdict.NO_KEEP_ALIVE: "it receives no keep-alive",
    AppVerdict.SINE_IS_RUNNING: "a sine is running",
    AppVerdict.MOTORS_NOT_ALLOWED: "its supervisor does not let the motors run: not armed, tumbled or stopped",
    AppVerdict.NO_SAMPLES: "N is zero",
    AppVerdict.NO_FREQUENCY: "omega is no frequency from 0 to pi",
    AppVerdict.NO_WHOLE_PERIODS: "the sine has no whole periods in the run",
    AppVerdict.NOT_OWNER: "another program holds the motors, or a stop ended this one's hold",
}


class AppMotors:
    """The four motors behind the app's thrust and sine services."""

    def __init__(self, vehicle: Vehicle, firmware: Firmware, limits: Limits, supervisor: Supervisor) -> None:
        """Take a vehicle whose app has answered, and its supervisor."""
        self._vehicle, self._ports, self._limits = vehicle, firmware.ports, limits
        self._supervisor = supervisor
        self._owner = secrets.randbits(32) | 1 if firmware.knows_owners else app.NO_OWNER
        self._first = self._number = secrets.randbits(31)  # other programs' answers have other numbers
        self._commands: Four | None = None  # as the app confirmed them; None: unknown, or those of a sine
        self._settled_at = self._first  # the number of the last keep-alive sent before that confirmation
        self._answered_s = 0.0
        self._owns_motors = self._kept_out = self._stopped = self.playing = False
        self._fault = ""
        self._taken_back: tuple[AppState, float] | None = None  # the first state with other commands, and its arrival
        self._next: DelayedCall | None = None

    def start(self) -> None:
        """Begin to send keep-alives."""
        self._vehicle.begin()
        self._vehicle.listen(self._ports.ping, PingChannel.ALIVE, self._take_state)
        self._answered_s = self._vehicle.hardware.awake_s()
        self._keep_alive()

    async def set(self, commands: Four) -> float:
        """Set the motors whose commands differ; first arm a vehicle that needs it, if all its motors are off."""
        self._limits.check_four(commands)
        before, self._commands = self._commands, None
        self._vehicle.expected = None
        await self._own_motors()
        if before in (None, STILL) and any(commands):
            await self._make_ready()
        at_once = len(set(commands)) == 1
        each = [place for place in range(4) if before is None or commands[place] != before[place]]
        sent_s = [
            await self._set_one(app.ThrustRequest(commands[place % 4], place))
            for place in ([app.ALL_MOTORS_THRUST] if at_once else each)
        ]
        self._commands, self._settled_at = commands, self._number
        self._vehicle.expected = (commands, commands)
        return sent_s[0] if sent_s else float(self._vehicle.hardware.seconds())

    async def be_ready(self, request: app.SineRequest) -> None:
        """Wait until the app takes keep-alives, the previous sine has reported completion, and motors may run."""
        self._limits.check_sine(request)
        await self._own_motors()
        await self._let_sine_end()
        await self._make_ready()

    async def play(self, request: app.SineRequest) -> None:
        """Start a sine; `Crossings` receives its crossings and its end."""
        self._limits.check_sine(request)
        packet = Packet(self._ports.sine, SineChannel.START, app.encode_sine(request, self._owner))
        self._commands = self._vehicle.expected = None
        await self._own_motors()

        async def started() -> int | None:
            answer = await self._vehicle.ask(packet, app.decode_sine_answer, channel=SineChannel.ANSWER)
            return None if answer is None else answer.verdict

        # A request that was repeated because the first answer was lost finds the sine running.
        await self._insist(started, "play a sine", also=AppVerdict.SINE_IS_RUNNING)
        crest = min(app.MIDDLE + request.amplitude, app.LARGEST_COMMAND)
        played = [crest if request.motor in (motor, app.ALL_MOTORS_SINE) else 0 for motor in MOTORS]
        self._vehicle.expected = (STILL, played)

    async def refuse_driven(self) -> None:
        """Raise DeviceError after a sine that something else may have driven: it still drives the motors, or would."""
        cause = await foreign_motion(self._vehicle, idle_thrust=self._limits.idle_thrust)
        if cause:
            raise DeviceError(f"{self._vehicle.uri}: {cause}.")

    def check(self) -> None:
        """Raise DeviceError when the app stopped the motors, or does not answer."""
        self._vehicle.check()
        if self._fault:
            raise DeviceError(self._fault)
        if self._taken_back is not None:
            state, taken_s = self._taken_back
            # The supervisor's state, which gives the reason, may come a moment later.
            seen = self._supervisor.state
            is_settled = self._supervisor.seen_s > taken_s and seen is not None and not seen.is_passing
            if is_settled or self._vehicle.hardware.seconds() - taken_s > 0.15:
                raise DeviceError(f"{self._vehicle.uri}: the vehicle stopped its motors: {self._why(state)}.")
        unanswered_s = self._vehicle.hardware.awake_s() - self._answered_s
        if self._next is not None and unanswered_s > 0.4:
            raise DeviceError(
                f"{self._vehicle.uri}: the app answered no keep-alive for {unanswered_s:.1f} s; it stops the motors "
                f"{app.KEEP_ALIVE_S:g} s after the last one it receives."
            )

    async def stop(self) -> float | None:
        """End the keep-alives, and wait until the app reports that all commands are zero.

        Return after how many seconds that was confirmed, None where another program holds the motors.
        Then make sure that nothing overrides the app, that a vehicle with idle thrust is disarmed, and that no motor
        runs for any other reason.
        """
        self._stopped = self._vehicle.link.persists = True
        self._vehicle.ignore(self._ports.ping, PingChannel.ALIVE, self._take_state)
        began_s = self._vehicle.hardware.seconds()
        if self._next is not None and self._next.active():
            self._next.cancel()
        self._next = self._commands = self._vehicle.expected = None
        if self._kept_out:
            return None
        self._number += 1
        number = self._number

        def stopped(payload: bytes) -> AppState | None:
            state = app.decode_state(payload)
            return state if state and state.number == number and not any(state.commands) else None

        request = Packet(self._ports.ping, PingChannel.STOP, app.encode_alive(number))
        try:
            confirmed = await self._vehicle.ask(request, stopped, within_s=_STOP_S, tries=_STOPS) is not None
        except DeviceError:
            confirmed = False
        if not confirmed:
            raise StopError(
                f"{self._vehicle.uri}: the app did not confirm that the motors stopped. It stops them itself "
                f"{app.KEEP_ALIVE_S:g} s after the last keep-alive: look before you touch."
            )
        await self._end_overriding()
        await self._end_idling()
        await confirm_still(self._vehicle, app_feeds=not self._limits.idle_thrust)
        return float(self._vehicle.hardware.seconds() - began_s)

    async def _end_overriding(self) -> None:
        try:
            if await is_overridden(self._vehicle):
                await PowerSet(self._vehicle).clear()
        except DeviceError as error:
            raise StopError(
                f"{MAY_BE_RUNNING}: the app stopped, but the parameters motorPowerSet override it, and were not seen "
                f"at zero. ({error})"
            ) from None

    async def _end_idling(self) -> None:
        if not self._limits.idle_thrust:
            return
        try:
            disarmed = await self._supervisor.confirm_disarmed()
        except DeviceError:
            disarmed = False
        if not disarmed:
            raise StopError(
                f"{MAY_BE_RUNNING}: the app stopped, but the vehicle was not seen disarmed: its rotors may idle."
            )

    async def _set_one(self, request: app.ThrustRequest) -> float:
        """Set one motor, or all; return the time at which the accepted request was sent."""

        def own(payload: bytes) -> app.ThrustAnswer | None:
            answer = app.decode_thrust_answer(payload)
            return answer if answer and (answer.command, answer.motor) == request else None

        packet = Packet(self._ports.thrust, ThrustChannel.SET, app.encode_thrust(request, self._owner))

        async def taken() -> int | None:
            answer = await self._vehicle.ask(packet, own, channel=ThrustChannel.ANSWER)
            return None if answer is None else answer.verdict

        return await self._insist(taken, f"take command {request.command}")

    async def _insist(
        self, attempt: Callable[[], Awaitable[int | None]], what: str, *, also: AppVerdict = AppVerdict.ACCEPTED
    ) -> float:
        """Attempt something until it is accepted, and return the time at which that attempt began.

        The supervisor disarms a vehicle whose motors have been off for some seconds; a brushed one is soon ready again.
        """
        # A brushed vehicle arms itself again in 0.16 s.
        end_s = self._vehicle.hardware.seconds() + 0.7
        while True:
            self._refuse_when_stopped()
            began_s: float = self._vehicle.hardware.seconds()
            verdict = await attempt()
            if verdict != AppVerdict.MOTORS_NOT_ALLOWED or began_s > end_s:
                break
            await self._make_ready()
        if verdict is None:
            raise DeviceError(f"{self._vehicle.uri}: the app does not answer the request to {what}.")
        if verdict not in (AppVerdict.ACCEPTED, also):
            raise DeviceError(f"{self._vehicle.uri}: the app does not {what}: {_verdict(verdict)}.")
        return began_s

    async def _make_ready(self) -> None:
        self._refuse_when_stopped()
        if self._supervisor.reports:
            await self._supervisor.make_ready()
        else:
            await self._vehicle.hardware.sleep(_AGAIN_S)
        self._refuse_when_stopped()

    async def _let_sine_end(self) -> None:
        """Wait until the previous sine has reported completion, a second after its motors stopped."""
        end_s = self._vehicle.hardware.seconds() + 2.0
        while Flags.SINE_RUNNING in (await self._state()).flags:
            if self._vehicle.hardware.seconds() > end_s:
                raise DeviceError(f"{self._vehicle.uri}: another sine is playing: `cfid motors stop` ends it.")
            await self._vehicle.hardware.sleep(_AGAIN_S)

    async def _own_motors(self) -> None:
        """Wait until the app has once accepted a keep-alive of this program: before that it refuses every command."""
        # The app drops a program that died within this time.
        end_s = self._vehicle.hardware.seconds() + 0.7
        while not self._owns_motors:
            if Flags.NOT_OWNER not in (await self._state()).flags:
                self._owns_motors = True
            elif self._vehicle.hardware.seconds() > end_s:
                self._kept_out = True
                raise DeviceError(
                    f"{self._vehicle.uri}: another program drives the motors of this vehicle: end it. "
                    "`cfid motors stop` stops its motors."
                )
            else:
                await self._vehicle.hardware.sleep(_AGAIN_S)

    async def _state(self) -> AppState:
        self._refuse_when_stopped()
        self._number += 1
        number = self._number
        request = Packet(self._ports.ping, PingChannel.ALIVE, app.encode_alive(number, self._owner))

        def own(payload: bytes) -> AppState | None:
            state = app.decode_state(payload)
            return state if state and state.number == number else None

        state = await self._vehicle.ask(request, own, within_s=_STOP_S, tries=_STOPS)
        if state is None:
            raise DeviceError(f"{self._vehicle.uri}: the app answers no keep-alive.")
        return state

    def _keep_alive(self) -> None:
        # Five keep-alives leave in the time that the app waits for one.
        self._next = self._vehicle.hardware.later(0.1, self._keep_alive)
        self._number += 1
        try:
            self._vehicle.send(self._ports.ping, PingChannel.ALIVE, app.encode_alive(self._number, self._owner))
        except DeviceError as error:
            self._fault = str(error)

    def _take_state(self, payload: bytes, arrived_s: float) -> None:
        """Compare the commands that the app drives with those it was sent, unless the latter may still be on their way.

        A vehicle to which two programs talk sends an answer to either of them.
        """
        state = app.decode_state(payload)
        if state is None or not self._first < state.number <= self._number:
            return
        self._answered_s = self._vehicle.hardware.awake_s()
        was_playing, self.playing = self.playing, Flags.SINE_RUNNING in state.flags
        if self._stopped or not self._owns_motors:
            return
        if was_playing and not self.playing and self._commands is None:  # a sine ended: its motors are off
            self._vehicle.expected = (STILL, STILL)
        if Flags.NOT_OWNER in state.flags:
            self._fault = f"{self._vehicle.uri}: another program stopped the motors of this vehicle."
        elif self._commands is not None and state.number > self._settled_at and state.commands != self._commands:
            self._taken_back = self._taken_back or (state, arrived_s)

    def _why(self, taken_back: AppState) -> str:
        """Return why the app dropped the commands, from the state that the supervisor has reported since."""
        seen = self._supervisor.state
        if Flags.MOTORS_ALLOWED in taken_back.flags and (seen is None or seen.can_fly):
            return "it received no keep-alive for a while, or its supervisor did not let motors run for a moment"
        if seen is None or seen.can_fly:
            return _VERDICTS[AppVerdict.MOTORS_NOT_ALLOWED]
        return f"it is {seen.name}{': ' if seen.remedy else ''}{seen.remedy}"

    def _refuse_when_stopped(self) -> None:
        if self._stopped:
            raise DeviceError(STOPPED)


def _verdict(value: int) -> str:
    return _VERDICTS.get(value, f"verdict {value}")
