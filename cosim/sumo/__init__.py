"""The only door to libsumo: start, step, read, command, close."""

from cosim.sumo.drivers import Drivers as Drivers
from cosim.sumo.net import Net as Net
from cosim.sumo.world import Sumo as Sumo
from cosim.sumo.world import SumoError as SumoError
from cosim.sumo.world import sumo as sumo
from cosim.sumo.world import version as version
