"""Command line of the simulated autopilot: `python -m sitl`, `aerialstar sitl`."""

import sys
from typing import Annotated, Literal

import typer


def sitl(
    personality: Annotated[Literal["px4"], typer.Option(help="Which autopilot to play.")] = "px4",
    gcs_port: Annotated[int, typer.Option(min=1, max=65535, help="UDP port of the ground station.")] = 14550,
    companion_port: Annotated[int, typer.Option(min=1, max=65535, help="UDP port of the companion.")] = 14540,
    gcs_bind: Annotated[int, typer.Option(min=0, max=65535, help="Where the ground link listens; 0: any.")] = 18570,
    companion_bind: Annotated[
        int, typer.Option(min=0, max=65535, help="Where the companion link listens; 0: any.")
    ] = 14580,
    speed: Annotated[
        float, typer.Option(min=0.01, max=1000.0, help="Vehicle seconds per second of wall clock, when paced.")
    ] = 1.0,
    lockstep: Annotated[bool, typer.Option("--lockstep", help="Move only as a control client says.")] = False,
    control_port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="TCP port of the control socket; 0: any.")
    ] = None,
    exit_when_landed: Annotated[
        bool, typer.Option("--exit-when-landed", help="End after the flight, or when the control client is gone.")
    ] = False,
    launcher: Annotated[
        int | None, typer.Option(metavar="PID", help="Our parent process; end if it dies before there was a flight.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the sensor noise.")] = 0,
    home: Annotated[
        str, typer.Option(metavar="LAT,LON,ALT", help="Start on the globe [deg, deg, m above mean sea level].")
    ] = "47.397743,8.545594,489.4",
    param: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Set a parameter; may be repeated.")
    ] = None,
    system_id: Annotated[int, typer.Option(min=1, max=250, help="MAVLink system id.")] = 1,
) -> None:
    """Simulate a PX4 or ArduCopter quadcopter that MAVLink clients can fly (UDP on loopback)."""
    from sitl.origin import read_origin
    from sitl.parameters import ParameterError, Parameters
    from sitl.personality import personality as personality_of

    played = personality_of(personality)
    parameters = Parameters(played.table)
    try:
        parameters.set(played.system_id, system_id)
        for assignment in param or ():
            parameters.assign(assignment)
    except ParameterError as error:
        print(f"error: {error}", file=sys.stderr)
        raise typer.Exit(2) from None
    try:
        origin = read_origin(home)
    except ValueError as error:
        print(f"error: --home: {error}", file=sys.stderr)
        raise typer.Exit(2) from None

    from sitl.server import Options, run

    raise typer.Exit(
        run(
            Options(
                personality=played,
                gcs_port=gcs_port,
                companion_port=companion_port,
                gcs_bind=gcs_bind,
                companion_bind=companion_bind,
                speed=speed,
                lockstep=lockstep,
                control_port=control_port,
                exit_when_landed=exit_when_landed,
                launcher=launcher,
                seed=seed,
                origin=origin,
                parameters=parameters,
            )
        )
    )
