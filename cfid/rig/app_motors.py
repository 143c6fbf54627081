"""Motors driven by cfid's app on the vehicle, which stops them itself when it hears no more of us."""

import secrets
from collections.abc import Awaitable, Callable
from typing import Any

from twisted.internet.base import DelayedCall

from cfid.errors import DeviceError, StopError
from cfid.rig.motors import MAY_BE_RUNNING, STILL, STOPPED, Firmware, Four, Limits
from cfid.rig.power_set import PowerSet
from cfid.rig.recorder import sleep
from cfid.rig.supervisor import Supervisor
from cfid.rig.vehicle import Vehicle
from cfid.wire import app
from cfid.wire.app import AppState, Flags, PingChannel, SineChannel, ThrustChannel, Verdict
from cfid.wire.crtp import Packet

_EVERY_S = 0.1  # five keep-alives in the time that the app waits for one
_DEAF_S = 0.4  # without an answer to any of them
_STOP_S = 0.1
_STOPS = 10
_ALLOWED_S = 0.7  # for a brushed vehicle to arm itself again, which takes it 0.16 s
_AGAIN_S = 0.05
_SINE_ENDS_S = 2.0
_OTHERS_S = 0.7  # for the app to drop a program that died
_WHY_S = 0.15
_OVERRIDES = "motorPowerSet.enable"


