"""Motors driven by cfid's app on the vehicle, which stops them itself when it hears no more of us."""

from collections.abc import Awaitable, Callable
from typing import Any

from twisted.internet.base import DelayedCall

from cfid.errors import DeviceError
from cfid.rig.motors import STILL, Firmware, Four, Limits
from cfid.rig.recorder import sleep
from cfid.rig.vehicle import Vehicle
from cfid.wire import app
from cfid.wire.app import AppState, Flags, PingChannel, SineChannel, ThrustChannel, Verdict
from cfid.wire.crtp import ARM, COMMAND_CHANNEL, SUPERVISOR_PORT, Packet

_EVERY_S = 0.1  # five keep-alives in the time that the app waits for one
_DEAF_S = 0.4  # without an answer to any of them
_STOP_S = 0.1
_STOPS = 6
_ALLOWED_S = 0.7  # for a brushed vehicle to arm itself again, which takes it 0.16 s
_AGAIN_S = 0.05
_SINE_ENDS_S = 2.0


class AppMotors:
    """The four motors behind the app's thrust and sine services."""

    def __init__(self, vehicle: Vehicle, firmware: Firmware, limits: Limits) -> None:
        """Take a vehicle whose app has answered."""
        self._vehicle, self._ports, self._limits = vehicle, firmware.ports, limits
        self._number = 0
        self._unsettled: int | None = 0  # keep-alives up to this number were sent before the commands stood
        self._commands = STILL
        self._answered_s = 0.0
        self._heard = False
        self._fault = ""
        self._next: DelayedCall | None = None
        vehicle.listen(self._ports.ping, PingChannel.ALIVE, self._hear)

    def start(self) -> None:
        """Begin to send keep-alives."""
        self._answered_s = self._vehicle.loop.seconds()
        self._keep_alive()

    async def set(self, commands: Four) -> int | None:
        """Bring the motors that differ to their commands; return the vehicle's microseconds of the last answer."""
        self._limits.check(max(commands), min(commands))
        self._unsettled = None
        await self._be_heard()
        at_once = len(set(commands)) == 1
        places = [app.ALL_MOTORS_THRUST] if at_once else [m for m in range(4) if commands[m] != self._commands[m]]
        microseconds = None
        for place in places:
            answer = await self._set_one(app.ThrustRequest(commands[0 if at_once else place], place))
            microseconds = answer.microseconds
        self._commands, self._unsettled = commands, self._number
        return microseconds

    async def play(self, request: app.SineRequest) -> None:
        """Start a sine; its crossings and its end are for `Crossings` to hear."""
        self._limits.check_sine(request)
        packet = Packet(self._ports.sine, SineChannel.START, app.encode_sine(request))
        self._unsettled = None  # its commands are the vehicle's own from now on
        await self._be_heard()
        await self._let_sine_end()

        async def started() -> int | None:
            answer = await self._vehicle.ask(packet, app.decode_sine_answer, channel=SineChannel.ANSWER)
            return None if answer is None else answer.verdict

        # A request that was sent again, its first answer lost, finds the sine running.
        await self._insist(started, "play a sine", also=Verdict.SINE_IS_RUNNING)

    def check(self) -> None:
        """Raise DeviceError when the app stopped the motors, or does not answer."""
        self._vehicle.check()
        if self._fault:
            raise DeviceError(self._fault)
        deaf_s = self._vehicle.loop.seconds() - self._answered_s
        if self._next is not None and deaf_s > _DEAF_S:
            raise DeviceError(
                f"{self._vehicle.uri}: the app answered no keep-alive for {deaf_s:.1f} s; it stops the motors "
                f"{app.KEEP_ALIVE_S:g} s after the last it hears."
            )

    async def stop(self) -> None:
        """Take back the keep-alives and let the app say that all commands are zero."""
        if self._next is not None and self._next.active():
            self._next.cancel()
        self._next, self._unsettled, self._commands = None, None, STILL
        self._number += 1
        number, port = self._number, self._ports.ping

        def stopped(payload: bytes) -> AppState | None:
            state = app.decode_state(payload)
            return state if state and state.number == number and not any(state.commands) else None

        request = Packet(port, PingChannel.STOP, app.encode_alive(number))
        if await self._vehicle.ask(request, stopped, within_s=_STOP_S, tries=_STOPS) is None:
            raise DeviceError(
                f"{self._vehicle.uri}: the app did not confirm that the motors stopped. It stops them by itself "
                f"{app.KEEP_ALIVE_S:g} s after the last keep-alive: look before you touch."
            )

    async def _be_heard(self) -> None:
        """See once that a keep-alive has arrived, before which the app refuses every command.

        Where motors idle by themselves, as brushless ones do, a command of zero is made to mean zero.
        """
        if self._heard:
            return
        await self._state()
        idle = self._vehicle.wire.parameter("powerDist.idleThrust")
        if idle is not None:
            await self._vehicle.write_parameter(idle, 0)
        self._heard = True

    async def _state(self) -> AppState:
        self._number += 1
        request = Packet(self._ports.ping, PingChannel.ALIVE, app.encode_alive(self._number))
        state = await self._vehicle.ask(request, app.decode_state, within_s=_STOP_S, tries=_STOPS)
        if state is None:
            raise DeviceError(f"{self._vehicle.uri}: the app answers no keep-alive.")
        return state

    async def _set_one(self, request: app.ThrustRequest) -> app.ThrustAnswer:
        def own(payload: bytes) -> app.ThrustAnswer | None:
            answer = app.decode_thrust_answer(payload)
            return answer if answer and (answer.command, answer.motor) == request else None

        packet = Packet(self._ports.thrust, ThrustChannel.SET, app.encode_thrust(request))
        answers: list[app.ThrustAnswer] = []

        async def taken() -> int | None:
            answer = await self._vehicle.ask(packet, own, channel=ThrustChannel.ANSWER)
            answers.extend([answer] if answer else [])
            return None if answer is None else answer.verdict

        await self._insist(taken, f"take command {request.command}")
        return answers[-1]

    async def _insist(
        self, attempt: Callable[[], Awaitable[int | None]], what: str, *, also: Verdict = Verdict.ACCEPTED
    ) -> None:
        """Attempt something until it is accepted; the supervisor is given time to let the motors run.

        It disarms a resting vehicle after seconds; a brushed one then arms itself anew, another has to be told.
        """
        end_s = self._vehicle.loop.seconds() + _ALLOWED_S
        while (verdict := await attempt()) == Verdict.MOTORS_NOT_ALLOWED and self._vehicle.loop.seconds() < end_s:
            self._vehicle.send(SUPERVISOR_PORT, COMMAND_CHANNEL, ARM)
            await sleep(self._vehicle.loop, _AGAIN_S)
        if verdict is None:
            raise DeviceError(f"{self._vehicle.uri}: the app does not answer when asked to {what}.")
        if verdict not in (Verdict.ACCEPTED, also):
            raise DeviceError(f"{self._vehicle.uri}: the app does not {what}: {_verdict(verdict)}.")

    async def _let_sine_end(self) -> None:
        """Wait until an earlier sine has said its last word, a second after its motors stopped."""
        end_s = self._vehicle.loop.seconds() + _SINE_ENDS_S
        while Flags.SINE_RUNNING in (await self._state()).flags:
            if self._vehicle.loop.seconds() > end_s:
                raise DeviceError(f"{self._vehicle.uri}: another sine is playing: `cfid motors stop` ends it.")
            await sleep(self._vehicle.loop, _AGAIN_S)

    def _keep_alive(self) -> None:
        self._next = self._vehicle.loop.callLater(_EVERY_S, self._keep_alive)
        self._number += 1
        try:
            self._vehicle.send(self._ports.ping, PingChannel.ALIVE, app.encode_alive(self._number))
        except DeviceError as error:
            self._fault = str(error)

    def _hear(self, payload: bytes, arrived_s: float) -> None:
        """Compare what the app drives with what it was told, unless that was on its way just then."""
        state = app.decode_state(payload)
        if state is None:
            return
        self._answered_s = arrived_s
        if self._unsettled is None or state.number <= self._unsettled or self._next is None:
            return
        if state.commands != self._commands:
            allowed = Flags.MOTORS_ALLOWED in state.flags
            why = "it heard no keep-alive for a while" if allowed else app.VERDICTS[Verdict.MOTORS_NOT_ALLOWED]
            self._fault = f"{self._vehicle.uri}: the vehicle stopped its motors: {why}."


def _verdict(value: int) -> str:
    known: Any = app.VERDICTS
    return str(known.get(value, f"verdict {value}"))
