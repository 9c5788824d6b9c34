"""The only door to libsumo: start, step, read, command, close."""

from cosim.sumo.drivers import Drivers as Drivers
from cosim.sumo.net import Net as Net
from cosim.sumo.simulation import Sumo as Sumo
from cosim.sumo.simulation import SumoError as SumoError
from cosim.sumo.simulation import sumo as sumo
from cosim.sumo.simulation import version as version
