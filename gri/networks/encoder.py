"""The encoder: the probability of each edge type of every ordered pair, from how the vehicles moved (Appendix A).

    h¹_j = f_emb(x_j)
    h¹_ij = f_e¹(h¹_i, h¹_j)
    h²_j = f_v¹(Σ_{i≠j} h¹_ij)
    q(z_ij | τ) = softmax f_e²(h²_i, h²_j)

`f_emb` is a 1-D CNN with attentive pooling over time. The other networks are fully connected. All vehicles share all
networks, so that renumbering the vehicles renumbers the edges.

Beyond the paper, the encoder can also read the series of each pair (`pair_series`): gaps matter to some decimetres and
lateral movements to centimetres, and embeddings of single vehicles do not keep them.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.layers import edge_ends, incidence, mlp
from gri.core.scale import Scale

POSITION = 0  # the longitudinal position is the first state feature of all dynamics
X, Y, V = 0, 1, 2  # state features of vehicles that may change lanes
LENGTH = 5.0  # [m] of every vehicle
PAIR_SERIES = 11  # channels without time
RECENT = 5  # last instants, whose mean is read besides the last two


class EncoderConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Size of the encoder and its input features."""

    hidden: int = 64
    """Units per hidden layer."""
    reads: tuple[int, ...] = (0, 1)
    """Indices of the state features it reads. Accelerations are left out by default: recorded ones are noisy, and
    simulated ones jump.
    """
    kernel: int = 5
    """Width of the convolutions [time steps]."""
    heads: int = 8
    """Number of attention heads that pool over time."""
    skip: bool = False
    """f_e² also reads h¹_ij, as in the published NRI code; the paper's equations do not have this."""
    pair_series: bool | msgspec.UnsetType = msgspec.UNSET
    """f_e¹ also reads the series of the pair, of vehicles that may change lanes. It then reads x, y and v of both."""


class Encoder(nn.Module):
    """Logits of q(z_ij | τ) from the trajectories of N vehicles over any number of instants."""

    offset: Tensor
    unit: Tensor

    def __init__(self, config: EncoderConfig, scale: Scale, edge_types: int, dt: float) -> None:
        super().__init__()
        self.config, self.dt = config, dt
        hidden = config.hidden
        self.register_buffer("offset", torch.tensor([scale.offset[d] for d in config.reads]), persistent=False)
        self.register_buffer("unit", torch.tensor([scale.unit[d] for d in config.reads]), persistent=False)
        self.embedding = TemporalEmbedding(len(config.reads) + 1, hidden, config.kernel, config.heads)
        read = 0
        if config.pair_series:
            self.pair = TemporalEmbedding(PAIR_SERIES + 1, hidden, config.kernel, config.heads)
            read = hidden + 3 * PAIR_SERIES
        self.edge_1 = nn.Sequential(mlp([2 * hidden + read, hidden, hidden]), nn.SiLU())
        self.node = nn.Sequential(mlp([hidden, hidden, hidden]), nn.SiLU())
        self.edge_2 = mlp([(3 if config.skip else 2) * hidden, hidden, edge_types], last_scale=0.1)

    @property
    def least_steps(self) -> int:
        """Fewest instants of a history: a convolution must see more than its padding."""
        return self.config.kernel

    def forward(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B E K"]:
        """Logits of the edge types, from states in SI units."""
        n = state.shape[1]
        senders, receivers = edge_ends(n)
        nodes = self.embedding(self._channels(state))
        series = self._read_pairs(state) if self.config.pair_series else []
        edges = self.edge_1(torch.cat([nodes[:, senders], nodes[:, receivers], *series], -1))
        nodes = self.node(incidence(n).to(edges) @ edges)
        skipped = [edges] if self.config.skip else []
        return self.edge_2(torch.cat([nodes[:, senders], nodes[:, receivers], *skipped], -1))

    def _read_pairs(self, state: Float[Tensor, "B N T D"]) -> list[Float[Tensor, "B E _"]]:
        """Each pair's embedded series, and its last two values and their recent mean as they are."""
        series = pair_series(state, self.dt)
        time = _time(state, self.dt)[:, None].expand(*series.shape[:3], 1)
        seen = [series[:, :, -1], series[:, :, -2], series[:, :, -RECENT:].mean(2)]
        return [self.pair(torch.cat([series, time], -1)), *seen]

    def _channels(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B N T C"]:
        """Scaled features and the time before the last instant.

        The position is relative to the mean position of all vehicles at that instant.
        """
        centre = torch.zeros_like(state[:, :1])
        centre[..., POSITION] = state[..., POSITION].mean(1, keepdim=True)
        read = (state - centre)[..., list(self.config.reads)]
        time = _time(state, self.dt)[:, None].expand(*read.shape[:3], 1)
        return torch.cat([(read - self.offset) / self.unit, time], -1)


def _time(state: Float[Tensor, "B N T D"], dt: float) -> Float[Tensor, " T"]:
    """The time before the last instant. Units: 4 s."""
    return torch.arange(1 - state.shape[2], 1, dtype=state.dtype) * dt / 4.0


def pair_series(state: Float[Tensor, "B N T D"], dt: float) -> Float[Tensor, "B E T C"]:
    """What the encoder reads of each pair, scaled to about one.

    Headway, gap in metres and in seconds, difference of the speeds, lateral distance, lateral movements on two scales,
    and both accelerations.
    """
    x, y, v = state[..., X], state[..., Y], state[..., V]
    a = (v[..., 1:] - v[..., :-1]) / dt
    a = torch.cat([a[..., :1], a], -1)
    moved = torch.cat([torch.zeros_like(y[..., :1]), y[..., 1:] - y[..., :-1]], -1)
    i, j = edge_ends(state.shape[1])
    headway = x[:, i] - x[:, j]
    gap = (headway.abs() - LENGTH) * headway.sign()
    slower = torch.minimum(v[:, i], v[:, j])
    places = [headway / 20, (gap / 5).tanh(), (gap / (slower + 2) / 2).tanh(), (v[:, i] - v[:, j]) / 3]
    across = [(y[:, i] - y[:, j]) / 3.6, *((unit * moved[:, k]).tanh() for unit in (10, 50) for k in (i, j))]
    return torch.stack([*places, *across, a[:, i] / 2, a[:, j] / 2], -1)


class TemporalEmbedding(nn.Module):
    """f_emb: a 1-D CNN with attentive pooling over time; one vector per vehicle from a series of any length."""

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
        """h¹_j of every vehicle."""
        b, n, t, c = series.shape
        features = self.convolutions(series.reshape(b * n, t, c).transpose(1, 2))  # Shape: (B·N, H, T)
        attention = self.attention(features).softmax(-1)  # Shape: (B·N, heads, T)
        value = self.value(features).reshape(b * n, self.heads, -1, t)
        pooled = (value @ attention[..., None]).flatten(1)
        return nn.functional.silu(pooled).reshape(b, n, -1)
