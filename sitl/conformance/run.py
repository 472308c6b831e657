"""Runs checks on a vehicle: brings it into the state that each wants, and leaves it as it was found."""

from collections.abc import Callable, Sequence

from sitl.conformance import flying, parameters, plans
from sitl.conformance.autopilots import by_number
from sitl.conformance.checks import Check, State
from sitl.conformance.outcome import Failed, Outcome, Silent, Skipped, Verdict
from sitl.conformance.vehicle import WATCHED_HZ, Vehicle
from sitl.conformance.wire import WireError

PREPARE: dict[State, Callable[[Vehicle], None]] = {State.GROUND: flying.to_the_ground, State.AIR: flying.into_the_air}


def meet(v: Vehicle) -> None:
    """Wait for the vehicle and learn which autopilot it is. Raises Silent, and Failed when it is none we know."""
    v.meet()
    if not v.known:
        told = v.latest["HEARTBEAT"].autopilot
        autopilot = by_number(told)
        if autopilot is None:
            raise Failed(f"MAV_AUTOPILOT {told} is not known; --personality says which one to expect")
        v.is_a(autopilot)


def run(
    v: Vehicle, checks: Sequence[Check], outcomes: list[Outcome], tell: Callable[[Check], None] = lambda _: None
) -> None:
    """Adds the outcome of every check, in order; `tell` is called before each. The vehicle must have been met.

    A state that could not be reached fails the check that wanted it, and skips those after it that want it too.
    """
    unreachable: dict[State, str] = {}
    for check in checks:
        tell(check)
        begun_ms, said = v.time_ms, len(v.texts)
        verdict, seen = _judge(v, check, unreachable)
        if verdict == "fail" and len(v.texts) > said:
            seen += f"; it says: {v.texts[-1]}"
        outcomes.append(Outcome(check.level, check.name, verdict, seen, check.clause, (v.time_ms - begun_ms) / 1000.0))


def _judge(v: Vehicle, check: Check, unreachable: dict[State, str]) -> tuple[Verdict, str]:
    try:
        if check.state in unreachable:
            raise Skipped(unreachable[check.state])
        prepare = PREPARE.get(check.state)
        if prepare is not None:
            try:
                prepare(v)
            except Failed as failure:
                unreachable[check.state] = f"the state before it ({check.state.value}) cannot be reached"
                raise Failed(f"the state before it ({check.state.value}): {failure}") from failure
        return "pass", check.run(v)
    except (Failed, WireError) as failure:
        return "fail", str(failure)
    except Skipped as why:
        return "skip", str(why)


def leave(v: Vehicle) -> list[str]:
    """Land, disarm, restore parameters and plans, stop what was asked for; what of it did not work."""
    wrong: list[str] = []
    try:
        if not flying.leave_safely(v):
            wrong.append("the vehicle is still armed")
        wrong += [f"not restored: parameter {name}" for name in parameters.restore(v)]
        wrong += [f"not restored: {name}" for name in plans.restore(v)]
        for name in WATCHED_HZ:
            v.set_interval(name, 0.0)
    except (Silent, WireError) as error:
        wrong.append(f"the vehicle may not be as it was: {error}")
    except Failed as failure:
        wrong.append(f"not restored: {failure}")
    return wrong
