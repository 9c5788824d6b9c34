"""Rows that infer relations because they help to predict motion: NRI with one graph per scene, and one per step.

NRI is the project's own baseline (`gri.training.baselines.nri`), trained on the benchmark's scenes without relations.

`per_step` is a small model in the manner of dynamic NRI (Graber and Schwing 2020): edges at every step, a recurrent
prior that has seen the past, and a posterior that has seen the whole window:

    min  −Σ_t log N(a_t; own(x_≤t) + Σ_i z_ij,t·message(x_i, x_j), σ²) + KL[q(z_t | x) || p(z_t | x_≤t)]

The prior's logit starts at that of the flat prior. "No edge" sends nothing.
"""

from collections.abc import Sequence
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.bench.answers import Infer
from gri.bench.car_following_scenes import DT, WINDOW, KnownScenes
from gri.bench.pair_classifier import CHANNELS, pair_features
from gri.bench.reward_rows import encoder_answers, new_model, training_scenes
from gri.bench.structure import FLAT
from gri.core.edges import pairs
from gri.networks.model import RelationalModel
from gri.training.baselines.nri import NriSettings, train_nri
from gri.training.optimisation import Bottleneck

NRI = NriSettings(updates=400, batch=48, encoder_rate=2e-3, bottleneck=Bottleneck(rate=0.05, no_edge_prior=1 - FLAT))
NRI_SCENES = 500  # of each driver model and family
PER_STEP_UPDATES, PER_STEP_BATCH, HIDDEN = 600, 64, 24


@cache
def _nri(train: tuple[KnownScenes, ...], seed: int) -> RelationalModel:
    model = new_model(seed)
    train_nri(model, training_scenes(train, NRI_SCENES), NRI, seed)
    return model


def nri(train: Sequence[KnownScenes], seed: int) -> Infer:
    """NRI's encoder."""
    return encoder_answers(_nri(tuple(train), seed))


class PerStepModel(nn.Module):
    """Edges at every step, and the acceleration that they explain; C channels of `pair_features`."""

    def __init__(self) -> None:
        super().__init__()
        self.embed = nn.Sequential(nn.Linear(CHANNELS, HIDDEN), nn.SiLU())
        self.forwards = nn.GRU(HIDDEN, HIDDEN, batch_first=True)
        self.backwards = nn.GRU(HIDDEN, HIDDEN, batch_first=True)
        self.prior = nn.Linear(HIDDEN, 1)
        self.posterior = nn.Linear(2 * HIDDEN, 1)
        self.message = nn.Sequential(nn.Linear(CHANNELS, HIDDEN), nn.SiLU(), nn.Linear(HIDDEN, 1))
        self.own = nn.Sequential(nn.Linear(2, HIDDEN), nn.SiLU(), nn.Linear(HIDDEN, 1))
        self.log_sigma = nn.Parameter(torch.zeros(()))
        for head in (self.prior, self.posterior):
            nn.init.constant_(head.bias, float(torch.tensor(FLAT).logit()))

    def logits(self, channels: Float[Tensor, "P T C"]) -> tuple[Float[Tensor, "P T"], Float[Tensor, "P T"]]:
        """Of the prior and of the posterior, for P pairs."""
        series = self.embed(channels)
        past, future = self.forwards(series)[0], self.backwards(series.flip(1))[0].flip(1)
        return self.prior(past)[..., 0], self.posterior(torch.cat([past, future], -1))[..., 0]

    def loss(
        self, channels: Float[Tensor, "B E T C"], own: Float[Tensor, "B N T 2"], a: Float[Tensor, "B N T"]
    ) -> Float[Tensor, ""]:
        """Negative evidence bound per vehicle and step [nats]; `own` is what a vehicle knows of itself."""
        prior, posterior = (part.unflatten(0, channels.shape[:2]) for part in self.logits(channels.flatten(0, 1)))
        noise = torch.rand_like(posterior).clamp(1e-6, 1 - 1e-6).logit()
        edge = ((posterior + noise) / 0.5).sigmoid()  # binary concrete distribution
        message = edge * self.message(channels)[..., 0]
        receivers = torch.tensor([j for _, j in pairs(own.shape[1])])
        mean = self.own(own)[..., 0].index_add(1, receivers, message)
        sigma = self.log_sigma.clamp(-4, 2).exp()
        error = (0.5 * ((a - mean) / sigma) ** 2 + sigma.log()).mean()
        q = posterior.sigmoid()
        divergence = q * (nn.functional.logsigmoid(posterior) - nn.functional.logsigmoid(prior))
        divergence = divergence + (1 - q) * (nn.functional.logsigmoid(-posterior) - nn.functional.logsigmoid(-prior))
        return error + divergence.sum(1).mean() / own.shape[1]


def _series(state: Float[Tensor, "S N T 3"]) -> tuple[Tensor, Tensor, Tensor]:
    """Channels of all pairs [S, E, T−2, C], own speed and last acceleration, and the acceleration to explain."""
    v = state[..., 1].float()
    a = (v[..., 1:] - v[..., :-1]) / DT
    features = pair_features(state)  # Shape: (S, receiver, sender, C, T); its accelerations are those before a state
    channels = torch.stack([features[:, j, i] for i, j in pairs(state.shape[1])], 1).mT
    own = torch.stack([v[..., 1:-1] / 20, a[..., :-1]], -1)
    return channels[:, :, 1:-1].clamp(-10, 10), own, a[..., 1:]


@cache
def _per_step(train: tuple[KnownScenes, ...], seed: int) -> PerStepModel:
    torch.manual_seed(seed)
    state = torch.cat([known.state[:NRI_SCENES, :, :WINDOW] for known in train])
    model = PerStepModel()
    optimiser = torch.optim.Adam(model.parameters(), 3e-3)
    for _ in range(PER_STEP_UPDATES):
        loss = model.loss(*_series(state[torch.randint(len(state), (PER_STEP_BATCH,))]))
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
    return model.eval()


def per_step(train: Sequence[KnownScenes], seed: int) -> Infer:
    """The mean over the window of the posterior of each edge."""
    model = _per_step(tuple(train), seed)

    @torch.no_grad()
    def infer(known: KnownScenes) -> Float[Tensor, "S E"]:
        channels = _series(known.state[:, :, :WINDOW])[0]
        return model.logits(channels.flatten(0, 1))[1].sigmoid().mean(-1).unflatten(0, channels.shape[:2]).double()

    return infer
