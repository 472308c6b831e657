"""Command line of the simulated autopilot: `python -m sitl`, `aerialstar sitl`."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

MAX_SYSTEM_ID = 250
"""MAVLink has 255; ground stations take the last ones."""


def sitl(
    personality: Annotated[Literal["px4", "arducopter"], typer.Option(help="Which autopilot to play.")] = "px4",
    gcs_port: Annotated[int, typer.Option(min=1, max=65535, help="UDP port of the ground station.")] = 14550,
    companion_port: Annotated[int, typer.Option(min=1, max=65535, help="UDP port of the companion.")] = 14540,
    gcs_bind: Annotated[int, typer.Option(min=0, max=65535, help="Where the ground link listens; 0: any.")] = 18570,
    companion_bind: Annotated[
        int, typer.Option(min=0, max=65535, help="Where the companion link listens; 0: any.")
    ] = 14580,
    tcp_port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Serve TCP clients too, on this port; 0: any. arducopter: 5760."),
    ] = None,
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
    seed: Annotated[int, typer.Option(min=0, help="Seed of sensor noise, gusts and estimator error.")] = 0,
    home: Annotated[
        str, typer.Option(metavar="LAT,LON,ALT", help="Start on the globe (deg, deg, m above mean sea level).")
    ] = "47.397743,8.545594,489.4",
    param: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Set a parameter; may be repeated.")
    ] = None,
    system_id: Annotated[
        int, typer.Option(min=1, max=MAX_SYSTEM_ID, help="MAVLink system id, of the first vehicle.")
    ] = 1,
    vehicles: Annotated[
        int, typer.Option(min=1, max=100, help="How many; each has the ports and the system id of the one before + 1.")
    ] = 1,
    spacing: Annotated[
        float, typer.Option(min=0.0, max=1000.0, help="Each vehicle starts so far east of the one before (m).")
    ] = 5.0,
    signing_key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Believe only frames signed with this key: 32 bytes or 64 hex digits."),
    ] = None,
) -> None:
    """Simulate PX4 or ArduCopter quadcopters that MAVLink clients can fly (UDP and TCP on loopback)."""
    from sitl.links.signing import read_key
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
        option = "--home"
        origin = read_origin(home)
        option = "--vehicles"
        if system_id + vehicles > MAX_SYSTEM_ID + 1:
            raise ValueError(f"{vehicles} vehicles from system id {system_id} on pass the last one, {MAX_SYSTEM_ID}")
        option = "--signing-key"
        key = None if signing_key is None else read_key(signing_key)
    except ValueError as error:
        print(f"error: {option}: {error}", file=sys.stderr)
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
                tcp_port=played.tcp_port if tcp_port is None else tcp_port,
                speed=speed,
                lockstep=lockstep,
                control_port=control_port,
                exit_when_landed=exit_when_landed,
                launcher=launcher,
                seed=seed,
                origin=origin,
                vehicles=vehicles,
                spacing_m=spacing,
                signing_key=key,
                parameters=parameters,
            )
        )
    )
