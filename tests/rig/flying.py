"""A connected vehicle in virtual time, whose instruments a test records without a command around them."""

from collections.abc import Callable, Coroutine, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pandas as pd

from cfid.motors.plan import StaircasePlan
from cfid.motors.record import run_staircase
from cfid.records.rig_file import load_rig
from cfid.records.run import Label, Run, read_run
from cfid.rig.instrument import Instrument
from cfid.rig.motor_commands import hold
from cfid.rig.ready_vehicle import connect_vehicle
from cfid.rig.run import Plan, record_run
from cfid.transfer.record import play_sine
from cfid.wire.app import SineRequest
from cfid.wire.supervisor import VehicleState
from tests.virtual_bench import Bench

ALL = (1, 2, 3, 4)

Procedure = Callable[[Mapping[str, Any]], Coroutine[Any, Any, None]]


class Flight(Bench):
    """A vehicle fastened to a bench. Its motors may obey commands up to `largest_command`."""

    def __init__(
        self, folder: Path, *, largest_command: int = 65535, faults: Mapping[str, Any] | None = None, **truth: Any
    ) -> None:
        super().__init__(folder, **truth)
        self.vehicle_suffers(**(faults or {}))
        devices, _ = self.hardware.devices(folder, load_rig(folder / "rig.toml"))
        setting = devices.crazyflie.model_copy(update={"largest_command": largest_command})
        self._held = ExitStack()
        self.ready = connect_vehicle(setting, self.hardware, self._held)

    def record(self, instruments: list[Instrument], procedure: Procedure) -> tuple[Run, Exception | None]:
        """Record until a procedure is done; return the run and the exception that was raised, or None."""
        plan = Plan(
            runs_folder=self.folder / "runs", kind="test", label=Label(), procedure=lambda there, _: procedure(there)
        )
        folders: list[Path] = []
        failure: Exception | None = None
        try:
            record_run(plan, instruments, self.hardware, show=lambda _: None, begun=folders.append)
        except Exception as error:
            failure = error
        return read_run(folders[0]), failure

    def hold(
        self, command: int = 20000, motors: tuple[int, ...] = ALL, *, for_s: float = 1.0, watched: bool = True
    ) -> tuple[Run, Exception | None]:
        """Hold a command, with the supervisor's states beside it."""
        states = [self.ready.supervisor_log()] if watched else []
        return self.record([self.ready.commands(), *states], self.holding(command, motors, for_s=for_s))

    def holding(self, command: int, motors: tuple[int, ...] = ALL, *, for_s: float) -> Procedure:
        return lambda there: hold(there["commands"], command, motors, for_s=for_s, hardware=self.hardware)

    def climbing(self, stairs: StaircasePlan) -> Procedure:
        return lambda there: run_staircase(stairs, there["commands"], hardware=self.hardware, tell=lambda _: None)

    def playing(self, request: SineRequest) -> Procedure:
        return lambda there: play_sine(
            request, there["crossings"], before_s=0.1, hardware=self.hardware, tell=lambda _: None
        )

    def go_on(self, for_s: float) -> None:
        """Let time pass after a recording."""
        self.hardware.pause(for_s)

    def close(self) -> None:
        self._held.close()
        super().close()


@contextmanager
def flight_in(folder: Path, **options: Any) -> Iterator[Flight]:
    """Connect to a vehicle; `faults` are present from the beginning."""
    flight = Flight(folder, **options)
    try:
        yield flight
    finally:
        flight.close()


def rows(run: Run, device: str) -> pd.DataFrame:
    """Return a device's rows."""
    return pd.read_csv(run.device_file(device))


def facts(run: Run, device: str) -> dict[str, Any]:
    """Return what run.toml states about a device beside its file and its columns."""
    return dict(run.header.devices[device].model_extra or {})


def states(run: Run) -> list[str]:
    """Return the recorded states of the supervisor by name."""
    return [VehicleState.of(int(word)).name for word in rows(run, "supervisor")["state"]]
