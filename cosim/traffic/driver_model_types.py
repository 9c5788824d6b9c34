"""Vehicle types of SUMO's own models for a share of the traffic, as an additional file of the simulation."""

from collections.abc import Mapping
from dataclasses import replace
from xml.sax.saxutils import quoteattr

from cosim.spec.sumo_models import SumoModel
from cosim.traffic.simulation_input import SimulationInput

_OPTION = "--additional-files"


def type_id(name: str) -> str:
    """The id of the vehicle type of a share of this name."""
    return f"share.{name}"


def with_model_types(inputs: SimulationInput, models: Mapping[str, SumoModel]) -> SimulationInput:
    """The simulation with a vehicle type for each of the models; without models it stays as it is."""
    if not models:
        return inputs
    path = inputs.files.routes.with_suffix(".models.xml")
    return replace(
        inputs, texts={**inputs.texts, path: types_file(models)}, arguments=_adding(inputs.arguments, str(path))
    )


def types_file(models: Mapping[str, SumoModel]) -> str:
    """SUMO's additional file with these vehicle types (SUMO doc: Vehicle Types)."""
    lines = [
        f"    <vType id={quoteattr(type_id(name))} carFollowModel={quoteattr(choice.model)}"
        + "".join(f' {attribute}="{value:g}"' for attribute, value in choice.parameters.items())
        + "/>"
        for name, choice in models.items()
    ]
    return "\n".join(["<additional>", *lines, "</additional>", ""])


def _adding(arguments: tuple[str, ...], file: str) -> tuple[str, ...]:
    """SUMO's arguments with one more additional file, the first one, so that its types are known to all others."""
    if _OPTION not in arguments:
        return (*arguments, _OPTION, file)
    at = arguments.index(_OPTION) + 1
    return (*arguments[:at], f"{file},{arguments[at]}", *arguments[at + 1 :])