class AppMotors:
    """The four motors behind the app's thrust and sine services."""

    def __init__(self, vehicle: Vehicle, firmware: Firmware, limits: Limits, supervisor: Supervisor) -> None:
        """Take a vehicle whose app has answered, and its supervisor."""
        self._vehicle, self._ports, self._limits = vehicle, firmware.ports, limits
        self._supervisor = supervisor
        self._owner = secrets.randbits(32) | 1 if firmware.knows_owners else app.NO_OWNER
        self._number = 0
        self._commands: Four | None = None  # as the app confirmed them; None: not known, or the sine's own
        self._settled_at = 0  # the number of the last keep-alive that was sent before that
        self._answered_s = 0.0
        self._heard = self._kept_out = self._stopped = self.playing = False
        self._fault = ""
        self._taken_back: tuple[AppState, float] | None = None  # when the app first drove something else
        self._next: DelayedCall | None = None
        vehicle.listen(self._ports.ping, PingChannel.ALIVE, self._hear)

    def start(self) -> None:
        """Begin to send keep-alives."""
        self._answered_s = self._vehicle.loop.seconds()
        self._keep_alive()

    async def set(self, commands: Four) -> float:
        """Bring the motors that differ to their commands; a vehicle at rest that has to be armed is armed first."""
        self._limits.check_four(commands)
        before, self._commands = self._commands, None
        await self._be_heard()
        if before in (None, STILL) and any(commands):
            await self._make_ready()
        at_once = len(set(commands)) == 1
        each = [place for place in range(4) if before is None or commands[place] != before[place]]
        sent_s = [
            await self._set_one(app.ThrustRequest(commands[place % 4], place))
            for place in ([app.ALL_MOTORS_THRUST] if at_once else each)
        ]
        self._commands, self._settled_at = commands, self._number
        return sent_s[0] if sent_s else float(self._vehicle.loop.seconds())

    async def be_ready(self, request: app.SineRequest) -> None:
        """Wait until the app hears keep-alives, an earlier sine has reported its end, and motors may run."""
        self._limits.check_sine(request)
        await self._be_heard()
        await self._let_sine_end()
        await self._make_ready()

    async def play(self, request: app.SineRequest) -> None:
        """Start a sine; its crossings and its end are for `Crossings` to hear."""
        self._limits.check_sine(request)
        packet = Packet(self._ports.sine, SineChannel.START, app.encode_sine(request, self._owner))
        self._commands = None
        await self._be_heard()

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
        if self._taken_back is not None:
            state, taken_s = self._taken_back
            # The supervisor's state, which says why, may come a moment later.
            if self._supervisor.seen_s > taken_s or self._vehicle.loop.seconds() - taken_s > _WHY_S:
                raise DeviceError(f"{self._vehicle.uri}: the vehicle stopped its motors: {self._why(state)}.")
        deaf_s = self._vehicle.loop.seconds() - self._answered_s
        if self._next is not None and deaf_s > _DEAF_S:
            raise DeviceError(
                f"{self._vehicle.uri}: the app answered no keep-alive for {deaf_s:.1f} s; it stops the motors "
                f"{app.KEEP_ALIVE_S:g} s after the last it hears."
            )

    async def stop(self) -> float:
        """Take back the keep-alives and let the app report that all commands are zero.

        Then see that nothing overrides it, and that a vehicle with idle thrust is disarmed.
        """
        self._stopped = True
        began_s = self._vehicle.loop.seconds()
        if self._next is not None and self._next.active():
            self._next.cancel()
        self._next = self._commands = None
        if self._kept_out:  # nothing of ours ever counted, and what turns is another program's
            return 0.0
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
                f"{self._vehicle.uri}: the app did not confirm that the motors stopped. It stops them by itself "
                f"{app.KEEP_ALIVE_S:g} s after the last keep-alive: look before you touch."
            )
        await self._end_overriding()
        await self._end_idling()
        return float(self._vehicle.loop.seconds() - began_s)

    async def _end_overriding(self) -> None:
        if self._vehicle.wire.parameter(_OVERRIDES) is None:
            return
        try:
            overriding = PowerSet(self._vehicle)
            if await overriding.is_enabled():
                await overriding.clear()
        except DeviceError as error:
            raise StopError(
                f"{MAY_BE_RUNNING}: the app stopped, but the parameters motorPowerSet override it, and were not seen "
                f"at zero. ({error})"
            ) from None

    async def _end_idling(self) -> None:
        if not self._limits.idle_thrust:
            return
        try:
            disarmed = await self._supervisor.see_disarmed()
        except DeviceError:
            disarmed = False
        if not disarmed:
            raise StopError(
                f"{MAY_BE_RUNNING}: the app stopped, but the vehicle was not seen disarmed: its rotors may idle."
            )

    async def _set_one(self, request: app.ThrustRequest) -> float:
        """Set one motor, or all; return when the request that was accepted was sent."""

        def own(payload: bytes) -> app.ThrustAnswer | None:
            answer = app.decode_thrust_answer(payload)
            return answer if answer and (answer.command, answer.motor) == request else None

        packet = Packet(self._ports.thrust, ThrustChannel.SET, app.encode_thrust(request, self._owner))

        async def taken() -> int | None:
            answer = await self._vehicle.ask(packet, own, channel=ThrustChannel.ANSWER)
            return None if answer is None else answer.verdict

        return await self._insist(taken, f"take command {request.command}")

    async def _insist(
        self, attempt: Callable[[], Awaitable[int | None]], what: str, *, also: Verdict = Verdict.ACCEPTED
    ) -> float:
        """Attempt something until it is accepted, and return when that attempt began.

        The supervisor disarms a resting vehicle after seconds; a brushed one is back in a moment.
        """
        end_s = self._vehicle.loop.seconds() + _ALLOWED_S
        while True:
            self._refuse_when_stopped()
            began_s: float = self._vehicle.loop.seconds()
            verdict = await attempt()
            if verdict != Verdict.MOTORS_NOT_ALLOWED or began_s > end_s:
                break
            await self._make_ready()
        if verdict is None:
            raise DeviceError(f"{self._vehicle.uri}: the app does not answer when asked to {what}.")
        if verdict not in (Verdict.ACCEPTED, also):
            raise DeviceError(f"{self._vehicle.uri}: the app does not {what}: {_verdict(verdict)}.")
        return began_s

    async def _make_ready(self) -> None:
        self._refuse_when_stopped()
        if self._supervisor.reports:
            await self._supervisor.make_ready()
        else:
            await sleep(self._vehicle.loop, _AGAIN_S)
        self._refuse_when_stopped()

    async def _let_sine_end(self) -> None:
        """Wait until an earlier sine has reported its end, a second after its motors stopped."""
        end_s = self._vehicle.loop.seconds() + _SINE_ENDS_S
        while Flags.SINE_RUNNING in (await self._state()).flags:
            if self._vehicle.loop.seconds() > end_s:
                raise DeviceError(f"{self._vehicle.uri}: another sine is playing: `cfid motors stop` ends it.")
            await sleep(self._vehicle.loop, _AGAIN_S)

    async def _be_heard(self) -> None:
        """See once that a keep-alive has arrived and counted, before which the app refuses every command."""
        end_s = self._vehicle.loop.seconds() + _OTHERS_S
        while not self._heard:
            if Flags.NOT_OWNER not in (await self._state()).flags:
                self._heard = True
            elif self._vehicle.loop.seconds() > end_s:
                self._kept_out = True
                raise DeviceError(
                    f"{self._vehicle.uri}: another program drives the motors of this vehicle: end it. "
                    "`cfid motors stop` stops its motors."
                )
            else:
                await sleep(self._vehicle.loop, _AGAIN_S)

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
        self._next = self._vehicle.loop.callLater(_EVERY_S, self._keep_alive)
        self._number += 1
        try:
            self._vehicle.send(self._ports.ping, PingChannel.ALIVE, app.encode_alive(self._number, self._owner))
        except DeviceError as error:
            self._fault = str(error)

    def _hear(self, payload: bytes, arrived_s: float) -> None:
        """Compare what the app drives with what it was commanded, unless that was on its way just then."""
        state = app.decode_state(payload)
        if state is None:
            return
        self._answered_s = arrived_s
        self.playing = Flags.SINE_RUNNING in state.flags
        if self._stopped or not self._heard:
            return
        if Flags.NOT_OWNER in state.flags:
            self._fault = f"{self._vehicle.uri}: another program stopped the motors of this vehicle."
        elif self._commands is not None and state.number > self._settled_at and state.commands != self._commands:
            self._taken_back = self._taken_back or (state, arrived_s)

    def _why(self, taken_back: AppState) -> str:
        """Return why the app took commands back, with the state that the supervisor has reported since."""
        seen = self._supervisor.state
        if Flags.MOTORS_ALLOWED in taken_back.flags and (seen is None or seen.can_fly):
            return "it heard no keep-alive for a while, or its supervisor was away for a moment"
        if seen is None or seen.can_fly:
            return app.VERDICTS[Verdict.MOTORS_NOT_ALLOWED]
        return f"it is {seen.name}{': ' if seen.remedy else ''}{seen.remedy}"

    def _refuse_when_stopped(self) -> None:
        if self._stopped:
            raise DeviceError(STOPPED)


def _verdict(value: int) -> str:
    known: Any = app.VERDICTS
    return str(known.get(value, f"verdict {value}"))
