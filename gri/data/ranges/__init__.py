"""The ranges from which scenes are drawn or read: starts, true graphs, leaders and true rewards.

One file per kind of scene: `car_following` and `lane_changing` (the paper's synthetic data, Sec. VI-C), `highway_merge`
(merges as in SUMO), `recorded` (scene files). `merge_geometry`, `graph_shares` and `leader` are what they share. Begin
with `car_following`. `gri.data.store` finds a range by its name.
"""
