"""The taught encoder sees the past only."""

import torch

from gri.bench.merge_encoder import HISTORY, LEAST, READS, SCALE, per_step, window
from gri.networks.encoder import Encoder, EncoderConfig

STEPS = 30


def test_the_window_ends_at_the_step_and_has_at_most_five_seconds():
    state = torch.arange(STEPS).float().expand(1, 3, STEPS)[..., None]
    assert window(state, 27)[0, 0, :, 0].tolist() == list(range(3, 28))
    assert window(state, 12).shape[2] == 13
    assert window(state, 2).shape[2] == LEAST
    assert window(state, STEPS - 1).shape[2] == HISTORY


def test_what_comes_later_changes_nothing():
    torch.manual_seed(0)
    encoder = Encoder(EncoderConfig(hidden=16, reads=READS), SCALE, 4, 0.2).eval()
    state = torch.randn(4, 3, STEPS, 6)
    later = state.clone()
    later[:, :, 20:] += 5
    here, there = per_step(encoder, state), per_step(encoder, later)
    assert torch.allclose(here[:, :20], there[:, :20])
    assert not torch.allclose(here[:, 20:], there[:, 20:])
