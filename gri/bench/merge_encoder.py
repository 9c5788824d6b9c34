"""How well an encoder of the released models' kind learns the label-free posterior of merges.

The posterior sees a whole scene. The encoder sees up to 5 s before a step, as in a closed loop, and is taught the
posterior's probabilities in that step. It sees no label.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.edges import LANE_CHANGING
from gri.core.scale import Scale
from gri.networks.encoder import Encoder, EncoderConfig

HISTORY, LEAST = 25, 10  # steps; before the 10th step the first 10 are seen
READS = (0, 1, 2, 3)  # x, y, v, heading
SCALE = Scale(
    offset=(0.0, -1.8, 8.0, 0.0, 0.0, 0.0), unit=(12.0, 1.8, 5.0, 0.1, 1.5, 0.1), action=(1.5, 0.1)
)  # of highway merges
UPDATES, BATCH = 1500, 48


def window(state: Float[Tensor, "S N T D"], step: int) -> Float[Tensor, "S N H D"]:
    """The states up to a step that the encoder may see."""
    last = max(step + 1, LEAST)
    return state[:, :, max(last - HISTORY, 0) : last]


def teach_encoder(state: Float[Tensor, "S N T D"], target: Float[Tensor, "S T E K"], dt: float, seed: int) -> Encoder:
    """An encoder that gives the target's probabilities in every step, from the history before it (cross-entropy)."""
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    encoder = Encoder(EncoderConfig(hidden=64, reads=READS, skip=True), SCALE, len(LANE_CHANGING), dt)
    optimiser = torch.optim.Adam(encoder.parameters(), 3e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 3e-3, total_steps=UPDATES)
    state, target = state.float(), target.float()
    for _ in range(UPDATES):
        step = int(torch.randint(LEAST - 1, state.shape[2], (), generator=generator))
        rows = torch.randint(len(state), (BATCH,), generator=generator)
        logits = encoder(window(state[rows], step))
        loss = nn.functional.cross_entropy(logits.flatten(0, 1), target[rows, step].flatten(0, 1))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return encoder.eval()


@torch.no_grad()
def per_step(encoder: Encoder, state: Float[Tensor, "S N T D"]) -> Float[Tensor, "S T E K"]:
    """Probabilities in every step."""
    steps = [encoder(window(state.float(), t)).softmax(-1) for t in range(state.shape[2])]
    return torch.stack(steps, 1).double()
