"""Synthetic scenes and those of scene files in one set, for a model that learns from both."""

import torch

from gri.core.scenes import Scenes


def mixed(synthetic: Scenes, filed: Scenes) -> Scenes:
    """First the synthetic scenes, then those of files, all as long as the shorter.

    Where synthetic drivers take over after a history, what is seen of a filed scene is its beginning, as long as that
    history: the graph is inferred from as many states as in closed loop, and stands for the whole scene.
    """
    steps = min(synthetic.state.shape[2], filed.state.shape[2])
    parts = [_first(synthetic, steps), _first(filed, steps)]
    state, action, graph = (torch.cat([getattr(p, name) for p in parts]) for name in ("state", "action", "graph"))
    if synthetic.history is None:
        return Scenes(state, action, graph)
    seen = synthetic.history.shape[2]
    return Scenes(state, action, graph, torch.cat([synthetic.history, filed.state[:, :, :seen]]))


def _first(scenes: Scenes, steps: int) -> Scenes:
    return Scenes(scenes.state[:, :, :steps], scenes.action[:, :, : steps - 1], scenes.graph)
