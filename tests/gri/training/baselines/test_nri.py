import pytest
import torch

from gri.core.graph import FOLLOWING, LANE_CHANGING
from gri.core.scale import CAR_FOLLOWING_PAPER
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import PAPER
from gri.data.synthetic.expert import model_config
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import RelationalModel
from gri.rewards.unstructured import NetworkReward
from gri.training.baselines.nri import NriSettings, train_nri
from gri.training.optimisation import Bottleneck


def scenes(count: int = 8) -> Scenes:
    generator = torch.Generator().manual_seed(0)
    state = torch.randn(count, 3, 6, 3, generator=generator)
    return Scenes(state, torch.zeros(count, 2, 5, 1), torch.zeros(count, 6, dtype=torch.int64))


def test_both_encoder_and_decoder_are_trained_by_one_loss():
    torch.manual_seed(0)
    model = RelationalModel(model_config(PAPER, DecoderConfig(hidden=8), EncoderConfig(hidden=8)))
    before = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    values: list[float] = []
    train_nri(model, scenes(), NriSettings(updates=3, batch=8), 0, lambda *step: values.append(step[3]))
    changed = {name for name, tensor in model.state_dict().items() if not torch.equal(tensor, before[name])}
    assert any(name.startswith("encoder") for name in changed)
    assert any(name.startswith("decoder") for name in changed)
    assert len(values) == 3


def test_nri_needs_an_encoder():
    model = RelationalModel(model_config(PAPER, DecoderConfig(hidden=8), None))
    with pytest.raises(AssertionError, match="encoder"):
        train_nri(model, scenes(), NriSettings(updates=1), 0)


@pytest.mark.parametrize("vocabulary", [FOLLOWING, LANE_CHANGING])
def test_network_rewards_pay_nothing_for_type_0_and_see_no_absolute_position(vocabulary):
    torch.manual_seed(0)
    reward = NetworkReward(CAR_FOLLOWING_PAPER, vocabulary)
    sender, receiver = torch.randn(4, 3), torch.randn(4, 3)
    paid = reward.of_edges(sender, receiver)
    assert paid.shape == (4, len(vocabulary))
    assert (paid[:, 0] == 0).all()
    assert (paid[:, 1:] != 0).all()
    along = torch.tensor([100.0, 0.0, 0.0])
    torch.testing.assert_close(reward.of_edges(sender + along, receiver + along), paid, atol=1e-4, rtol=1e-4)
    action = torch.randn(4, 1)
    torch.testing.assert_close(reward.of_vehicles(sender + along, action), reward.of_vehicles(sender, action))


def test_edges_that_the_prior_of_the_scenes_excludes_are_not_inferred():
    shares = []
    for follow in (0.5, 1e-12):
        torch.manual_seed(0)
        model = RelationalModel(model_config(PAPER, DecoderConfig(hidden=8), EncoderConfig(hidden=8)))
        priors = torch.tensor([1 - follow, follow]).repeat(8, 6, 1)
        settings = NriSettings(updates=60, batch=8, encoder_rate=1e-2, bottleneck=Bottleneck(rate=10.0))
        train_nri(model, scenes(), settings, 0, scene_priors=priors)
        shares.append(float(model.infer(scenes().state).probs[..., 1].mean().detach()))
    assert shares[0] > 0.1
    assert shares[1] < 1e-3
