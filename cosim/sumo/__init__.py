"""The only room that talks to libsumo: start, step, read, command, close.

Others use what is listed here. Begin with `simulation.sumo` (start) and `simulation.Sumo` (everything else).
"""

from cosim.sumo.cache import CachedVehicleValues as CachedVehicleValues
from cosim.sumo.drivers import Drivers as Drivers
from cosim.sumo.net import Net as Net
from cosim.sumo.simulation import Sumo as Sumo
from cosim.sumo.simulation import SumoError as SumoError
from cosim.sumo.simulation import sumo as sumo
from cosim.sumo.simulation import sumo_errors as sumo_errors
from cosim.sumo.simulation import version as version
