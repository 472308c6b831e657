"""The command line, `aerialstar`. Commands import what they need when they run, so that `--help` is instant."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

import typer
from typer.exceptions import TyperException

from mission.reproduce import FIGURES, ReproduceError
from sitl.cli import sitl
from sitl.conformance.cli import conformance

ERROR, BAD_INPUT = 1, 2
ENDPOINT = re.compile(r"[a-z][a-z0-9_-]*/\S+")
"""Of zenoh; the bus says what else is wrong with it."""
VEHICLE = re.compile(r"[A-Za-z0-9_-]{1,32}")

app = typer.Typer(
    name="aerialstar",
    help="Fly a UAV-mounted STAR-RIS over MAVLink, with the radio model and a DA-DDPG agent in the loop.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _endpoints(given: str | list[str] | None) -> str | list[str] | None:
    for endpoint in [given] if isinstance(given, str) else given or ():
        if not ENDPOINT.fullmatch(endpoint):
            raise typer.BadParameter(f"{endpoint!r} must be PROTOCOL/ADDRESS, e.g. tcp/127.0.0.1:7447")
    return given


def _names(given: list[str] | None) -> list[str] | None:
    for name in given or ():
        if not VEHICLE.fullmatch(name):
            raise typer.BadParameter(f"{name!r} must be 1 to 32 letters, digits, '_' or '-'")
        if (given or []).count(name) > 1:
            raise typer.BadParameter(f"{name!r} is given twice")
    return given


def _known_figure(name: str) -> str:
    if name not in FIGURES:
        raise typer.BadParameter(f"{name!r} is not one of {', '.join(FIGURES)}")
    return name


MissionOption = Annotated[Path, typer.Option("--mission", metavar="FILE", help="Mission file (YAML).")]
VehiclesOption = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", callback=_names, help="Vehicle on the bus; else the mission's. Repeatable."),
]
VehicleOption = Annotated[str | None, typer.Option(metavar="NAME", help="Vehicle on the bus; else the mission's.")]
ConnectOption = Annotated[
    list[str] | None,
    typer.Option(metavar="ENDPOINT", callback=_endpoints, help="Zenoh endpoint, e.g. tcp/127.0.0.1:7447; repeatable."),
]
ListenOption = Annotated[str, typer.Option(metavar="ENDPOINT", callback=_endpoints, help="Where this node listens.")]
ConfigOption = Annotated[
    Path | None, typer.Option("--zenoh-config", metavar="FILE", help="Zenoh config file (hosts, TLS, access control).")
]
UntilEndedOption = Annotated[
    bool, typer.Option("--until-ended", help="End when the flight has ended or the bridge is gone.")
]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")]
LOOPBACK = "tcp/127.0.0.1:0"


@app.command()
def fly(
    mission: Annotated[Path, typer.Argument(metavar="MISSION", help="Mission file (YAML).")],
    seed: Annotated[int | None, typer.Option(help="Replaces the mission's seed.")] = None,
    speed: Annotated[float | None, typer.Option(help="Paced, at so many vehicle seconds per second.")] = None,
    slots: Annotated[int | None, typer.Option(help="Replaces the mission's number of slots.")] = None,
    output: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Where the run folder is made.")] = None,
) -> None:
    """Fly a mission: starts the nodes, supervises them, records and reports.

    Of one vehicle (`vehicle:`), or of several at the same time (`vehicles:`), each with a bridge of its own.

    Exit codes: 0 flown as planned, 3 ended safely by failsafe, 1 error, 2 bad input; of several the worst: 1, 3, 0.
    """
    with _one_line_errors():
        from rich.console import Console

        from mission.fleet import check, load
        from mission.fly import fly as fly_mission
        from mission.mission_file import MissionError

        clock = None if speed is None else "paced"
        loaded = load(mission, seed=seed, clock=clock, speed=speed, slots=slots, output=output)
        try:
            check(loaded)
        except MissionError as error:
            raise MissionError(f"{mission}: {error}") from error
        raise typer.Exit(fly_mission(loaded, Console()))


app.command(name="sitl")(sitl)
app.command(name="conformance")(conformance)

rf = typer.Typer(invoke_without_command=True)
app.add_typer(rf, name="rf")


@rf.callback()
def rf_node(
    context: typer.Context,
    mission: Annotated[Path | None, typer.Option("--mission", metavar="FILE", help="Mission file (YAML).")] = None,
    vehicle: VehiclesOption = None,
    connect: ConnectOption = None,
    listen: ListenOption = LOOPBACK,
    zenoh_config: ConfigOption = None,
    until_ended: UntilEndedOption = False,
) -> None:
    """Run the radio node alone (with --mission): users, channels, rates. Or evaluate one slot."""
    if context.invoked_subcommand is not None:
        return
    if mission is None:
        raise typer.BadParameter("none given, and the node needs one", param_hint="--mission")
    with _one_line_errors():
        from bus.session import open_session
        from mission.fleet import served
        from mission.mission_file import action_deadline_s

        missions = served(mission, vehicle or ())
        if len(missions) > 1:
            for one in missions:
                typer.echo(f"rf: {one.vehicle.name} has seed {one.seed}")
        with open_session(zenoh_config, connect or (), listen) as session:
            from rf_model.node import World, run

            code = run(
                {one.vehicle.name: World(one.scenario, one.seed) for one in missions},
                session,
                action_deadline_s=action_deadline_s(missions[0]),
                until_ended=until_ended,
                ris=missions[0].ris,
            )
        raise typer.Exit(code)


@rf.command()
def evaluate(
    snapshot: Annotated[Path, typer.Argument(metavar="SNAPSHOT", help="Snapshot file (YAML or JSON); - for stdin.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, SI units.")] = False,
) -> None:
    """Evaluate one slot: path losses, SINR, rates, power and reward of given positions, coefficients and beams.

    A snapshot holds scenario, position_enu and users_enu, and may hold velocity_enu, attitude_rad, seed, channels,
    ris, trc and beamforming: see missions/snapshot.yaml and docs/rf_model.md.

    Exit codes: 0 evaluated, 2 bad input.
    """
    with _one_line_errors():
        from rich.console import Console

        from mission.snapshot_file import evaluate_file, tables, to_json

        evaluation = evaluate_file(snapshot)
        if as_json:
            typer.echo(to_json(evaluation))
        else:
            Console().print(*tables(evaluation), sep="\n")


@app.command()
def agent(
    mission: MissionOption,
    vehicle: VehiclesOption = None,
    connect: ConnectOption = None,
    listen: ListenOption = LOOPBACK,
    zenoh_config: ConfigOption = None,
    until_ended: UntilEndedOption = False,
) -> None:
    """Run the agent node alone: one action for every channel state, of one vehicle or several."""
    with _one_line_errors():
        from bus.session import open_session
        from mission.fleet import served

        missions = served(mission, vehicle or ())
        with open_session(zenoh_config, connect or (), listen) as session:
            from agent.node import Task, run

            tasks = {one.vehicle.name: Task(one.policy, one.scenario, one.seed) for one in missions}
            code = run(tasks, session, until_ended=until_ended)
        raise typer.Exit(code)


@app.command()
def bridge(
    mission: MissionOption,
    vehicle: VehicleOption = None,
    connect: ConnectOption = None,
    listen: ListenOption = LOOPBACK,
    zenoh_config: ConfigOption = None,
    until_ended: UntilEndedOption = False,
    autopilot: Annotated[
        str | None,
        typer.Option(
            metavar="URL", help="udpin://, udpout://, tcp://HOST:PORT or serial://DEVICE:BAUD; else the mission's."
        ),
    ] = None,
    control: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="The SITL's control socket; lockstep needs it.")
    ] = None,
    other: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            callback=_names,
            help="Vehicle to keep limits.separation_m from; repeatable. Else the mission's others.",
        ),
    ] = None,
    tlog: Annotated[Path | None, typer.Option(metavar="FILE", help="MAVLink log to write.")] = None,
    autostart: Annotated[
        bool,
        typer.Option("--autostart", help="Fly without waiting for the start command, once the others are known."),
    ] = False,
    put_back: Annotated[
        bool,
        typer.Option("--put-back/--no-put-back", help="After the flight, parameters are what they were before it."),
    ] = True,
) -> None:
    """Run the autopilot bridge alone: flies the vehicle through its slots and ends with the flight.

    It always ends with the flight; --until-ended is accepted because the other nodes take it.
    """
    del until_ended
    with _one_line_errors():
        from bus.session import open_session
        from mission.fleet import one_of
        from mission.mission_file import MissionError, bridge_config

        loaded, others = one_of(mission, vehicle)
        if other and loaded.clock == "lockstep":
            raise MissionError(f"{mission}: clock: 'lockstep' is for one vehicle; with --other it must be 'paced'")
        with open_session(zenoh_config, connect or (), listen) as session:
            from autopilot_bridge.node import run

            config = bridge_config(loaded, autopilot=autopilot, control=control, autostart=autostart, put_back=put_back)
            code = run(config, loaded.vehicle.name, session, tlog, other or others)
        raise typer.Exit(code)


@app.command()
def train(
    runs: Annotated[
        list[Path] | None, typer.Argument(metavar="[RUN]...", help="Run folders to learn from, with --offline.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Where the policy and its state go.")] = Path(
        "runs/train"
    ),
    preset: Annotated[str, typer.Option(metavar="NAME", help="Scenario preset to train in.")] = "physical_small",
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Hyper-parameters (YAML): fields of agent.training_config.")
    ] = None,
    episodes: Annotated[int | None, typer.Option(help="Replaces the config's episodes.")] = None,
    seed: Annotated[int | None, typer.Option(help="Replaces the config's seed.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the state in the folder.")] = False,
    offline: Annotated[bool, typer.Option("--offline", help="Learn from run folders instead of a simulation.")] = False,
) -> None:
    """Train a DA-DDPG policy: online in the batched environment, or with --offline from flown runs."""
    with _one_line_errors():
        from mission.train import TrainInputError, learn_offline, learn_online, load_config

        if offline != bool(runs):
            raise TrainInputError("--offline takes one run folder or more, and run folders are taken with it only")
        settings = load_config(config, episodes=episodes, seed=seed)
        if runs:
            learn_offline(runs, settings, out)
        else:
            learn_online(preset, settings, out, resume=resume)


@app.command()
def report(run: RunArgument) -> None:
    """Write report.json and report.png of a run folder again, and print the table.

    Of several vehicles, those of each, and a line for each.
    """
    with _one_line_errors():
        from rich.console import Console

        from mission.report import table, write
        from mission.run_folder import recorded
        from mission.summary import summary

        reports = {folder.name: write(folder) for folder in recorded(run)}
        if recorded(run) == [run]:
            Console().print(*map(table, reports.values()))
        else:
            Console().print(summary({name: one.exit_code for name, one in reports.items()}, reports))


@app.command()
def replay(run: RunArgument) -> None:
    """Feed a recorded flight to a fresh radio node and compare what it says, bit for bit.

    Exit codes: 0 the same, 1 different.
    """
    with _one_line_errors():
        from mission.replay import replay as replay_run

        result = replay_run(run)
        typer.echo(str(result))
        raise typer.Exit(0 if result.same else ERROR)


@app.command()
def reproduce(
    figure: Annotated[
        str, typer.Argument(metavar="FIGURE", callback=_known_figure, help="One of: " + ", ".join(FIGURES) + ".")
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Where the PNG and the CSV files go.")] = Path(
        "runs/reproduce"
    ),
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
    episodes: Annotated[
        int | None, typer.Option(min=2, help="Worlds to average over, where anything is random; more take longer.")
    ] = None,
) -> None:
    """Reproduce a figure of the paper that needs no learning: PNG, CSV, and what was found beside what it says."""
    with _one_line_errors():
        from rich.console import Console

        from mission.reproduce.run import run

        run(figure, out, seed, episodes, Console())


@contextmanager
def _one_line_errors() -> Iterator[None]:
    """Expected errors become one line on stderr and the exit code of the architecture: 2 bad input, 1 all else."""
    try:
        yield
    except KeyboardInterrupt:
        _fail("interrupted", ERROR)
    except typer.Exit:
        raise
    except (OSError, ValueError, RuntimeError) as error:
        code = _exit_code(error)
        if code is None:
            raise
        _fail(str(error), code)


def _exit_code(error: Exception) -> int | None:
    """Exit code of an error of input or circumstance; None for one of ours, which deserves its traceback."""
    from agent.checkpoint import CheckpointError
    from bus.session import BusError
    from mission.flight_log import FlightLogError
    from mission.fly import FlightError
    from mission.mission_file import MissionError
    from mission.replay import ReplayError
    from mission.train import TrainInputError
    from rf_model.scenario import ScenarioError

    bad = (MissionError, ScenarioError, CheckpointError, FlightLogError, TrainInputError, ReproduceError)
    if isinstance(error, bad):
        return BAD_INPUT
    if isinstance(error, BusError | FlightError | ReplayError | OSError):
        return ERROR
    return None


def _fail(text: str, code: int) -> None:
    with suppress(OSError):  # of a full disk
        print(f"error: {text}", file=sys.stderr, flush=True)
    raise typer.Exit(code)


def main() -> None:
    """Entry point. What the command line itself gets wrong is one line and exit code 2, too."""
    try:
        sys.exit(app(standalone_mode=False))
    except TyperException as error:
        if error.format_message():  # none where the help was printed instead
            print(f"error: {error.format_message()}", file=sys.stderr)
        sys.exit(BAD_INPUT)
