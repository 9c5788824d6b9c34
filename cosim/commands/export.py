"""The command `cosim export`: an episode in the formats of other tools."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from cosim.commands.arguments import EpisodeOption, RunArgument
from gri.terminal import next_command, say

ENDINGS = {"fcd": ".fcd.xml", "openscenario": ".xosc", "commonroad": ".commonroad.xml"}


def export(
    run: RunArgument,
    kind: Annotated[
        Literal["fcd", "openscenario", "commonroad"],
        typer.Option("--format", help="SUMO's FCD output, ASAM OpenSCENARIO XML (extra export), or CommonRoad XML."),
    ] = "fcd",
    episode: EpisodeOption = 0,
    counterpart: Annotated[
        bool, typer.Option("--counterpart", help="The same group left to SUMO, instead of the driven one.")
    ] = False,
    road: Annotated[str, typer.Option(help="For OpenSCENARIO: the OpenDRIVE file to name as its road.")] = "",
    out: Annotated[Path | None, typer.Option(help="File to write; default: in the run folder.")] = None,
) -> None:
    """Write an episode for other tools: FCD, OpenSCENARIO, CommonRoad.

    It has all vehicles around the group where the run has surroundings. With
    FCD, a second file has the vehicle types with their lengths.
    """
    from cosim.show.export.moving_vehicles import vehicles_of
    from gri.storage.whole_files import write_whole

    moving = vehicles_of(run, episode, counterpart)
    path = out or run / f"{moving.name}{'-counterpart' * counterpart}{ENDINGS[kind]}"
    path.parent.mkdir(parents=True, exist_ok=True)
    following = f"cosim render {run} --episode {episode}"
    if kind == "fcd":
        from cosim.show.export.fcd import fcd, vehicle_types

        types = path.with_name(path.name.removesuffix(".xml") + ".types.add.xml")
        write_whole(path, fcd(moving))
        write_whole(types, vehicle_types(moving))
        following = f"gri scenes inspect {path} --types {types}"
    elif kind == "openscenario":
        from cosim.show.export.openscenario import write_openscenario

        write_openscenario(moving, path, road)
    else:
        from cosim.show.export.commonroad import write_commonroad

        write_commonroad(moving, path)
    count = moving.rows["vehicle"].nunique()
    say(f"{path}: {count} vehicles, {moving.rows['time'].nunique()} instants of {moving.step:g} s")
    next_command(following)
