"""A state predictor: from late and lost states to what they are probably now, for a policy that knows their age.

Where a policy's actions take effect later, it is shown what will probably be then.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.core.dynamics import Dynamics


@dataclass(frozen=True)
class StatePredictor:
    """Predicts states of a known age by the dynamics, in steps of `dt` [s].

    Others keep their last seen acceleration and yaw rate. In its own view (`own[view, role]`) a driven vehicle has felt
    its accelerations and yaw rates since: dead reckoning from the last known place. Where actions are executed `delay`
    steps late, the prediction goes on as far, by the actions that were `sent` and are still to come. Nobody drives
    backwards.
    """

    dynamics: Dynamics
    dt: float
    own: Bool[Tensor, "E N"]
    delay: int = 0
    sent: Sequence[Float[Tensor, "1 G N A"]] = ()
    felt: list[Float[Tensor, "E G N F"]] = field(default_factory=list)

    def predicted(
        self, shown: Float[Tensor, "E G N D"], age: Int[Tensor, "E G N"], *, final: bool = True
    ) -> Float[Tensor, "E G N D"]:
        """The states `delay` steps from now, from those that a view shows, which were true `age` steps ago.

        A vehicle's own acceleration and yaw rate in `shown` are those of the present. With `final=False` this step is
        asked about once more later.
        """
        feels = [k for k, name in enumerate(self.dynamics.state) if name in ("a", "yaw_rate")]
        felt = [*self.felt, shown[..., feels]]
        if final:
            self.felt.append(shown[..., feels])
        state, own = shown.clone(), self.own[:, None, :, None]
        for k in range(int(age.max()), 0, -1):  # from k to k - 1 steps ago
            before, after = (felt[max(len(felt) - 1 - ago, 0)] for ago in (k, k - 1))
            starts = own & (age == k)[..., None]
            state[..., feels] = torch.where(starts, before, state[..., feels])
            action = torch.where(own, (after - before) / self.dt, 0.0)
            state = torch.where((age >= k)[..., None], self._step(state, action), state)
        state[..., feels] = torch.where(own, felt[-1], state[..., feels])
        for k in range(self.delay, 0, -1):  # before the first action there was none
            coming = self.sent[-k] if len(self.sent) >= k else torch.zeros_like(state[..., : len(self.dynamics.action)])
            state = self._step(state, torch.where(own, coming, 0.0).to(state.dtype))
        return state

    def _step(self, state: Float[Tensor, "*batch D"], action: Float[Tensor, "*batch A"]) -> Float[Tensor, "*batch D"]:
        following = self.dynamics.step(state, action, self.dt)
        return following if self.dynamics.stop is None else self.dynamics.stop(state, following)
