"""Gold labels for every car-following model, in hand-made traffic: two followers of a slow leader, a lone vehicle."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pytest

from cosim.measures.relation_labels import REACTION_THRESHOLD
from cosim.scenes.driver_models import DRIVER_MODELS
from cosim.scenes.trajectory_buffer import RoadSection, TrajectoryBuffer, VehicleNumbers
from cosim.spec.demand import CarFollowingModel
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.sumo import sumo
from cosim.traffic.route_file import arguments

MODELS = get_args(CarFollowingModel)
LEADER, FIRST, SECOND, LONE = range(4)
WARM_UP, SECONDS = 65.0, 5.0
KEEP_LANE = 'lcStrategic="-1" lcSpeedGain="0" lcCooperative="-1" lcKeepRight="0"'


def routes(model: str, action_step: float) -> str:
    kinds = {"slow": 10.0, "car": 25.0, "lone": 9.0}
    types = [
        f'<vType id="{name}.0" carFollowModel="{model}" maxSpeed="{speed}" actionStepLength="{action_step}"'
        f" {KEEP_LANE}/>"
        for name, speed in kinds.items()
    ]
    departures = [("slow", 0.0), ("car", 4.0), ("car", 8.0), ("lone", 30.0)]
    vehicles = [
        f'<vehicle id="a.{k}" type="{name}.0" route="a" depart="{time}" departLane="2" departSpeed="8"/>'
        for k, (name, time) in enumerate(departures)
    ]
    route = '<route id="a" edges="upstream entry weave exit downstream_free downstream"/>'
    return "\n".join(["<routes>", *types, route, *vehicles, "</routes>"])


@contextmanager
def recorded(folder: Path, model: CarFollowingModel, step: float, action_step: float) -> Iterator[TrajectoryBuffer]:
    """The last `SECONDS` of the vehicles, recorded every 0.2 s with interventions."""
    scenario = msgspec.structs.replace(load_scenario("us101_car_following"), step=step)
    (folder / "routes.xml").write_text(routes(model, action_step))
    (folder / "signs.xml").write_text("<additional/>")
    paths = (str(find_net("us101")), *(str(folder / name) for name in ("routes.xml", "signs.xml", "log")))
    with sumo(arguments(scenario, *paths), folder / "log") as world:
        road = world.net.road(scenario.road.edges, "upstream")
        section = RoadSection(world.net, road, scenario.road.edges, 3000.0)
        count = round(SECONDS / 0.2)
        buffer = TrajectoryBuffer(
            world,
            section,
            VehicleNumbers(["a"]),
            length=count,
            dt=step,
            stride=round(0.2 / step),
            gold=True,
            models=dict.fromkeys(("slow", "car", "lone"), model),
        )
        for _ in range(round(WARM_UP / step)):
            world.step()
        for _ in range(count + 1):
            buffer.advance()
        buffer.await_interventions()
        yield buffer


def column(buffer: TrajectoryBuffer, name: str) -> np.ndarray:
    """[vehicle, step] of all steps but the last, which has no intervention yet."""
    return np.array([[step.column(name)[step.row_of[k]] for step in list(buffer.steps)[:-1]] for k in range(4)])


def test_every_model_of_the_product_is_known():
    assert set(DRIVER_MODELS) == set(MODELS)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("step", "action_step"), [(0.2, 0.2), (0.1, 0.1), (0.2, 0.6)])
def test_a_follower_reacts_all_the_time_and_nobody_else_does(
    tmp_path: Path, model: CarFollowingModel, step: float, action_step: float
):
    with recorded(tmp_path, model, step, action_step) as buffer:
        effect, leader = column(buffer, "effect_of_leader"), column(buffer, "leader")
        assert (leader[[FIRST, SECOND]].T == [LEADER, FIRST]).all()
        known = column(buffer, "decision_known")[:, 10:].astype(bool)
        assert known.all()
        assert (effect[[FIRST, SECOND], 10:] < REACTION_THRESHOLD).all()
        assert np.abs(effect[[LEADER, LONE]]).max() == 0.0


@pytest.mark.parametrize(
    ("model", "action_step", "share"), [("EIDM", 0.2, 1 / 3), ("IDM", 0.6, 1 / 3), ("IDM", 0.2, 1)]
)
def test_an_intervention_of_one_step_shows_decisions_only(
    tmp_path: Path, model: CarFollowingModel, action_step: float, share: float, monkeypatch
):
    """The reason for `last_decisions`: without it, followers would react in every third step."""
    monkeypatch.setattr("cosim.scenes.trajectory_buffer.decision_steps", lambda *_: dict.fromkeys(
        ("effect_of_leader", "effect_of_requests"), 1))  # fmt: skip
    with recorded(tmp_path, model, 0.2, action_step) as buffer:
        reacts = column(buffer, "effect_of_leader")[[FIRST, SECOND]] < REACTION_THRESHOLD
        assert reacts.mean() == pytest.approx(share, abs=0.03)
