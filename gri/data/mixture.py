"""Synthetic scenes and scenes of files in one set, for a model that learns from both."""

import torch

from gri.core.scenes import Scenes


def mix_scenes(synthetic: Scenes, from_files: Scenes) -> Scenes:
    """The synthetic scenes followed by those of files, all truncated to the shorter T.

    Synthetic scenes may have a history of H states before the policy takes over. Then the first H states of a scene
    from a file are its history. So the graph is inferred from as many states as in closed loop, and it holds for the
    whole scene.
    """
    steps = min(synthetic.state.shape[2], from_files.state.shape[2])
    parts = [_truncated(synthetic, steps), _truncated(from_files, steps)]
    state, action, graph = (torch.cat([getattr(p, name) for p in parts]) for name in ("state", "action", "graph"))
    if synthetic.history is None:
        return Scenes(state, action, graph)
    history_steps = synthetic.history.shape[2]
    history = torch.cat([synthetic.history, from_files.state[:, :, :history_steps]])
    return Scenes(state, action, graph, history)


def _truncated(scenes: Scenes, steps: int) -> Scenes:
    return Scenes(scenes.state[:, :, :steps], scenes.action[:, :, : steps - 1], scenes.graph)
