import pytest
import torch

from gri.data.ranges.highway_merge import HIGHWAY_MERGE, Situation
from gri.data.ranges.highway_states import sample_history, sample_leader, sample_takeovers
from gri.data.ranges.merge_geometry import VEHICLE_LENGTH

SCENES, DT = HIGHWAY_MERGE, 0.2


@pytest.mark.parametrize("situation", Situation)
def test_takeovers_are_what_their_name_says(situation: Situation, generator: torch.Generator):
    x, y, v, heading, a, yaw_rate = sample_takeovers(SCENES, situation, 500, generator).unbind(-1)
    net_lag, net_lead = x[:, 0] - x[:, 1] - VEHICLE_LENGTH, x[:, 2] - x[:, 0] - VEHICLE_LENGTH
    match situation:
        case Situation.BETWEEN:
            assert min(net_lag.min(), net_lead.min()) >= 1.0 - 1e-4
            assert max(net_lag.max(), net_lead.max()) <= 23.0 + 1e-4
        case Situation.MERGED:
            assert min(net_lag.min(), net_lead.min()) > 0
        case Situation.BEHIND:
            assert (x[:, 1] - x[:, 0] >= VEHICLE_LENGTH + 1.0 - 1e-4).all()
        case Situation.PASSING:
            assert (net_lag < 0).any()
            assert (net_lead < 0).any()
    inside = situation is Situation.MERGED
    assert (y[:, 0].abs() <= 0.1).all() if inside else (y[:, 0] + 3.75).abs().max() <= 0.2 + 1e-4
    assert y[:, 1].abs().max() <= 0.1
    assert (x[:, 2] == 0).all()
    assert torch.stack([heading, yaw_rate]).abs().max() == 0
    assert v.min() >= 1.0
    assert -2.2 <= a.min() <= a.max() <= 1.5


@pytest.mark.parametrize("situation", Situation)
def test_histories_lead_to_the_takeover_without_a_step_aside(situation: Situation, generator: torch.Generator):
    takeover = sample_takeovers(SCENES, situation, 200, generator)
    history = sample_history(SCENES, situation, takeover, generator)
    assert history.shape == (200, 3, SCENES.history_steps, 6)
    assert torch.equal(history[:, :, -1], takeover)
    x, y, v, heading, _, yaw_rate = history.unbind(-1)
    torch.testing.assert_close(x.diff(dim=-1), v[..., :-1] * DT, atol=1e-3, rtol=1e-4)
    assert torch.equal(y, y[..., -1:].expand_as(y))
    assert torch.stack([heading, yaw_rate]).abs().max() == 0
    assert 0 <= v.min() <= v.max() <= SCENES.starts.greatest_speed + 10


def test_the_leader_speeds_and_slows_within_its_limits(generator: torch.Generator):
    start = sample_takeovers(SCENES, Situation.BETWEEN, 300, generator)[:, 2]
    drive = sample_leader(SCENES, start, generator)
    x, y, v, heading, a, _ = drive.unbind(-1)
    assert torch.equal(drive[:, 0, :4], start[:, :4])
    torch.testing.assert_close(x.diff(dim=1), v[:, :-1] * DT, atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(v.diff(dim=1), a[:, :-1] * DT, atol=1e-3, rtol=1e-4)
    assert SCENES.slowest_leader - 1e-4 <= v.min() <= v.max() <= 20.0 + 1e-4
    assert torch.stack([y, heading]).abs().max() == 0
    assert (v.diff(dim=1) > 0.05).any()
    assert (v.diff(dim=1) < -0.05).any()
