"""The encoder: which relation does each ordered pair of vehicles have, judged by how they moved (Appendix A).

    h¹_j = f_emb(x_j),  h¹_ij = f_e¹(h¹_i, h¹_j),  h²_j = f_v¹(Σ_{i≠j} h¹_ij),  q(z_ij | τ) = softmax
    f_e²(h²_i, h²_j)

`f_emb` is a 1-D CNN with attentive pooling over time, the others are fully connected. All are shared by all
vehicles, so that renumbering the vehicles renumbers the edges.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.layers import edge_ends, incidence, mlp
from gri.core.scale import Scale

POSITION = 0  # the longitudinal position is the first state feature of all dynamics


class EncoderConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Size of the encoder and what it looks at."""

    hidden: int = 64
    reads: tuple[int, ...] = (0, 1)
    """Which state features it sees. Accelerations are left out by default: recorded and simulated ones jump.
    """
    kernel: int = 5
    """Time steps under one filter of the convolutions."""
    heads: int = 8
    """Independent poolings over time, each with its own attention."""
    skip: bool = False
    """Hand h¹_ij to f_e² as well, as the published NRI code does; the paper's equations do not."""


class Encoder(nn.Module):
    """Posterior over edge types from the trajectories of N vehicles over any number of instants."""

    offset: Tensor
    unit: Tensor

    def __init__(self, config: EncoderConfig, scale: Scale, edge_types: int, dt: float) -> None:
        super().__init__()
        self.config, self.dt = config, dt
        hidden = config.hidden
        self.register_buffer("offset", torch.tensor([scale.offset[d] for d in config.reads]), persistent=False)
        self.register_buffer("unit", torch.tensor([scale.unit[d] for d in config.reads]), persistent=False)
        self.embedding = TemporalEmbedding(len(config.reads) + 1, hidden, config.kernel, config.heads)
        self.edge_1 = nn.Sequential(mlp([2 * hidden, hidden, hidden]), nn.SiLU())
        self.node = nn.Sequential(mlp([hidden, hidden, hidden]), nn.SiLU())
        self.edge_2 = mlp([(3 if config.skip else 2) * hidden, hidden, edge_types], last_scale=0.1)

    def forward(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B E K"]:
        n = state.shape[1]
        senders, receivers = edge_ends(n)
        nodes = self.embedding(self._channels(state))
        edges = self.edge_1(torch.cat([nodes[:, senders], nodes[:, receivers]], -1))
        nodes = self.node(incidence(n) @ edges)
        skipped = [edges] if self.config.skip else []
        return self.edge_2(torch.cat([nodes[:, senders], nodes[:, receivers], *skipped], -1))

    def _channels(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B N T C"]:
        """Scaled features, the position relative to the vehicles' mean of that instant, and the time before
        the last.
        """
        centre = torch.zeros_like(state[:, :1])
        centre[..., POSITION] = state[..., POSITION].mean(1, keepdim=True)
        read = (state - centre)[..., list(self.config.reads)]
        steps = state.shape[2]
        time = torch.arange(1 - steps, 1, dtype=state.dtype) * self.dt / 4.0  # Units: 4 s
        return torch.cat([(read - self.offset) / self.unit, time[:, None].expand(*read.shape[:3], 1)], -1)


class TemporalEmbedding(nn.Module):
    """1-D CNN over time with attentive pooling: one vector per vehicle from a series of any length."""

    def __init__(self, channels: int, hidden: int, kernel: int, heads: int) -> None:
        super().__init__()
        assert hidden % heads == 0, f"hidden {hidden} must be a multiple of heads {heads}"
        self.heads = heads
        self.convolutions = nn.Sequential(
            nn.Conv1d(channels, hidden, kernel, padding="same"),
            nn.SiLU(),
            nn.Conv1d(hidden, hidden, kernel, padding="same"),
            nn.SiLU(),
        )
        self.value = nn.Conv1d(hidden, hidden, 1)
        self.attention = nn.Conv1d(hidden, heads, 1)

    def forward(self, series: Float[Tensor, "B N T C"]) -> Float[Tensor, "B N H"]:
        b, n, t, c = series.shape
        features = self.convolutions(series.reshape(b * n, t, c).transpose(1, 2))  # Shape: (B·N, H, T)
        attention = self.attention(features).softmax(-1)  # Shape: (B·N, heads, T)
        value = self.value(features).reshape(b * n, self.heads, -1, t)
        pooled = (value @ attention[..., None]).flatten(1)
        return nn.functional.silu(pooled).reshape(b, n, -1)
