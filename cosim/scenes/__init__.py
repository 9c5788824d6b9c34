"""Training scenes, cut out of SUMO traffic and labelled with which vehicle reacts to which.

The steps are: `seed_scenes` simulates one seed; `trajectory_buffer` keeps the last seconds of traffic and starts
interventions (`counterfactual_speeds`, `last_decisions`); `candidates` finds following chains, merges and triples;
`clips` cuts them out; `scene_filters` applies `scene_rules` and labels the scenes (`cosim.measures.relation_labels`);
`scene_states` computes their states. `dataset` joins many seeds into one file, and `dataset_report` describes it. The
command `cosim scenes` uses `dataset.make` and `scene_rules`; no other room imports this one. Begin with `dataset.make`.
See docs/scene-labels.md.
"""
