"""Training scenes of three vehicles, cut out of SUMO traffic and labelled with which vehicle reacts to which.

The steps are: `seed_scenes` simulates one seed; `trajectory_buffer` keeps the last seconds of traffic; `candidates`
finds following chains and merges; `clips` cuts them out; `scene_filters` applies `rules` and labels the scenes
(`cosim.measures.relation_labels`); `scene_states` computes their states. `dataset` joins many seeds into one file, and
`dataset_report` describes it. The command `cosim scenes` uses `dataset.make` and `rules`; no other room imports this
one. Begin with `dataset.make`. See docs/scene-labels.md.
"""
