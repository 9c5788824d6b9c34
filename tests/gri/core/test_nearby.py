"""Who is next ahead among vehicles that are in no group."""

import torch

from gri.core.dynamics import DUBINS
from gri.core.merging_policy import MergingDriver
from gri.core.nearby import Nearby
from gri.core.policy import IntelligentDriver, PolicyState


def around(*vehicles: tuple[float, float, float], present: bool = True) -> Nearby:
    """Vehicles of (ahead, across, v) as two vehicles of one group see them, the second 20 m ahead of the first."""
    ahead, across, v = torch.tensor(vehicles).T
    sizes = torch.full((1, len(vehicles)), 5.0), torch.full((1, len(vehicles)), 1.8)
    places = torch.stack([ahead, ahead - 20.0])[None], torch.stack([across, across])[None]
    return Nearby(*places, v[None], *sizes, torch.full((1, len(vehicles)), present))


def test_the_next_ahead_is_in_the_path_and_not_beside_or_behind():
    gap, v = around((30.0, 0.0, 7.0), (15.0, 3.5, 1.0), (-10.0, 0.0, 2.0), (60.0, 1.0, 9.0)).next_ahead()
    assert gap.tolist() == [[25.0, 5.0]]
    assert v.tolist() == [[7.0, 7.0]]
    nobody = around((30.0, 0.0, 7.0), present=False).next_ahead()
    assert nobody[0].isinf().all()


def test_nobody_near_is_no_vehicle_at_all():
    empty = Nearby(torch.zeros(1, 2, 0), torch.zeros(1, 2, 0), *[torch.zeros(1, 0)] * 3, torch.zeros(1, 0).bool())
    assert empty.next_ahead()[0].isinf().all()
    assert around((30.0, 0.0, 7.0)).repeated(2).ahead.shape == (2, 2, 1)


def test_idm_brakes_for_whoever_is_ahead():
    """A slow vehicle cuts in 12 m ahead of vehicle 0; without being told, IDM follows its leader 100 m ahead."""
    state = torch.tensor([[[0.0, 10.0, 0.0], [100.0, 10.0, 0.0]]])
    idm, memory = IntelligentDriver(0.2), PolicyState(None, torch.zeros(1, 2, 0))
    alone = idm.act(memory, state)[0]
    beside = idm.act(memory, state, around((12.0, 3.5, 5.0)))[0]
    ahead = idm.act(memory, state, around((12.0, 0.9, 5.0)))[0]
    assert torch.equal(alone, beside)
    assert float(0.2 * ahead[0, 0, 0]) < -4.0 < float(0.2 * alone[0, 0, 0])
    assert torch.equal(alone[0, 1], ahead[0, 1])


def test_a_merging_driver_brakes_for_whoever_is_ahead():
    state = torch.zeros(1, 3, len(DUBINS.state))
    state[0, :, 0], state[0, :, 2], state[0, 0, 1] = torch.tensor([30.0, 0.0, 80.0]), 10.0, -3.66
    other = Nearby(
        ahead=torch.tensor([[[10.0], [40.0], [-40.0]]]),
        across=torch.tensor([[[0.0], [-3.66], [-3.66]]]),
        v=torch.tensor([[2.0]]),
        length=torch.tensor([[5.0]]),
        width=torch.tensor([[1.8]]),
        present=torch.tensor([[True]]),
    )
    driver, memory = MergingDriver(IntelligentDriver(0.2)), PolicyState(None, torch.zeros(1, 3, 0))
    alone, seen = (driver.act(memory, state, *extra)[0][0, :, 0] for extra in ((), (other,)))
    assert float(seen[0]) < float(alone[0]) - 10.0
    assert torch.equal(seen[1:], alone[1:])
