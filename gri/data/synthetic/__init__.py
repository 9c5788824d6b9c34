"""Making synthetic scenes (Sec. VI-C).

`expert` trains an expert policy on the true reward and graph, and rolls it out; it also has the sampling of starts and
graphs, and `model_config`, which training uses. `optimal_drivers` makes highway merges in which each driver plays its
best response, `optimal_followers` car-following scenes of that kind. The drivers of `idm_drivers` maximise no reward.
Other rooms get the scenes through `gri.data.store.scenes_of`. Begin reading with `expert`.
"""
